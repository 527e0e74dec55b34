"""A safety case as a document of at most four pages: claim, what it rests on, what was not checked, who signed."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font

from ...report.style import GREEN, GREY, RED
from .argument import argument
from .case import Named, SafetyCase
from .drawing import FONT, drawing, missing_letters

MOST_PAGES = 4
WIDTH, HEIGHT = 8.27, 11.69
"""Inches of a page: A4."""
MARGIN = 0.8
TOGETHER = 8
"""Lines of a row that are not divided between two pages."""
NAMES = 1.3
"""Inches of the first column of a table."""
STYLE: dict[Any, Any] = {
    # Text stays text, which readers can search and copy.
    "pdf.fonttype": 42,
    # Equal documents are equal bytes on all machines, whatever library compresses there.
    "pdf.compression": 0,
    "font.family": FONT,
}
AMBER = "#8a5a00"
COLOURS = {"SHOWN": GREEN, "VIOLATED": RED, "NOT SHOWN": AMBER, "refuted": RED}
STATUSES = ("refuted", "assumed", "not refuted", "derived")


@dataclass(frozen=True, slots=True)
class _Form:
    """How much a page has."""

    size: float
    """Of the text, in points."""
    details: bool = True
    """Whether assumptions have theirs."""
    most: int = 1000
    """Rows of a table."""
    letters: int = 20_000
    """Of one text."""


FORMS = (
    _Form(9.0),
    _Form(8.0),
    _Form(7.0),
    _Form(7.0, details=False),
    _Form(7.0, details=False, most=40, letters=800),
    _Form(7.0, details=False, most=12, letters=400),
    _Form(6.0, details=False, most=5, letters=200),
)
"""The first one whose pages are few enough is taken; the certificate has what the others leave out."""


Part = tuple[float, str, dict[str, Any]]
"""Place, text and style of a text in a line."""


@dataclass(slots=True)
class _Flow:
    """Lines that fill pages from above."""

    size: float
    letters: int
    """Of one text; a longer one is cut."""
    pages: list[Figure] = field(default_factory=list)
    _y: float = 0.0

    def _ends(self, lines: float) -> bool:
        """Whether the page ends before so many lines."""
        return self._y + lines * self._step > HEIGHT - MARGIN

    @property
    def _step(self) -> float:
        """Inches from line to line."""
        return self.size * 1.36 / 72.0

    def line(self, parts: Sequence[Part], lines: float = 1.0) -> None:
        """Put texts at their places (inches from the margin) into one line; on a new page where this one is full."""
        if not self.pages or self._ends(lines):
            self.pages.append(Figure(figsize=(WIDTH, HEIGHT)))
            self._y = MARGIN
        self._y += lines * self._step
        for x, text, style in parts:
            options = {"fontsize": self.size, "va": "baseline", **style}
            shown = text.replace("$", r"\$")
            self.pages[-1].text((MARGIN + x) / WIDTH, 1.0 - self._y / HEIGHT, shown, **options)

    def space(self, lines: float) -> None:
        """Leave so many lines empty, unless the page is."""
        self._y += lines * self._step

    def heading(self, text: str) -> None:
        """Put a heading, with the next three lines on its page."""
        if self._ends(5):
            self._y = HEIGHT
        self.space(0.9)
        self.line([(0.0, text, {"weight": "bold", "fontsize": self.size * 1.25})], 1.3)
        self.space(0.2)

    def _cut(self, text: str) -> str:
        return text if len(text) <= self.letters else f"{text[: self.letters]}... (cut)"

    def paragraph(self, text: str, indent: float = 0.0, **style: Any) -> None:
        """Put a text in as many lines as it takes."""
        for each in wrapped(
            self._cut(text), self.size, WIDTH - 2 * MARGIN - indent, bold=style.get("weight") == "bold"
        ):
            self.line([(indent, each, style)])

    def row(self, name: str, text: str, **style: Any) -> None:
        """Put a name in front of a text, on one page where it is short."""
        names = wrapped(self._cut(name), self.size, NAMES - 0.1)
        texts = wrapped(self._cut(text), self.size, WIDTH - 2 * MARGIN - NAMES)
        lines = max(len(names), len(texts))
        if lines <= TOGETHER and self._ends(lines):
            self._y = HEIGHT
        for k in range(lines):
            parts: list[Part] = [(0.0, names[k], {"color": GREY})] if k < len(names) else []
            parts += [(NAMES, texts[k], style)] if k < len(texts) else []
            self.line(parts)


def to_pdf(case: SafetyCase) -> bytes:
    """Return the document of a safety case; equal cases give equal bytes.

    What does not fit on the pages is shortened, the details of assumptions first: the certificate has all.
    """
    with mpl.rc_context(STYLE), missing_letters():
        pages = [*text_pages(case), drawing(argument(case), f"Argument: {case.campaign}")]
        for number, page in enumerate(pages, 1):
            foot = f"{case.campaign}, certificate {case.certificate_sha256[:16]}..., page {number} of {len(pages)}"
            place = (MARGIN / WIDTH, 0.03) if number < len(pages) else (0.01, 0.012)
            page.text(*place, foot, fontsize=7, color=GREY)
        out = io.BytesIO()
        about = {"Title": f"Safety case of {case.campaign}", "CreationDate": None, "Producer": None, "Creator": None}
        with PdfPages(out, metadata=about) as file:
            for page in pages:
                file.savefig(page)
    return out.getvalue()


def text_pages(case: SafetyCase) -> list[Figure]:
    """Return the pages before the drawing, in the largest type in which they are few enough."""
    with missing_letters():
        flows = (_pages(case, form) for form in FORMS)
        found = next((each for each in flows if len(each) < MOST_PAGES), None)
        return found or _pages(case, FORMS[-1])[: MOST_PAGES - 1]


def _pages(case: SafetyCase, form: _Form) -> list[Figure]:
    flow, most, details = _Flow(form.size, form.letters), form.most, form.details
    flow.line([(0.0, f"Safety case of the campaign {case.campaign}", {"weight": "bold", "fontsize": 15})], 2.2)
    flow.space(0.5)
    flow.paragraph(case.answer, weight="bold", color=AMBER if "rests on" in case.answer else COLOURS[case.verdict])
    flow.space(0.3)
    flow.paragraph(
        "The margin, or robustness, of a simulated run is by how much it meets its specification: below 0 it violates "
        "it. The numbers of the claims are those of the certificate, rounded to the safe side; their probability is "
        "over the chance in the rollouts of the campaign. This is evidence from simulation, one part of an assessment: "
        "hazards, and what was not simulated, are not its subject."
    )
    flow.heading("1  What is claimed")
    _table(flow, case.requirements, most)
    if case.question:
        flow.row("required", case.question)
    if case.verdict != "SHOWN":
        for text in case.reasons[:most]:
            flow.row(case.verdict.lower(), text, color=COLOURS[case.verdict])
    for number, each in enumerate(case.claims[:most], 1):
        about = f", about {each.requirement}" if each.requirement else ""
        flow.row(f"claim {number}{about}", sentence(each.sentence), color=RED if each.refuted else "black")
        for note in each.notes[: most if details else 1]:
            flow.row("", note)
    _more(flow, len(case.claims), most)
    _table(flow, case.system, most)
    flow.heading("2  Where it holds: the operational design domain, as far as it was simulated")
    _table(flow, case.domain, most)
    flow.heading("3  What it rests on, and who must judge it")
    flow.paragraph(
        "Refuted: the data contradict it. Assumed: no data of the campaign test it. Not refuted: the data test it, and "
        "do not contradict it. Derived: it follows from the method. A claim counts all on which it rests as its "
        "assumptions, the derived ones too. A1, A2 and so on are those of the drawing."
    )
    for status in STATUSES:
        for number, found in enumerate(case.with_status(status)[:most], 1):
            judge = "" if status == "derived" else f" To be judged by {found.judge}."
            name = f"{status}, A{number}" if status == "assumed" else status
            flow.row(name, f"{found.title} ({found.id}).{judge}", color=COLOURS.get(status, "black"))
            if details:
                flow.row("", sentence(found.detail), color=GREY)
        _more(flow, len(case.with_status(status)), most)
    flow.heading("4  What was checked")
    for text in case.checks[:most]:
        flow.paragraph(text)
    flow.paragraph(f"{case.verification}.")
    flow.heading("5  What was not checked, and is not claimed")
    for text in case.unchecked[: max(most, 20)]:
        flow.paragraph(f"\u2022  {text}")
    flow.heading("6  Evidence and signature")
    flow.paragraph("Digests are SHA-256; that of the certificate names all others.")
    _table(flow, case.evidence, most)
    for text in case.signatures[:most]:
        flow.paragraph(text, weight="bold")
    flow.heading("7  Words")
    _table(flow, case.words, most)
    return flow.pages


def sentence(text: str) -> str:
    """Return a text with a capital at its beginning and a full stop at its end.

    >>> sentence("the bound contains both"), sentence("Do not rely on it.")
    ('The bound contains both.', 'Do not rely on it.')
    """
    return f"{text[:1].upper()}{text[1:]}".removesuffix(".") + "."


def _table(flow: _Flow, rows: Sequence[Named], most: int) -> None:
    for each in rows[:most]:
        flow.row(each.name, each.text)
    _more(flow, len(rows), most)


def _more(flow: _Flow, number: int, most: int) -> None:
    if number > most:
        flow.row("", f"and {number - most:,} more, which the certificate has")


def wrapped(text: str, size: float, width: float, *, bold: bool = False) -> list[str]:
    """Return a text in lines that are no wider than `width` inches; a longer word is cut."""
    blank = _inches("a a", size, bold=bold) - _inches("aa", size, bold=bold)
    lines, line, filled = list[str](), list[str](), 0.0
    for word in text.split():
        for part in _cut(word, size, width, bold=bold):
            needed = _inches(part, size, bold=bold)
            if line and filled + blank + needed > width:
                lines.append(" ".join(line))
                line, filled = [part], needed
            else:
                filled += needed + (blank if line else 0.0)
                line.append(part)
    return [*lines, " ".join(line)]


def _cut(word: str, size: float, width: float, *, bold: bool) -> Iterator[str]:
    while len(word) > 1 and _inches(word, size, bold=bold) > width:
        fits = max(int(len(word) * width / _inches(word, size, bold=bold)), 1)
        yield word[:fits]
        word = word[fits:]
    yield word


@lru_cache(maxsize=50_000)
def _inches(text: str, size: float, *, bold: bool) -> float:
    font = get_font(findfont(FontProperties(family=FONT, weight="bold" if bold else "normal")))
    font.set_size(size, 72)
    font.set_text(text, 0.0)
    return float(font.get_width_height()[0]) / 64.0 / 72.0
