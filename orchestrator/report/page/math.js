// Formulas of the claims as MathML, which every current browser typesets by itself.

const MATHML = "http://www.w3.org/1998/Math/MathML";

/** Build a MathML element; text and elements as children. */
function mathNode(tag, ...children) {
  const node = document.createElementNS(MATHML, tag);
  node.append(...children.flat(Infinity).filter((child) => child !== null));
  return node;
}

const mathRow = (...parts) => mathNode("mrow", parts);
const mathLetter = (text) => mathNode("mi", text);
const mathSign = (text) => mathNode("mo", text);
const mathNumber = (text) => mathNode("mn", text.replace("-", "\u2212"));
const mathUpright = (text) => {
  const node = mathNode("mi", text);
  node.setAttribute("mathvariant", "normal");
  return node;
};
const mathSubscript = (base, below) => mathNode("msub", base, below);
const mathSuperscript = (base, above) => mathNode("msup", base, above);
const mathBelow = (name, under) => mathNode("munder", mathSign(name), under);
const mathBracketed = (open, content, close) => mathRow(mathSign(open), content, mathSign(close));

/** The robustness of a rollout, at a start where `start` is given. */
function robustnessOf(claim, start) {
  const rho = claim.requirement === null ? mathLetter("\u03c1") : mathSubscript(mathLetter("\u03c1"), mathNode("mtext", short(claim.requirement, 30)));
  return start === undefined ? rho : mathRow(rho, mathBracketed("(", start, ")"));
}

const mathMean = (content) => mathRow(mathUpright("E"), mathBracketed("[", content, "]"));
const mathChance = (content) => mathRow(mathUpright("P"), mathBracketed("[", content, "]"));
const mathSpread = (content) => mathRow(mathUpright("sd"), mathBracketed("[", content, "]"));
/** The risk of what `rho` builds: a node can stand in one place only. */
const riskOf = (rho) => mathRow(mathMean(rho()), mathSign("\u2212"), mathLetter("r"), mathSpread(rho()));

/** The set of starts under a minimum or maximum. */
function startsOf(claim) {
  const all = mathRow(mathLetter("d"), mathSign("\u2208"), mathLetter("D"));
  if (claim.starts === null) return all;
  return mathRow(mathLetter("d"), mathSign("\u2208"), mathBracketed("{", mathRow(mathSubscript(mathLetter("d"), mathNumber("1")), mathSign("\u2026"), mathSubscript(mathLetter("d"), mathNumber(String(claim.starts)))), "}"));
}

/** What a claim bounds: quantity -> its definition. */
const DEFINITIONS = {
  rho_star: (claim) => {
    const rho = () => robustnessOf(claim, mathLetter("d"));
    return mathRow(mathSuperscript(mathLetter("\u03c1"), mathSign("*")), mathSign("="), mathBelow("min", startsOf(claim)), mathBracketed("(", riskOf(rho), ")"));
  },
  J_star: (claim) => mathRow(mathSuperscript(mathLetter("J"), mathSign("*")), mathSign("="), mathBelow("max", startsOf(claim)), mathMean(mathRow(mathLetter("J"), mathBracketed("(", mathLetter("d"), ")")))),
  robustness: (claim) => mathRow(mathBelow("min", startsOf(claim)), robustnessOf(claim, mathLetter("d"))),
  expected_robustness: (claim) => mathRow(mathBelow("min", startsOf(claim)), mathMean(robustnessOf(claim, mathLetter("d")))),
  failure_probability: (claim) => mathChance(mathRow(robustnessOf(claim), mathSign("<"), mathNumber("0"))),
  mean: (claim) => mathMean(robustnessOf(claim)),
  risk: (claim) => riskOf(() => robustnessOf(claim)),
  quantile: (claim) => (claim.level === null ? null : mathRow(mathSubscript(mathLetter("q"), mathNumber(num(claim.level))), mathBracketed("(", robustnessOf(claim), ")"))),
  cvar: (claim) => (claim.level === null ? null : mathRow(mathSubscript(mathUpright("CVaR"), mathNumber(num(claim.level))), mathBracketed("(", robustnessOf(claim), ")"))),
};

/** The formula of a claim, or null where words say it better. */
function formulaOf(claim) {
  const define = Object.hasOwn(DEFINITIONS, claim.quantity) ? DEFINITIONS[claim.quantity] : null;
  const subject = claim.factor !== null && claim.factor !== 1 ? null : define && define(claim);
  if (!subject || claim.rule === "every") return null;
  const bound = mathRow(subject, mathSign(SIGN[claim.sense]), mathNumber(outward(claim.bound, claim.sense)));
  if (claim.probability === 1) return mathNode("math", bound);
  return mathNode("math", mathChance(mathRow(bound)), mathSign("\u2265"), mathNumber(outward(claim.probability, ">=")));
}
