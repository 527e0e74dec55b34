"""The lines of text in a PDF that Chromium has printed, page by page."""

import re
import unicodedata
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

OBJECT = re.compile(rb"(\d+) 0 obj\s*(.*?)endobj", re.DOTALL)
PAGE = re.compile(rb"/Type\s*/Page\b")
RESOURCE = re.compile(rb"/([FX]\d+) (\d+) 0 R")
TO_UNICODE = re.compile(rb"/ToUnicode (\d+) 0 R")
CONTENTS = re.compile(rb"/Contents (\d+) 0 R")
KIDS = re.compile(rb"/Kids \[([^\]]*)\]")
ROOT = re.compile(rb"/Type /Catalog\b.*?/Pages (\d+) 0 R", re.DOTALL)
NUMBERS = r"-?[\d.]+(?: -?[\d.]+)"
TOKEN = re.compile(
    rf"/(?P<font>F\d+) (?P<size>[\d.]+) Tf|(?P<tm>{NUMBERS}{{5}}) Tm|<(?P<tj>[0-9A-Fa-f]+)> Tj|(?P<td>{NUMBERS}) Td"
    rf"|(?P<cm>{NUMBERS}{{5}}) cm|^(?P<stack>q|Q)$|/(?P<form>X\d+) Do",
    re.MULTILINE,
)
FORM_MATRIX = re.compile(rb"/Matrix \[([^\]]*)\]")
HEIGHT = re.compile(rb"/MediaBox \[0 0 [\d.]+ ([\d.]+)\]")
RANGES = re.compile(rb"<(\w+)> <(\w+)> <(\w+)>")
SINGLE = re.compile(rb"^<(\w+)> <(\w+)>$", re.MULTILINE)


Matrix = tuple[float, float, float, float, float, float]
Piece = tuple[float, float, str]
"""Place from the left, size, text."""
UNIT: Matrix = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Line:
    """Text at one height of a page, from left to right; `top` in points from the upper end, `size` in pixels."""

    top: float
    size: float
    text: str


def pages_of(document: bytes) -> list[list[Line]]:
    """Return the lines of each page, from top to bottom."""
    objects = {int(number): body for number, body in OBJECT.findall(document)}
    return [_lines(objects, objects[number]) for number in _in_order(objects)]


def _in_order(objects: dict[int, bytes]) -> list[int]:
    (root,) = (int(found[1]) for body in objects.values() if (found := ROOT.search(body)))

    def below(number: int) -> list[int]:
        if PAGE.search(objects[number]):
            return [number]
        kids = KIDS.search(objects[number])
        assert kids is not None
        return [page for kid in re.findall(rb"(\d+) 0 R", kids[1]) for page in below(int(kid))]

    return below(root)


def _lines(objects: dict[int, bytes], page: bytes) -> list[Line]:
    contents, height = CONTENTS.search(page), HEIGHT.search(page)
    assert contents is not None
    assert height is not None
    found: dict[float, list[Piece]] = defaultdict(list)
    for y, piece in _pieces(objects, page, objects[int(contents[1])], UNIT):
        found[round(float(height[1]) - y)].append(piece)
    return [_line(top, sorted(pieces)) for top, pieces in sorted(found.items())]


def _pieces(objects: dict[int, bytes], owner: bytes, content: bytes, outer: Matrix) -> Iterator[tuple[float, Piece]]:
    """Yield the height of each piece of text, and the piece; `owner` names the fonts and forms of `content`."""
    resources = {name.decode(): int(number) for name, number in RESOURCE.findall(owner)}
    glyphs, size, text = dict[int, str](), 0.0, UNIT
    saved: list[Matrix] = []
    for token in TOKEN.finditer(_stream(content).decode("latin-1")):
        found = {name: value for name, value in token.groupdict().items() if value is not None}
        match found:
            case {"font": font, "size": points}:
                glyphs, size = _glyphs(objects, resources[font]), float(points)
            case {"tm": matrix}:
                text = _matrix(matrix)
            case {"tj": code}:
                x, y = _times(text, outer)[4:]
                codes = [int(code[k : k + 4], 16) for k in range(0, len(code), 4)]
                yield y, (x, size, "".join(glyphs.get(each, "") for each in codes))
            case {"td": move}:
                text = _times(_matrix(f"1 0 0 1 {move}"), text)
            case {"cm": matrix}:
                outer = _times(_matrix(matrix), outer)
            case {"stack": "q"}:
                saved.append(outer)
            case {"stack": "Q"}:
                outer = saved.pop()
            case {"form": form} if b"/Subtype /Form" in objects[resources[form]]:
                body = objects[resources[form]]
                own = FORM_MATRIX.search(body)
                inner = outer if own is None else _times(_matrix(own[1].decode()), outer)
                yield from _pieces(objects, body, body, inner)


def _matrix(numbers: str) -> Matrix:
    a, b, c, d, e, f = map(float, numbers.split())
    return a, b, c, d, e, f


def _times(one: Matrix, other: Matrix) -> Matrix:
    """Return the matrix of `one`, followed by `other`."""
    a, b, c, d, e, f = one
    g, h, i, j, k, m = other
    return a * g + b * i, a * h + b * j, c * g + d * i, c * h + d * j, e * g + f * i + k, e * h + f * j + m


def _line(top: float, pieces: list[Piece]) -> Line:
    apart = ["", *(" " if b[0] - a[0] > 1.2 * a[1] else "" for a, b in pairwise(pieces))]
    text = "".join(gap + text for gap, (_, _, text) in zip(apart, pieces, strict=True))
    # NFKC: a ligature is two letters.
    return Line(top, max(size for _, size, _ in pieces), unicodedata.normalize("NFKC", text).strip())


def _glyphs(objects: dict[int, bytes], font: int) -> dict[int, str]:
    """Return the characters of a font by the number of their glyph."""
    reference = TO_UNICODE.search(objects.get(font, b""))
    if reference is None:
        return {}
    table = _stream(objects[int(reference[1])])
    found = {int(glyph, 16): _characters(text) for glyph, text in SINGLE.findall(table)}
    for first, last, text in RANGES.findall(table):
        begin = int(first, 16)
        found |= {glyph: chr(int(text, 16) + glyph - begin) for glyph in range(begin, int(last, 16) + 1)}
    return found


def _characters(code: bytes) -> str:
    return bytes.fromhex(code.decode()).decode("utf-16-be", "replace")


def _stream(body: bytes) -> bytes:
    raw = body[body.index(b"stream") + len(b"stream") :].lstrip(b"\r\n")
    return zlib.decompressobj().decompress(raw) if b"FlateDecode" in body else raw
