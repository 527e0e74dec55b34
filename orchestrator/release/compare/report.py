"""The report of a comparison: one page without scripts."""

import html
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ....schemas.atomic import write_whole
from ....schemas.errors import PerfboundError, one_line
from ....schemas.ids import RolloutId
from ....schemas.result.comparison import Comparison, ComparisonVerdict
from ...certificate.words.format import replay_command
from ...mathematics.gp.kernels import Floats
from ...mathematics.stl.parser import parse_formula
from ...mathematics.stl.tree import columns
from ...report.rollout.load import load_recorded
from ...run.known import system_file
from .differences import Pairs, differences
from .figures import intervals_figure, numbers_of, pairs_figure, trajectories_figure
from .outputs import HEAD, STYLES, conclusion, row, sentences, system_lines
from .systems import Compared

MOST_DIFFERENT = 5
"""Pairs that are listed, of those in which B loses most, and of those in which it gains most."""
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 900px; margin: 2em auto; padding: 0 1em; }}
h1 {{ font-size: 1.5em; }} h2 {{ font-size: 1.15em; margin-top: 2em; }}
table {{ border-collapse: collapse; }} td, th {{ padding: .25em .9em .25em 0; text-align: right; }}
td:first-child, th:first-child {{ text-align: left; }} th {{ border-bottom: 1px solid #999; }}
svg {{ width: 100%; height: auto; }} .half svg {{ width: 60%; }}
pre {{ overflow-x: auto; background: #f4f4f4; padding: .6em; }}
.red {{ color: #b02a00; font-weight: bold; }} .green {{ color: #00694a; font-weight: bold; }}
.yellow {{ color: #8a5a00; font-weight: bold; }}
</style></head><body>
{body}
</body></html>
"""


def write_report(path: Path, both: Mapping[Path, Compared], pairs: Pairs, starts: Floats, found: Comparison) -> None:
    """Write the page of a comparison.

    Raises:
        PerfboundError: a database cannot be read.
        OSError: the disk is full or fails.

    """
    body = "\n".join(_sections(both, pairs, starts, found))
    title = html.escape(f"Comparison: {conclusion(found)}")
    write_whole(path, PAGE.format(title=title, body=body).encode())


def _sections(both: Mapping[Path, Compared], pairs: Pairs, starts: Floats, found: Comparison) -> Iterator[str]:
    yield f"<h1 class={_colour(found.verdict)!r}>{html.escape(conclusion(found))}</h1>"
    yield f"<pre>{html.escape(chr(10).join(system_lines(found)))}</pre>"
    yield f"<p>Specification: <code>{html.escape(one_line(found.specification))}</code></p>"
    colours = [_colour(each.verdict) for each in found.differences]
    yield _table(HEAD, [row(each) for each in found.differences], colours)
    yield f"<p>{html.escape(' '.join(sentences(found)))}</p>"
    delta, equal = 1.0 - found.probability, {each.quantity: each.equal_within for each in found.differences}
    known = {quantity: number for quantity, number in equal.items() if number is not None}
    # The worst listed start takes two intervals for each of them.
    numbers = numbers_of(len(pairs.a), 5 if pairs.listed else 16)
    course = [(n, differences(_first(pairs, n), delta, known)) for n in numbers]
    yield "<h2>The intervals, pair by pair</h2>"
    yield _svg(intervals_figure(course))
    yield "<h2>The margins of each pair</h2>"
    yield f"<div class=half>{_svg(pairs_figure(pairs.a, pairs.b, pairs.unit))}</div>"
    yield from _most_different(both, pairs, starts)


def _first(pairs: Pairs, number: int) -> Pairs:
    start = None if pairs.start is None else pairs.start[:number]
    return replace(pairs, a=pairs.a[:number], b=pairs.b[:number], start=start)


def _most_different(both: Mapping[Path, Compared], pairs: Pairs, starts: Floats) -> Iterator[str]:
    one = next(iter(both.values()))
    header, difference = one.header, pairs.b - pairs.a
    order = np.argsort(difference, kind="stable")
    if not difference.any():
        yield "<p>In every pair both have the same robustness.</p>"
        return
    parameters = [
        each.name if each.unit in ("", "1") else f"{each.name} / {each.unit}" for each in header.spec.parameters
    ]
    for title, chosen in (
        ("Where B loses most", [int(test) for test in order if difference[test] < 0][:MOST_DIFFERENT]),
        ("Where B gains most", [int(test) for test in order[::-1] if difference[test] > 0][:MOST_DIFFERENT]),
    ):
        yield f"<h2>{title}</h2>"
        if not chosen:
            yield "<p>Nowhere.</p>"
            continue
        rows = [
            (str(test), *(f"{value:.6g}" for value in starts[test].tolist()), *(f"{value:.4f}" for value in three))
            for test in chosen
            for three in [(pairs.a[test], pairs.b[test], difference[test])]
        ]
        yield _table(("pair", *parameters, "A", "B", "B - A"), rows)
        yield from _trajectories(both, chosen[0])


def _trajectories(both: Mapping[Path, Compared], test: int) -> Iterator[str]:
    """Yield both trajectories of a pair, where they are kept and whole."""
    recorded = []
    for directory, system in both.items():
        header = system.header
        rollout = RolloutId(header.config.problems[0].name, test, header.claimed_variant, 0)
        try:
            recorded.append((directory, rollout, load_recorded(directory, str(rollout)).trajectory))
        except PerfboundError as error:
            yield f"<p>{html.escape(one_line(str(error)))}</p>"
            return
    (_, _, a), (_, _, b) = recorded
    if a is None or b is None:
        yield "<p>A trajectory of this pair is missing or damaged.</p>"
        return
    header = next(iter(both.values())).header
    yield f"<p>Both trajectories of pair {test}, A in blue and B in orange:</p>"
    yield _svg(trajectories_figure(header.spec, a, b, columns(parse_formula(header.config.formula or ""))))
    commands = [
        replay_command(directory, system.header, str(rollout), system_file(directory))
        for (directory, rollout, _), system in zip(recorded, both.values(), strict=True)
    ]
    yield f"<pre>{html.escape(chr(10).join(commands))}</pre>"


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]], colours: Sequence[str] = ()) -> str:
    cells = "".join(f"<th>{html.escape(each)}</th>" for each in head)
    lines = [f"<tr>{cells}</tr>"]
    for number, cells_of_row in enumerate(rows):
        *others, last = map(html.escape, cells_of_row)
        kind = f" class={colours[number]!r}" if colours else ""
        lines.append(f"<tr>{''.join(f'<td>{each}</td>' for each in others)}<td{kind}>{last}</td></tr>")
    return f"<table>{''.join(lines)}</table>"


def _svg(picture: bytes) -> str:
    text = picture.decode()
    return text[text.index("<svg") :]


def _colour(verdict: ComparisonVerdict) -> str:
    return STYLES[verdict].rpartition(" ")[2]
