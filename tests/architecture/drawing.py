"""Diagrams as SVG: of states, with boxes at given places and arrows between them; and the floor plan of the code."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import NamedTuple

Point = tuple[float, float]
Pair = tuple[str, str]

HALF = (46.0, 17.0)
"""Half the width and the height of a box."""
STYLE = (
    "text{font:13px sans-serif;text-anchor:middle;dominant-baseline:central}"
    ".label{font-size:11.5px;fill:#444;paint-order:stroke;stroke:#fff;stroke-width:5px}"
    ".box{fill:#eaf2f8;stroke:#0072b2;stroke-width:1.4}.frame{fill:none;stroke:#999;stroke-dasharray:5 4}"
    ".edge{fill:none;stroke:#444;stroke-width:1.2;marker-end:url(#tip)}"
)
TIP = (
    '<marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" orient="auto">'
    '<path d="M0 1 L9 5 L0 9 z" fill="#444"/></marker>'
)


class Bend(NamedTuple):
    """Offset of an arrow from the straight line, to its left, and position of its label on it (0 to 1)."""

    by: float = 0.0
    label: float = 0.5


@dataclass(frozen=True)
class Layout:
    """Positions of the parts. `frame` is left, top, right, bottom; arrows begin and end at it by the name `FRAME`."""

    size: Point
    places: Mapping[str, Point]
    bends: Mapping[Pair, Bend] = field(default_factory=dict)
    frame: tuple[float, float, float, float] | None = None
    ports: Mapping[Pair, tuple[Point, Point]] = field(default_factory=dict)
    """Begin and end of arrows that touch the frame."""


FRAME = "frame"


def svg(layout: Layout, labels: Mapping[Pair, Sequence[str]]) -> str:
    """Return a diagram with one arrow for every pair of `labels`."""
    width, height = layout.size
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
        f'height="{height:g}" role="img">',
        f"<style>{STYLE}</style>",
        f"<defs>{TIP}</defs>",
        f'<rect width="{width:g}" height="{height:g}" fill="#fff"/>',
        *_frame(layout),
        *(line for pair in sorted(labels) for line in _arrow(layout, pair, labels[pair])),
        *(line for name in layout.places for line in _box(name, layout.places[name])),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _frame(layout: Layout) -> Iterator[str]:
    if layout.frame:
        left, top, right, bottom = layout.frame
        size = f'width="{right - left:g}" height="{bottom - top:g}"'
        yield f'<rect class="frame" x="{left:g}" y="{top:g}" {size} rx="12"/>'


def _box(name: str, place: Point) -> Iterator[str]:
    (x, y), (half_width, half_height) = place, HALF
    size = f'width="{2 * half_width:g}" height="{2 * half_height:g}"'
    yield f'<rect class="box" x="{x - half_width:g}" y="{y - half_height:g}" {size} rx="8"/>'
    yield f'<text x="{x:g}" y="{y:g}">{escape(name)}</text>'


def _arrow(layout: Layout, pair: Pair, events: Sequence[str]) -> Iterator[str]:
    bend = layout.bends.get(pair, Bend())
    if pair in layout.ports:
        begin, end = layout.ports[pair]
        control = _control(begin, end, bend.by)
    else:
        one, other = (layout.places[name] for name in pair)
        control = _control(one, other, bend.by)
        begin, end = _border(one, control), _border(other, control)
    path = " ".join(f"{x:.1f} {y:.1f}" for x, y in (control, end))
    yield f'<path class="edge" d="M{begin[0]:.1f} {begin[1]:.1f} Q{path}"/>'
    x, y = _on_curve(begin, control, end, bend.label)
    first = y - 7.5 * (len(events) - 1)
    for number, event in enumerate(events):
        yield f'<text class="label" x="{x:.1f}" y="{first + 15 * number:.1f}">{escape(event)}</text>'


def _control(begin: Point, end: Point, bend: float) -> Point:
    dx, dy = end[0] - begin[0], end[1] - begin[1]
    length = math.hypot(dx, dy)
    return (begin[0] + end[0]) / 2 + bend * dy / length, (begin[1] + end[1]) / 2 - bend * dx / length


def _border(centre: Point, towards: Point) -> Point:
    """Return where the line from the centre of a box leaves it."""
    dx, dy = towards[0] - centre[0], towards[1] - centre[1]
    share = min(half / abs(step) for half, step in zip(HALF, (dx, dy), strict=True) if step)
    return centre[0] + share * dx, centre[1] + share * dy


def _on_curve(begin: Point, control: Point, end: Point, at: float) -> Point:
    """Return a point of a quadratic Bezier curve."""
    weights = ((1 - at) ** 2, 2 * at * (1 - at), at**2)
    points = (begin, control, end)
    return (
        sum(weight * point[0] for weight, point in zip(weights, points, strict=True)),
        sum(weight * point[1] for weight, point in zip(weights, points, strict=True)),
    )


WIDTH, FLOOR, GAP, MARGIN = 1010.0, 44.0, 8.0, 24.0
DOT = " \u00b7 "


def plan(floors: Sequence[Sequence[str]], parts: Callable[[str], Sequence[str]]) -> str:
    """Return the floor plan of the orchestrator: a row for each floor, and the folders around it.

    `parts` returns the folders inside one.
    """
    left, right = MARGIN + 40.0, WIDTH - MARGIN - 220.0
    top, frame = MARGIN + FLOOR + 3 * GAP, len(floors) * (FLOOR + GAP)
    shapes = [_room(left, MARGIN, WIDTH - MARGIN - left, "perfbound", ["library"])]
    for number, rooms in enumerate(floors):
        inside = [parts(f"orchestrator/{name}") for name in rooms]
        needed = [24 + 10 * len(name) + 6.5 * len("   ".join(each)) for name, each in zip(rooms, inside, strict=True)]
        space, x = right - left - (len(rooms) - 1) * GAP, left
        for name, each, part in zip(rooms, inside, needed, strict=True):
            width = space * part / sum(needed)
            shapes.append(_room(x, top + GAP + number * (FLOOR + GAP), width, name, each))
            x += width + GAP
    corner, bottom = left - GAP, top + GAP + frame
    shapes.append(
        f'<rect class="frame" x="{corner}" y="{top}" width="{right - corner + GAP}" height="{frame + GAP}" rx="4"/>'
    )
    shapes.append(f'<text x="{right - 4}" y="{top - 9}" class="part">orchestrator</text>')
    beside = right + 3 * GAP
    shapes.append(_room(beside, bottom - FLOOR - GAP, WIDTH - MARGIN - beside, "workers", parts("workers")))
    shapes.append(_room(left, bottom + 2 * GAP, WIDTH - MARGIN - left, "schemas", parts("schemas")))
    height = bottom + 2 * GAP + FLOOR + MARGIN
    shapes.append(f'<path class="edge" d="M{MARGIN + 6} {MARGIN} V{height - MARGIN}"/>')
    middle = height / 2
    words = f'<text class="label" transform="translate({MARGIN - 8} {middle}) rotate(-90)">imports</text>'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {height:g}">'
    own = ".name{font-weight:bold;text-anchor:start}.part{font-size:11px;fill:#444;text-anchor:end}"
    return "\n".join([head, f"<style>{STYLE}{own}</style><defs>{TIP}</defs>", *shapes, words, "</svg>"]) + "\n"


def _room(x: float, y: float, width: float, name: str, parts: Sequence[str]) -> str:
    middle = y + FLOOR / 2
    return (
        f'<rect class="box" x="{x:.1f}" y="{y:g}" width="{width:.1f}" height="{FLOOR:g}" rx="4"/>'
        f'<text class="name" x="{x + 10:.1f}" y="{middle:g}">{name}</text>'
        f'<text class="part" x="{x + width - 10:.1f}" y="{middle:g}">{DOT.join(parts)}</text>'
    )
