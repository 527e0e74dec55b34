"""State diagrams as SVG: boxes at given places, arrows between them, a frame around boxes that share arrows."""

import math
from collections.abc import Iterator, Mapping, Sequence
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
