"""The argument of a safety case as a drawing: goals, strategies, solutions and contexts in their usual shapes."""

import re
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, FancyArrowPatch, FancyBboxPatch, Polygon, Rectangle

from ...report.style import BLUE, GREY, RED
from .argument import Element, Kind

WIDTH = 20.0
"""Inches of a drawing, before a page scales it."""
LETTERS = 0.077
"""Inches of a letter, on average, at `SIZE`."""
SIZE, LINE = 8.0, 0.155
"""Points of the text, and inches from line to line."""
PAD, GAP, LEVEL = 0.14, 0.22, 0.42
"""Inches inside a box, between two boxes, and between two levels."""
SLANT = 0.05
"""Of a parallelogram, as a share of its width."""
FONT = "DejaVu Sans"
THIN, THICK = 0.9, 1.6
"""Points of a line, and of one around what is refuted."""
FILL: dict[Kind, str] = {
    "G": "#eef4fb",
    "S": "#f3f0fa",
    "Sn": "#edf7f1",
    "C": "#f6f6f6",
    "A": "#fdf6e7",
    "J": "#f6f6f6",
}
LEFT = 12.4
"""Inches of the argument; assumptions are on its right."""


@dataclass(frozen=True, slots=True)
class Box:
    """An element with its place: the middle of its upper edge, in inches from the upper left corner."""

    element: Element
    lines: tuple[str, ...]
    x: float
    y: float
    width: float
    height: float

    @property
    def bottom(self) -> float:
        """The lower edge."""
        return self.y + self.height


