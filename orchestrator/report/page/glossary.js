// The meaning of every word and symbol of the page: a list at its end, and a link to it where a word stands as a label.

// `GLOSSARY`, word or symbol -> meaning, is glossary.json; it precedes the scripts of the page.

/** Label of the page -> its entry. */
const ENTRY = new Map(Object.entries({
  "Robustness": "margin, robustness, \u03c1", "Specification": "specification", "Starting conditions": "start d, starting conditions D",
  "Rollouts": "rollout", "Tests": "test, replicate", "Replicate": "test, replicate", "Variant": "system, nominal, true",
  "Bound": "bound, \u2113", "Bound so far": "bound, \u2113", "Opposite bound": "opposite bound", "Limit of the bound": "opposite bound",
  "Probability": "probability p, failure probability \u03b4", "Failure probability delta": "probability p, failure probability \u03b4",
  "Risk weight r": "risk, robustness risk, \u03c1*, risk weight r", "Robustness clipped to": "clip",
  "Stop threshold alpha": "alpha, stop threshold, \u03b1", "Horizon": "horizon", "Seed": "seed",
}));

function entryId(word) {
  return `word-${word.replaceAll(/[^a-z]+/gi, "-")}`;
}

/** Its meaning as text, without the marks of code. */
function meaningText(word) {
  return GLOSSARY[word].replaceAll("`", "");
}

/** A label, as a link to its entry where it has one; its meaning is also the tooltip. */
function termed(label) {
  const word = ENTRY.get(label);
  return word === undefined ? label : el("a.term", { href: `#${entryId(word)}`, title: meaningText(word) }, label);
}

/** Words of sentences, the longer ones first -> entry. */
const IN_SENTENCES = new Map([
  ["norm bound B", "B, norm bound"], ["norm bound", "B, norm bound"], ["length scale", "kernel, length scale"], ["kernel", "kernel, length scale"],
  ["prior mean", "prior mean m0"], ["fresh starts", "spot check"], ["expected robustness", "expectation E, standard deviation sd"],
  ["robustness risk", "risk, robustness risk, \u03c1*, risk weight r"], ["robustness", "margin, robustness, \u03c1"], ["clip", "clip"], ["Rollouts", "rollout"], ["rollouts", "rollout"],
]);
const WORDS = new RegExp(`\\b(${[...IN_SENTENCES.keys()].join("|")})\\b`);

/** A sentence whose first use of each word of the glossary is a link to it. */
function withTerms(text) {
  const seen = new Set();
  return sentence(text).split(WORDS).map((part, place) => {
    const word = place % 2 ? IN_SENTENCES.get(part) : undefined;
    if (word === undefined || seen.has(word)) return part;
    seen.add(word);
    return el("a.term", { href: `#${entryId(word)}`, title: meaningText(word) }, part);
  });
}

function glossarySection() {
  const entry = ([word, meaning]) => el(`div#${entryId(word)}`, el("dt", word), el("dd", meaning.split("`").map((part, place) => (place % 2 ? el("code", part) : part))));
  return el(
    "section#glossary",
    el("h2", "Words and symbols"),
    el("details.group", el("summary", plural(Object.keys(GLOSSARY).length, "word"), el("span.muted", " as this page uses them")), el("dl", Object.entries(GLOSSARY).map(entry))),
  );
}
