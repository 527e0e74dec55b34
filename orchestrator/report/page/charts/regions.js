// Section of the regions: shares, slices through the box with their tests, and the largest certified boxes.

/** Colour of each status, from dark to light also in greyscale; undecided is hatched. */
const REGION = { safe: "#a6dba0", unsafe: "#762a83", undecided: "#f7f7f7" };
const STATUSES = ["safe", "unsafe", "undecided"]; // the digits of the cells of a slice
const STRIP = 26; // pixels: height of the slice of the only parameter

function regionSection(report, problem, index) {
  const { regions } = problem;
  if (regions === null) return null;
  const { axes } = report;
  return el(
    `section.regions#regions-${index}`,
    el("h2", "Where it is safe"),
    el("ul", regions.sentences.map((line) => el("li", line.includes("REFUTED") ? { class: "bad" } : {}, sentence(line, 300)))),
    el("div.slices", regions.slices.map((slice, k) => sliceFigure(axes, regions, slice, `${index}-${k}`))),
    regions.slices.length ? [regionLegend(regions, axes.length > 2), caption(regionCaption(axes))] : el("p.bad", "regions.csv is missing, or not the one that the certificate names."),
    axes.length > 2 ? largestBoxes(axes, regions) : null,
  );
}

function regionCaption(axes) {
  const plane = axes.length > 2 ? " Each picture is a plane through the worst observed start." : "";
  return `Every start of a certified box has the sign of its colour, all at once with the probability of the claim; of a hatched one nothing is shown.${plane}`;
}

function sliceFigure(axes, regions, slice, id) {
  const names = slice.axes.map((k) => short(axes[k].name, 40)).join(" and ");
  const others = axes.map((axis, k) => [axis, k]).filter(([, k]) => !slice.axes.includes(k));
  const at = others.map(([axis, k]) => place([slice.through[k]], [axis])).join(", ");
  const title = `Regions of ${names}${at && `, at ${at}`}`;
  return el(
    `figure.slice${slice.axes.length === 1 ? ".strip" : ""}`,
    el("figcaption", title),
    el(`canvas#slice-${id}`, { "data-keep": true, role: "img", "aria-label": `${title}: ${sharesOf(regions).map((share, k) => `${STATUSES[k]} ${share}`).join(", ")}` }),
  );
}

function regionLegend(regions, sliced) {
  const mark = (share, k) => legendItem(`mark.region-${STATUSES[k]}`, `${k === 2 ? "" : "certified "}${STATUSES[k]}, ${share} of the box`);
  return el("ul.legend", sharesOf(regions).map(mark), legendItem("mark.dot", sliced ? "worst observed start, which every slice goes through" : "test"));
}

/** The shares in the order of STATUSES: the certified ones rounded down, so that the undecided one takes the rest. */
function sharesOf({ safe, unsafe }) {
  const [first, second] = [safe, unsafe].map((share) => Math.floor(share * 1000 + 1e-6));
  return [first, second, 1000 - first - second].map((share) => `${(share / 10).toFixed(1)} %`);
}

function largestBoxes(axes, { largest }) {
  const rows = largest.map(({ status, low, high, share }) => [status, ...low.map((value, k) => `${num(value)} to ${num(high[k])}`), `${num(100 * share, 3)} %`]);
  return el("div", el("h3", "Largest certified boxes"), table(["status", ...axes.map((axis) => withUnit(axis.name, axis.unit)), "#share of the box"], rows));
}

/** Draw every slice of a problem over the width of its canvas. */
function drawRegions(report, problem, index) {
  problem.regions?.slices.forEach((slice, k) => {
    const canvas = document.getElementById(`slice-${index}-${k}`);
    if (canvas.clientWidth > 0) drawSlice(canvas, report, problem, slice);
  });
}

function drawSlice(canvas, report, problem, slice) {
  const model = sliceModel(report, problem, slice, canvas.clientWidth);
  const context = canvasContext(canvas, canvas.clientWidth, model.height);
  drawCells(context, model, slice);
  drawAxes(context, model);
  for (const at of model.dots) disc(context, at, 3, WHITE, BLACK);
  Object.assign(canvas.dataset, { cells: slice.cells.length, problem: problem.name });
}

function sliceModel(report, problem, slice, width) {
  const axes = axesOf(report, slice.axes);
  const [first, second] = axes;
  const strip = second === undefined;
  const box = { left: MARGIN.left, top: strip ? 4 : MARGIN.top, width: Math.max(80, width - MARGIN.left - MARGIN.right) };
  const ratio = !strip && first.unit === second.unit ? (second.high - second.low) / (first.high - first.low) : 0;
  box.height = strip ? STRIP : box.width * (ratio > 0.4 && ratio < 1.3 ? ratio : 0.7);
  const at = frame(box, [first.low, first.high], strip ? [0, 1] : [second.low, second.high]);
  // In more dimensions only the start that the slice goes through is in it.
  const starts = report.axes.length > 2 ? [slice.through] : dotsOf(report, problem).map(({ x }) => x);
  const dots = starts.map((x) => [at.toX(x[slice.axes[0]]), strip ? box.top + STRIP / 2 : at.toY(x[slice.axes[1]])]);
  return { ...at, dots, kind: strip ? "strip" : "slice", axes, problem, height: box.top + box.height + MARGIN.bottom };
}

function drawCells(context, { box }, { shape: [columns, rows = 1], cells }) {
  const picture = new OffscreenCanvas(columns, rows);
  const pixels = new ImageData(columns, rows);
  const colours = STATUSES.map((name) => [1, 3, 5].map((k) => parseInt(REGION[name].slice(k, k + 2), 16)));
  const open = new Path2D();
  const { toX, toY } = frame(box, [0, columns], [0, rows]);
  [...cells].forEach((digit, n) => {
    const [i, j] = [Math.floor(n / rows), n % rows];
    // Rows of an image run downwards, the second parameter upwards.
    pixels.data.set([...colours[digit], 255], 4 * ((rows - 1 - j) * columns + i));
    if (STATUSES[digit] === "undecided") open.rect(toX(i), toY(j + 1), box.width / columns, box.height / rows);
  });
  picture.getContext("2d").putImageData(pixels, 0, 0);
  context.imageSmoothingEnabled = false;
  context.drawImage(picture, box.left, box.top, box.width, box.height);
  context.save();
  context.clip(open);
  context.strokeStyle = "#9a9a9a";
  context.lineWidth = 1;
  for (let x = box.left - box.height; x < box.left + box.width; x += 6) line(context, x, box.top + box.height, x + box.height, box.top);
  context.restore();
}
