"use strict";
// Building and updating the document. Text from a story is only ever text: there is no innerHTML on this page.

/** Control characters and those that turn the direction of writing: a name could pretend to be another with them. */
const UNSEEN = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u200e\u200f\u202a-\u202e\u2066-\u2069]/g;
const LONGEST = 80;

/** Text that a person can see as it is. */
function visible(value) {
  return String(value).replace(UNSEEN, "\ufffd");
}

/** A name, cut where it would break the layout. */
function short(value, longest = LONGEST) {
  const text = visible(value);
  return text.length > longest ? `${text.slice(0, longest - 1)}\u2026` : text;
}

/**
 * Build an element: el("p.note#id", {title: "..."}, "text", child, null).
 * @param {string} what tag, classes and id
 * @param {Object<string, unknown>} attributes null, undefined and false leave one out, true sets it empty
 */
function el(what, attributes = {}, ...children) {
  const [tag] = what.match(/^[a-z0-9]+/);
  const node = document.createElement(tag);
  for (const [part] of what.slice(tag.length).matchAll(/[.#][\w-]+/g)) {
    if (part[0] === ".") node.classList.add(part.slice(1));
    else node.id = part.slice(1);
  }
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined && value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== ""));
  return node;
}

/** Build an SVG element; the attributes are numbers and words of ours. */
function svg(tag, attributes = {}, ...children) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

/** A name in the page; the whole of it shows when the pointer rests on it. */
function named(value, longest = LONGEST) {
  const text = short(value, longest);
  return el("span.name", { title: text.endsWith("\u2026") ? visible(value).slice(0, 1000) : null }, text);
}

/**
 * Make `now` look like `next` and keep what did not change: focus, selection of text, open details, scroll position.
 * An element with data-keep belongs to who drew it: neither its attributes nor its children are touched.
 */
function morph(now, next) {
  if (now.dataset && "keep" in now.dataset) return;
  if (now.nodeType === Node.TEXT_NODE) {
    if (now.nodeValue !== next.nodeValue) now.nodeValue = next.nodeValue;
    return;
  }
  morphAttributes(now, next);
  const wanted = [...next.childNodes];
  wanted.forEach((child, k) => {
    const present = now.childNodes[k];
    if (present === undefined) now.append(child);
    else if (alike(present, child)) morph(present, child);
    else present.replaceWith(child);
  });
  while (now.childNodes.length > wanted.length) now.lastChild.remove();
}

function alike(a, b) {
  return a.nodeName === b.nodeName && a.id === b.id && a.dataset?.keep === b.dataset?.keep;
}

/** Whether a <details> is open is for the reader to say. */
function morphAttributes(now, next) {
  const ours = (name) => name !== "open";
  for (const name of now.getAttributeNames()) if (ours(name) && !next.hasAttribute(name)) now.removeAttribute(name);
  for (const name of next.getAttributeNames()) {
    if (ours(name) && now.getAttribute(name) !== next.getAttribute(name)) now.setAttribute(name, next.getAttribute(name));
  }
}

/**
 * A table whose rows become cards on a narrow screen.
 * @param {string[]} heads names of the columns; one that begins with "#" holds numbers
 * @param {Array<Array<unknown>>} rows
 */
function table(heads, rows, attributes = {}) {
  const label = (head) => head.replace(/^#/, "");
  const kind = (head) => (head.startsWith("#") ? "number" : null);
  const cell = (value, k) => el("td", { class: kind(heads[k]), "data-label": label(heads[k]) }, value);
  return el(
    "table",
    attributes,
    el("thead", {}, el("tr", {}, heads.map((head) => el("th", { scope: "col", class: kind(head) }, label(head))))),
    el("tbody", {}, rows.map((row) => el("tr", {}, row.map(cell)))),
  );
}

/**
 * The address of a file of the run directory, or null if the path could lead anywhere else.
 * @param {string} path as the story says it
 */
function address(path) {
  const parts = String(path).split("/");
  const strange = (part) => part === "" || part === "." || part === ".." || /[\\\u0000-\u001f]/.test(part);
  if (parts[0] !== "trajectories" || parts.some(strange)) return null;
  return parts.map(encodeURIComponent).join("/");
}

/** A link to a trajectory file; only its name where the path is not one of ours. */
function fileLink(path) {
  const href = address(path);
  const name = named(String(path).split("/").pop(), 60);
  return href === null ? name : el("a", { href, download: true }, name);
}

/** A command with a button that copies it. */
function commandLine(command) {
  return el("div.command", {}, el("code", {}, visible(command)), el("button.copy", { type: "button", "data-copy": command }, "Copy"));
}

/** Copy a text and say so on the button; pages from a disk or without TLS have the old way only. */
async function copy(button) {
  const done = (await copied(button.dataset.copy)) ? "Copied" : "Select it by hand";
  button.textContent = done;
  setTimeout(() => (button.textContent = "Copy"), 1500);
}

async function copied(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return copiedBySelection(text);
  }
}

function copiedBySelection(text) {
  const area = el("textarea.offscreen", { readonly: true, "aria-hidden": "true" });
  area.value = text;
  document.body.append(area);
  area.select();
  const done = document.execCommand("copy");
  area.remove();
  return done;
}
