// Paper: header and footer of each page, and long tables cut.

const PAPER_ROWS = 12; // of a table of rollouts

/** Mark the rows that paper leaves out; return the line that says so there. */
function shortenedOnPaper(tableElement, most, where) {
  const rows = [...tableElement.querySelectorAll("tbody tr")].slice(most);
  for (const row of rows) row.classList.add("screen");
  return rows.length ? el("p.on-paper", `and ${count(rows.length)} more, ${where}`) : null;
}

/** A string of CSS; every other character is escaped, so that no name can end it. */
function cssString(text) {
  return `"${[...visible(text)].map((each) => (/[\w ,.:()-]/.test(each) ? each : `\\${each.codePointAt(0).toString(16)} `)).join("")}"`;
}

let margins = null; // the rule of the page's margins

/**
 * Write name and run into the margins of each page. A browser that has no margin boxes prints its own header instead,
 * which has the title of the document: it names campaign and run, too.
 */
function writeMargins(report) {
  const name = short(report.name, 60);
  const box = (place, content) => `@${place} { content: ${content}; font: 8pt system-ui, sans-serif; color: #555c66; }`;
  const boxes = [
    box("top-left", cssString(name)),
    box("top-right", cssString("perfbound report")),
    box("bottom-left", cssString(`run ${short(report.run, 40)}`)),
    box("bottom-right", `${cssString("page ")} counter(page) ${cssString(" of ")} counter(pages)`),
  ].join(" ");
  const sheet = document.styleSheets[0];
  if (margins !== null) sheet.deleteRule(margins);
  margins = sheet.cssRules.length;
  try {
    sheet.insertRule(`@page { ${boxes} }`, margins);
  } catch {
    margins = null;
  }
}

let screenTitle = null;

function printTitle(report, begins) {
  if (begins) screenTitle = document.title;
  document.title = begins ? `${short(report.name, 60)}, run ${short(report.run, 40)}: perfbound report` : screenTitle;
}
