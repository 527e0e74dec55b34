"""The table about silent claims: run the functions that are missing, print, write the page and the record.

python -m tests.studies.coverage.spot_page --write docs/coverage.md
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from perfbound.schemas.platforms import one_blas_thread

one_blas_thread()

import numpy as np  # noqa: E402  (numpy reads the setting once)

from tests.studies.coverage.records import DIRECTORY, code  # noqa: E402
from tests.studies.coverage.spot_checks import FACTORS, FAMILIES, FUNCTIONS, OBSERVED, Found, campaigns  # noqa: E402
from tests.studies.coverage.summary import RESULTS, table  # noqa: E402

BINS = ((0.02, 1.0), (0.01, 0.02), (0.0, 0.01))
"""Of h, each from its lower end on, without a share of 0."""
RECORD = RESULTS / "spot-checks.json"
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


def numbers(found: list[Found]) -> dict[str, Any]:
    """Return the record of the study: its counts, and the sizes of what stays silent."""
    return {
        "functions": len(found) // (len(FACTORS) * len(OBSERVED)),
        "code": code("spot_checks"),
        "claims": [_counts(found, kind.name, factor) for kind in OBSERVED for factor in FACTORS],
        "families": {
            family: {kind.name: _of_family(found, family, kind.name) for kind in OBSERVED} for family in FAMILIES
        },
        **_deficits(found),
    }


def record_text(record: Mapping[str, Any]) -> str:
    """Return a record as text, one line for each row of claims and each family."""
    lists = {
        "claims": ",\n".join(f"  {json.dumps(each)}" for each in record["claims"]),
        "families": ",\n".join(
            f"  {json.dumps(name)}: {json.dumps(each)}" for name, each in record["families"].items()
        ),
    }
    first = ", ".join(f"{json.dumps(name)}: {json.dumps(each)}" for name, each in record.items() if name not in lists)
    return f'{{{first},\n"claims": [\n{lists["claims"]}\n],\n"families": {{\n{lists["families"]}\n}}}}\n'


def tables(record: Mapping[str, Any]) -> str:
    """Return the part of the page that a record is written as."""
    head = ["bounded", "B too small by", "false", "refuted by the method", "h >= 1 %", "h < 1 %"]
    rows = [_row(each) for each in record["claims"]]
    campaigns = sum(each["campaigns"] for each in record["claims"])
    words = f"{record['functions']} functions, {campaigns:,} campaigns, {record['claims'][0]['campaigns']} in each row."
    words += " The last columns have: false / silent without / silent with the spot check."
    return f"{words}\n\n{table(head, rows)}\n\n{chr(10).join(_sizes(record))}\n"


def section(record: Mapping[str, Any]) -> str:
    """Return the generated part of the page with its marks."""
    return f"{BEGIN}\n\n{tables(record)}\n{END}"


WORDS = {"exact": "no noise", "mean": "mean", "risk": "linearised risk"}


def _row(claims: Mapping[str, Any]) -> list[str]:
    """Return one row of the page: the two larger kinds of violated shares are one."""
    large, middle, small = claims["shares"]
    merged = [a + b for a, b in zip(large, middle, strict=True)]
    counts = [f"{claims['factor']:g}", f"{claims['false']}", f"{claims['refuted']}"]
    return [WORDS[claims["observed"]], *counts, *("/".join(map(str, each)) for each in (merged, small))]


def _within(each: Found, low: float, high: float) -> bool:
    return each.judged and low <= each.share and (each.share < high or high == 1.0)


def _counts(found: list[Found], kind: str, factor: float) -> dict[str, Any]:
    rows = [each for each in found if (each.observed, each.factor) == (kind, factor)]
    shares = []
    for low, high in BINS:
        inside = [each for each in rows if _within(each, low, high)]
        without = sum(not each.refuted for each in inside)
        shares.append([len(inside), without, sum(map(is_silent, inside))])
    return {
        "observed": kind,
        "factor": factor,
        "campaigns": len(rows),
        "false": sum(each.any_share > 0 for each in rows),
        "refuted": sum(each.refuted for each in rows),
        "shares": shares,
    }


def is_silent(each: Found) -> bool:
    return not (each.refuted or each.contradicted)


def _of_family(found: list[Found], family: str, kind: str) -> list[int]:
    """Return the silent claims of a family: those of each share, and those with smaller deficits."""
    rows = [each for each in found if (each.family, each.observed) == (family, kind) and is_silent(each)]
    counts = [sum(_within(each, low, high) for each in rows) for low, high in BINS]
    return [*counts, sum(each.any_share > 0 and not each.judged for each in rows)]


def _deficits(found: list[Found]) -> dict[str, Any]:
    """Return what stays silent: number, median and most; below one sd number, of how many, median and 90 %; alarms."""
    less = [each for each in found if each.any_share > 0 and not each.judged and is_silent(each)]
    false = [each for each in found if each.any_share > 0 and not each.judged and not each.refuted]
    small = {}
    for kind, noisy in (("without noise", False), ("with noise", True)):
        rows = [each for each in found if (each.observed != "exact") == noisy and is_silent(each)]
        sizes = [each.deficit for each in rows if each.judged and each.share < BINS[-1][1]]
        if sizes:
            small[kind] = [len(sizes), round(float(np.median(sizes)), 3), round(max(sizes), 3)]
    shallow: list[float] = []
    if less:
        spread = np.quantile([each.deficit / each.sd for each in less], (0.5, 0.9))
        shallow = [len(less), len(false), *(round(float(each), 2) for each in spread)]
    honest = [each for each in found if each.any_share == 0 and each.contradicted is not None]
    return {
        "small": small,
        "shallow": shallow,
        "alarms": [sum(bool(each.contradicted) for each in honest), len(honest)],
    }


def _sizes(record: Mapping[str, Any]) -> Iterator[str]:
    for kind, (number, median, most) in record["small"].items():
        yield (
            f"- Silent with h < 1 %, {kind}: {number} claims, with a deficit of {median:.3f} in the median and at most "
            f"{most:.3f}."
        )
    if record["shallow"]:
        silent, of, median, most = record["shallow"]
        yield (
            f"- Deficits below one sd of a rollout: {silent} of {of} claims stay silent, with {median:.2f} sd in the "
            f"median and {most:.2f} at 90 %."
        )
    alarms, honest = record["alarms"]
    yield f"- False alarms of the spot check: {alarms} in {honest:,} campaigns whose claim is true (level 5 %)."


def main() -> int:
    """Run, print, write; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.coverage.spot_page", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--functions", type=int, default=FUNCTIONS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--write", type=Path, help="page whose part about spot checks is written anew")
    options = parser.parse_args()
    record = numbers(run(options.functions, options.workers))
    sys.stdout.write(tables(record))
    if options.write is not None:
        RECORD.write_text(record_text(record))
        page = options.write.read_text()
        options.write.write_text(page.split(BEGIN)[0] + section(record) + page.split(END)[1])
    return 0


if __name__ == "__main__":
    sys.exit(main())
