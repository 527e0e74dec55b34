"""The tables about silent claims: run the functions that are missing, print, write the page.

python -m tests.coverage.spot_page --write docs/coverage.md
"""

import argparse
import json
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from perfbound.schemas.blas import one_blas_thread

one_blas_thread()

import numpy as np  # noqa: E402  (numpy reads the setting once)

from tests.coverage.records import DIRECTORY, code  # noqa: E402
from tests.coverage.spot_checks import FACTORS, FAMILIES, FUNCTIONS, OBSERVED, Found, campaigns  # noqa: E402

BINS = ((0.02, 1.0), (0.01, 0.02), (0.0, 0.01))
"""Of h, each from its lower end on, without a share of 0."""
BEGIN, END = "<!-- spot checks: begin -->", "<!-- spot checks: end -->"


def run(functions: int, workers: int) -> list[Found]:
    """Run the functions without a stored result; return the campaigns of all of them, in order."""
    # Other code, other file: no result outlives the code that it came from.
    path = DIRECTORY / f"spot-checks-{code('spot_checks')}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_text().splitlines() if path.exists() else []
    done: dict[int, Any] = dict(map(json.loads, lines))
    missing = [number for number in range(functions) if number not in done]
    with path.open("a") as file, ProcessPoolExecutor(workers) as pool:
        for number, found in zip(missing, pool.map(campaigns, missing), strict=True):
            done[number] = [asdict(each) for each in found]
            file.write(json.dumps([number, done[number]]) + "\n")
            file.flush()
    return [Found(**row) for number in range(functions) for row in done[number]]


def tables(found: list[Found]) -> str:
    """Return the tables of the page."""
    functions = len(found) // (len(FACTORS) * len(OBSERVED))
    digest = code("spot_checks")
    lines = [f"{functions} functions, {len(found)} campaigns; the code under study had the digest `{digest}`.", ""]
    head = ["B too small by", "campaigns", "claim false", "refuted by the method"]
    for low, high in BINS:
        least, most = round(100 * low), round(100 * high)
        name = f"h >= {least} %" if high == 1.0 else f"{least} to {most} %" if low else f"h < {most} %"
        head += [f"{name}: false", "silent without", "silent with"]
    for kind in OBSERVED:
        lines += [f"**{WORDS[kind.name]}**", "", _row(head), _row(["---"] * len(head))]
        lines += [_row(_counts(found, kind.name, factor)) for factor in FACTORS]
        lines.append("")
    lines += ["Silent claims with the spot check, by family (h >= 2 % / 1 to 2 % / below / smaller deficits):", ""]
    lines += [_row(["family", *(kind.name for kind in OBSERVED)]), _row(["---"] * (1 + len(OBSERVED)))]
    lines += [_row([family, *(_of_family(found, family, kind.name) for kind in OBSERVED)]) for family in FAMILIES]
    lines += ["", *_deficits(found)]
    return "\n".join(lines) + "\n"


WORDS = {
    "exact": "Deterministic",
    "mean": "Noisy: the mean of the clipped robustness",
    "risk": "Noisy: the linearised risk",
}


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _within(each: Found, low: float, high: float) -> bool:
    return each.judged and low <= each.share and (each.share < high or high == 1.0)


def _counts(found: list[Found], kind: str, factor: float) -> list[str]:
    rows = [each for each in found if (each.observed, each.factor) == (kind, factor)]
    cells = [f"{factor:g}", str(len(rows)), str(sum(each.any_share > 0 for each in rows))]
    cells.append(str(sum(each.refuted for each in rows)))
    for low, high in BINS:
        inside = [each for each in rows if _within(each, low, high)]
        without = sum(not each.refuted for each in inside)
        cells += [str(len(inside)), str(without), str(sum(map(is_silent, inside)))]
    return cells


def is_silent(each: Found) -> bool:
    return not (each.refuted or each.contradicted)


def _of_family(found: list[Found], family: str, kind: str) -> str:
    rows = [each for each in found if (each.family, each.observed) == (family, kind) and is_silent(each)]
    counts = [sum(_within(each, low, high) for each in rows) for low, high in BINS]
    counts.append(sum(each.any_share > 0 and not each.judged for each in rows))
    return " / ".join(map(str, counts))


def _deficits(found: list[Found]) -> Iterator[str]:
    less = [each for each in found if each.any_share > 0 and not each.judged and is_silent(each)]
    false = [each for each in found if each.any_share > 0 and not each.judged and not each.refuted]
    for kind, noisy in (("without noise", False), ("with noise", True)):
        rows = [each for each in found if (each.observed != "exact") == noisy and is_silent(each)]
        sizes = [each.deficit for each in rows if each.judged and each.share < BINS[-1][1]]
        if sizes:
            yield (
                f"- Silent with h < 1 %, {kind}: {len(sizes)} claims; deficit {np.median(sizes):.3f} in the median, at "
                f"most {max(sizes):.3f}."
            )
    if less:
        median, most = np.quantile([each.deficit / each.sd for each in less], (0.5, 0.9))
        yield (
            f"- Deficits below one sd of a rollout: {len(less)} of {len(false)} claims stay silent; their deficit is "
            f"{median:.2f} sd in the median, {most:.2f} at 90 %."
        )
    honest = [each for each in found if each.any_share == 0 and each.contradicted is not None]
    alarms = sum(bool(each.contradicted) for each in honest)
    yield f"- False alarms of the spot check: {alarms} in {len(honest)} campaigns whose claim is true (level 5 %)."


def main() -> int:
    """Run, print, write; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.coverage.spot_page", description=__doc__.split("\n")[0])
    parser.add_argument("--functions", type=int, default=FUNCTIONS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--write", type=Path, help="page whose part about spot checks is written anew")
    options = parser.parse_args()
    text = tables(run(options.functions, options.workers))
    sys.stdout.write(text)
    if options.write is not None:
        page = options.write.read_text()
        before, after = page.split(BEGIN)[0], page.split(END)[1]
        options.write.write_text(f"{before}{BEGIN}\n\n{text}\n{END}{after}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