@contextmanager
def missing_letters() -> Iterator[None]:
    """Draw a letter that the font has not as a box, without a warning."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        yield


def drawing(elements: Sequence[Element], title: str) -> Figure:
    """Return the drawing of an argument, as high as it has to be."""
    boxes = {box.element.id: box for box in placed(elements)}
    height = max(box.bottom for box in boxes.values()) + 3 * PAD
    figure = Figure(figsize=(WIDTH, height), layout=None)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, WIDTH), ylim=(height, 0.0))
    axes.set_axis_off()
    axes.text(PAD, 2.2 * PAD, title, fontsize=SIZE + 4, fontfamily=FONT, va="center", weight="bold")
    for each in elements:
        for other in each.supported_by:
            _arrow(axes, boxes[each.id], boxes[other], filled=True)
        for other in each.in_context_of:
            if boxes[other].element.kind != "A":
                _arrow(axes, boxes[each.id], boxes[other], filled=False)
    for box in boxes.values():
        _draw(axes, box)
    _around(axes, boxes)
    if any(each.undeveloped for each in elements):
        legend = "A diamond below a goal: its argument is missing."
        axes.text(WIDTH - PAD, 2.2 * PAD, legend, fontsize=SIZE, fontfamily=FONT, va="center", ha="right")
    return figure


def placed(elements: Sequence[Element]) -> Iterator[Box]:
    """Yield the elements with their places: contexts beside the goal, assumptions on the right of all below it."""
    known = {each.id: each for each in elements}
    goal, strategy = known["G1"], known["S1"]
    # The first context on the left of the goal, the others below each other on its right.
    system, *others = (known[name] for name in goal.in_context_of)
    boxes = list(_row([system, goal, goal], [1.0, 1.4, 1.4], 4 * PAD, WIDTH))
    yield from boxes[:2]
    beside = 4 * PAD
    for each in others:
        box = _box(each, boxes[2].x, beside, boxes[2].width)
        yield box
        beside = box.bottom + PAD
    top = max(*(box.bottom for box in boxes[:2]), beside - PAD) + LEVEL
    assumed = [known[name] for name in strategy.in_context_of if name.startswith("A")]
    below, left = top, LEFT if assumed else WIDTH
    half = (WIDTH - LEFT - 3 * GAP) / 2
    for first in range(0, len(assumed), 2):
        pair = [
            _box(each, LEFT + GAP + half / 2 + k * (half + GAP), below, half)
            for k, each in enumerate(assumed[first : first + 2])
        ]
        yield from pair
        below = max(box.bottom for box in pair) + PAD
    row = [*(known[name] for name in strategy.in_context_of if name.startswith("J")), strategy]
    shares = [1.0, 1.4]
    yield from _row(row, shares, top, left)
    below = top + _height(row, shares, left) + LEVEL
    goals = [known[name] for name in strategy.supported_by]
    shares = [1.0] * len(goals)
    yield from _row(goals, shares, below, left)
    solutions = below + _height(goals, shares, left) + LEVEL
    for box in _row(goals, shares, below, left):
        for name in box.element.supported_by:
            yield _box(known[name], box.x, solutions, box.width)


def _row(row: Sequence[Element], shares: Sequence[float], y: float, width: float) -> Iterator[Box]:
    """Yield elements side by side over a width, as wide as their shares."""
    left = GAP
    for each, own in zip(row, _widths(shares, width), strict=True):
        yield _box(each, left + own / 2, y, own)
        left += own + GAP


def _widths(shares: Sequence[float], width: float) -> list[float]:
    whole = width - GAP * (len(shares) + 1)
    return [whole * share / sum(shares) for share in shares]


def _height(row: Sequence[Element], shares: Sequence[float], width: float) -> float:
    return max(box.height for box in _row(row, shares, 0.0, width))


def _box(element: Element, x: float, y: float, width: float) -> Box:
    # Of an ellipse the corners are no place for text, of a parallelogram its ends are none.
    room = width * (0.72 if element.kind in ("Sn", "A", "J") else 0.86) - 2 * PAD
    head, *rest = f"{element.id}  {element.text}".split("\n")
    letters = max(int(room / LETTERS), 13)
    # Ids are long words: they are divided behind a line or a stroke.
    parts = (re.sub(rf"\S{{{letters},}}", _divided, part) for part in (head, *rest))
    lines = [line for part in parts for line in textwrap.wrap(part, letters)]
    height = LINE * len(lines) * (1.35 if element.kind in ("Sn", "A", "J") else 1.0) + 3 * PAD
    return Box(element, tuple(lines), x, y, width, height)


def _divided(found: re.Match[str]) -> str:
    return re.sub(r"([_/])", r"\1 ", found[0])


def _draw(axes: Axes, box: Box) -> None:
    x, y, w, h, kind = box.x, box.y, box.width, box.height, box.element.kind
    edge = RED if box.element.refuted else GREY
    style: dict[str, Any] = {
        "facecolor": FILL[kind],
        "edgecolor": edge,
        "linewidth": THICK if box.element.refuted else THIN,
        "zorder": 3,
    }
    middle = y + h / 2
    if kind in ("Sn", "A", "J"):
        axes.add_patch(Ellipse((x, middle), w, h, **style))
    elif kind == "S":
        slant = SLANT * w
        left, right = x - w / 2, x + w / 2
        axes.add_patch(Polygon([(left + slant, y), (right, y), (right - slant, y + h), (left, y + h)], **style))
    else:
        rounding = 0.16 if kind == "C" else 0.001
        corner = x - w / 2 + rounding, y + rounding
        shape = f"round,pad={rounding},rounding_size={rounding}"
        axes.add_patch(FancyBboxPatch(corner, w - 2 * rounding, h - 2 * rounding, boxstyle=shape, **style))
    if kind in ("A", "J"):
        # On the left of a justification, whose right is crossed by arrows.
        place = x + w * (0.44 if kind == "A" else -0.44)
        axes.text(place, y + h * 0.96, kind, fontsize=SIZE, fontfamily=FONT, ha="center", weight="bold")
    if box.element.undeveloped:
        below = y + h
        axes.add_patch(Polygon([(x, below), (x + 0.1, below + 0.1), (x, below + 0.2), (x - 0.1, below + 0.1)], **style))
    text = "\n".join(each.replace("$", r"\$") for each in box.lines)
    colour = RED if box.element.refuted else "black"
    axes.text(
        x,
        middle,
        text,
        fontsize=SIZE,
        fontfamily=FONT,
        ha="center",
        va="center",
        color=colour,
        zorder=4,
        linespacing=1.3,
    )


def _arrow(axes: Axes, one: Box, other: Box, *, filled: bool) -> None:
    if filled:
        start, end = (one.x, one.bottom), (other.x, other.y)
    else:
        side = 1 if other.x > one.x else -1
        slant = SLANT * one.width / 2 if one.element.kind == "S" else 0.0
        start = one.x + side * (one.width / 2 - slant), one.y + one.height / 2
        end = other.x - side * other.width / 2, other.y + other.height / 2
    head = "-|>" if filled else "->"
    axes.add_patch(
        FancyArrowPatch(start, end, arrowstyle=head, mutation_scale=11, color=GREY, linewidth=THIN, zorder=2, shrinkA=0)
    )


def _around(axes: Axes, boxes: Mapping[str, Box]) -> None:
    """Draw a frame around the assumptions, with one arrow from their strategy."""
    inside = [box for box in boxes.values() if box.element.kind == "A"]
    if not inside:
        return
    y, bottom = min(box.y for box in inside) - PAD, max(box.bottom for box in inside) + PAD
    dashed: dict[str, Any] = {"edgecolor": BLUE, "linestyle": (0, (4, 3)), "linewidth": THIN, "zorder": 1}
    axes.add_patch(Rectangle((LEFT, y), WIDTH - LEFT - GAP / 2, bottom - y, facecolor="none", **dashed))
    strategy = boxes["S1"]
    start = strategy.x + (1 - SLANT) * strategy.width / 2, strategy.y + strategy.height / 2
    end = LEFT, start[1]
    style: dict[str, Any] = {"arrowstyle": "->", "mutation_scale": 11, "shrinkA": 0, "shrinkB": 0}
    axes.add_patch(FancyArrowPatch(start, end, color=BLUE, linewidth=THIN, **style))
