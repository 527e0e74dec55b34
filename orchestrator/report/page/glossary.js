// The meaning of every word and symbol of the page: a list at its end, and a link to it where a word stands as a label.

/** Word or symbol -> [meaning, labels of the page that link to it]. */
const GLOSSARY = {
  "robustness \u03c1": ["By how much a rollout meets the specification, in the unit of its limit: positive where it is met, negative where it is violated. The robustness of a start varies where the simulator is noisy.", ["Robustness", "Specification"]],
  "margin": ["The robustness that is guaranteed, or required. The campaign file says what is required (required_margin, by default 0).", []],
  "start d, starting conditions D": ["The values of the parameters at which a rollout begins, and the set of all of them that the claim covers.", ["Starting conditions"]],
  "rollout": ["One simulation from one start with one seed.", ["Rollouts"]],
  "test, replicate": ["The rollouts at one start that give one observation; each of them is a replicate.", ["Tests", "Replicate"]],
  "nominal, true": ["Two variants of a system: the model, and the system that the claim is about.", ["Variant"]],
  "bound \u2113": ["The number that the claim guarantees: the true value at the worst start is on the safe side of it.", ["Bound", "Bound so far"]],
  "opposite bound": ["The bound from the other side; each of the two holds with the stated probability.", ["Opposite bound", "Limit of the bound"]],
  "probability p, failure probability \u03b4": ["The claim is wrong with probability at most \u03b4 = 1 \u2212 p, over the noise of all rollouts and the random choices of the campaign.", ["Probability", "Failure probability delta"]],
  "expectation E, standard deviation sd": ["Mean and spread over the noise of the rollouts at one start.", []],
  "robustness risk \u03c1*, risk weight r": ["At the worst start: the mean of the robustness less r standard deviations.", ["Risk weight r"]],
  "clip": ["Robustness values beyond these two numbers count as the nearer one. A bound at the lower clip holds without any rollout, and shows nothing.", ["Robustness clipped to"]],
  "stop threshold \u03b1": ["The tests end when bound and opposite bound are this close; a smaller one costs more tests.", ["Stop threshold alpha"]],
  "U \u2212 L, F": ["How far apart the upper and the lower bound are after a test (F in method paper).", []],
  "norm bound B": ["How much the objective may vary, measured in the norm of the kernel: the main assumption of a claim about every start of a box.", []],
  "kernel, length scale": ["The model of smoothness: starts closer than a length scale have similar values.", []],
  "prior mean m0": ["What the objective is expected to be before any rollout; B measures the deviation from it.", []],
  "noise scale R": ["How much one rollout may deviate from the mean of its start.", []],
  "y, J": ["An observation: the mean of a test's rollouts. J is the quantity that the campaign maximises; for a margin it is the negative robustness.", []],
  "spot check": ["Fresh starts, drawn at random after the campaign, at which the bound is tested without a kernel.", []],
  "recheck": ["Recorded rollouts that are simulated once more and compared bit by bit.", []],
  "evidence": ["How strongly the rollouts contradict an assumption: 1 is neutral, and 20 refutes at confidence .95.", []],
  "horizon": ["The simulated time of a rollout.", ["Horizon"]],
  "seed": ["The number that all random choices follow from; the same seed gives the same rollouts.", ["Seed"]],
};
const ENTRY = new Map(Object.entries(GLOSSARY).flatMap(([word, [, labels]]) => labels.map((label) => [label, word])));

function entryId(word) {
  return `word-${word.replaceAll(/[^a-z]+/gi, "-")}`;
}

/** A label, as a link to its entry where it has one; its meaning is also the tooltip. */
function termed(label) {
  const word = ENTRY.get(label);
  return word === undefined ? label : el("a.term", { href: `#${entryId(word)}`, title: GLOSSARY[word][0] }, label);
}

/** Words of sentences, the longer ones first -> entry. */
const IN_SENTENCES = new Map([
  ["norm bound B", "norm bound B"], ["norm bound", "norm bound B"], ["length scale", "kernel, length scale"], ["kernel", "kernel, length scale"],
  ["prior mean", "prior mean m0"], ["fresh starts", "spot check"], ["expected robustness", "expectation E, standard deviation sd"],
  ["robustness risk", "robustness risk \u03c1*, risk weight r"], ["robustness", "robustness \u03c1"], ["clip", "clip"], ["Rollouts", "rollout"], ["rollouts", "rollout"],
]);
const WORDS = new RegExp(`\\b(${[...IN_SENTENCES.keys()].join("|")})\\b`);

/** A sentence whose first use of each word of the glossary is a link to it. */
function withTerms(text) {
  const seen = new Set();
  return sentence(text).split(WORDS).map((part, place) => {
    const word = place % 2 ? IN_SENTENCES.get(part) : undefined;
    if (word === undefined || seen.has(word)) return part;
    seen.add(word);
    return el("a.term", { href: `#${entryId(word)}`, title: GLOSSARY[word][0] }, part);
  });
}

function glossarySection() {
  const entry = ([word, [meaning]]) => el(`div#${entryId(word)}`, el("dt", word), el("dd", meaning));
  return el(
    "section#glossary",
    el("h2", "Words and symbols"),
    el("details.group", el("summary", plural(Object.keys(GLOSSARY).length, "word"), el("span.muted", " as this page uses them")), el("dl", Object.entries(GLOSSARY).map(entry))),
  );
}
