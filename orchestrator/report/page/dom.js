// Building and updating the document. Text of the report data becomes text nodes only: this page has no innerHTML.

/** Control characters and those that change the direction of text: with them one name could imitate another. */
const CONTROLS = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u200e\u200f\u202a-\u202e\u2066-\u2069]/g;
const LONGEST = 80;

/** Text with a replacement character for every control character. */
function visible(value) {
  return String(value).replace(CONTROLS, "\ufffd");
}

/** A name, cut where it would break the layout. */
function short(value, longest = LONGEST) {
  const text = visible(value);
  return text.length > longest ? `${text.slice(0, longest - 1)}\u2026` : text;
}

/** A name, its middle left out where it is long: names of one series differ at their ends. */
function shortMiddle(value, longest) {
  const text = visible(value);
  if (text.length <= longest) return text;
  const end = Math.floor((longest - 1) / 2);
  return `${text.slice(0, longest - 1 - end)}\u2026${text.slice(text.length - end)}`;
}

/**
 * Build an element: el("p.note#id", {title: "..."}, "text", child, null) or el("p", "text").
 * @param {string} selector tag, classes and id
 * @param {...unknown} rest attributes (null, undefined and false leave one out, true sets it empty), then children
 */
function el(selector, ...rest) {
  const attributes = rest[0]?.constructor === Object ? rest.shift() : {};
  const [tag] = selector.match(/^[a-z0-9]+/);
  const node = document.createElement(tag);
  for (const [part] of selector.slice(tag.length).matchAll(/[.#][\w-]+/g)) {
    if (part[0] === ".") node.classList.add(part.slice(1));
    else node.id = part.slice(1);
  }
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined && value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...rest.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== ""));
  return node;
}

/** Build an SVG element; its attributes must not come from the report data. */
function svg(tag, attributes = {}, ...children) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

/** A name, cut where it is long; its tooltip has the first 1000 characters. */
function nameElement(value, longest = LONGEST) {
  const text = short(value, longest);
  return el("span.name", { title: text.endsWith("\u2026") ? visible(value).slice(0, 1000) : null }, text);
}

/**
 * Turn `current` into `next` and keep unchanged nodes, and with them focus, text selection, open details and scroll
 * position. An element with data-keep is skipped: canvases and charts draw themselves.
 */
function morph(current, next) {
  if (current.dataset && "keep" in current.dataset) return;
  if (current.nodeType === Node.TEXT_NODE) {
    // Assigning the same text again would end a text selection.
    if (current.nodeValue !== next.nodeValue) current.nodeValue = next.nodeValue;
    return;
  }
  morphAttributes(current, next);
  const children = [...next.childNodes];
  children.forEach((child, k) => {
    const present = current.childNodes[k];
    if (present === undefined) current.append(child);
    else if (sameElement(present, child)) morph(present, child);
    else present.replaceWith(child);
  });
  while (current.childNodes.length > children.length) current.lastChild.remove();
}

function sameElement(a, b) {
  return a.nodeName === b.nodeName && a.id === b.id;
}

function morphAttributes(current, next) {
  const names = (node) => node.getAttributeNames().filter((name) => name !== "open"); // the reader folds <details>
  for (const name of names(current)) if (!next.hasAttribute(name)) current.removeAttribute(name);
  for (const name of names(next)) {
    if (current.getAttribute(name) !== next.getAttribute(name)) current.setAttribute(name, next.getAttribute(name));
  }
}

/** An entry of a legend: the mark of a class, and its meaning. */
function legendItem(mark, text) {
  return el("li", el(`span.${mark}`), text);
}

/** A list of definitions; rows without a value are left out. */
function definitions(kind, rows, attributes = {}) {
  const shown = rows.filter(([, value]) => value !== null && value !== "");
  return el(`dl${kind}`, attributes, shown.map(([name, value]) => el("div", el("dt", typeof name === "string" ? termed(name) : name), el("dd", value))));
}

/**
 * A table whose rows become cards on a narrow screen.
 * @param {string[]} heads names of the columns; one that begins with "#" contains numbers
 * @param {Array<Array<unknown>>} rows
 */
function table(heads, rows) {
  const label = (head) => head.replace(/^#/, "");
  const kind = (head) => (head.startsWith("#") ? "number" : null);
  const cell = (value, k) => el("td", { class: kind(heads[k]), "data-label": label(heads[k]) }, value);
  return el(
    "table",
    el("thead", el("tr", heads.map((head) => el("th", { scope: "col", class: kind(head) }, label(head))))),
    el("tbody", rows.map((row) => el("tr", row.map(cell)))),
  );
}

/**
 * The URL of a trajectory file relative to the run directory, or null for a path to anywhere else.
 * @param {string} path from the database, which may be forged
 */
function trajectoryUrl(path) {
  const parts = String(path).split("/");
  const unsafe = (part) => part === "" || part === "." || part === ".." || /[\\\u0000-\u001f]/.test(part);
  if (parts[0] !== "trajectories" || parts.some(unsafe)) return null;
  return parts.map(encodeURIComponent).join("/");
}

/** A link to a trajectory file; its name alone where the path is unsafe. */
function fileLink(path) {
  const href = trajectoryUrl(path);
  const name = nameElement(String(path).split("/").pop(), 60);
  return href === null ? name : el("a", { href, download: true }, name);
}

/** A command with a button that copies it; that of a report is for the folder in which the report lies. */
function commandLine(command) {
  if (!command) return "";
  return el("div.command", el("code", visible(command)), el("button.copy", { "data-copy": command }, "Copy"), document.body.dataset.live ? null : el("span.muted", "in the folder of this report"));
}

/** Copy the text of a button and show the result on it. */
async function copy(button) {
  button.textContent = (await copyText(button.dataset.copy)) ? "Copied" : "Copying failed";
  setTimeout(() => (button.textContent = "Copy"), 1500);
}

async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return copyBySelection(text); // a page without TLS has no clipboard
  }
}

function copyBySelection(text) {
  const area = el("textarea.offscreen", { readonly: true, "aria-hidden": "true" });
  area.value = text;
  document.body.append(area);
  area.select();
  const done = document.execCommand("copy");
  area.remove();
  return done;
}
