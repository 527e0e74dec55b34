"""The table of scenarios: a failing rollout a row, for any tool that reads CSV.

| column         | meaning                                                                                   |
|----------------|-------------------------------------------------------------------------------------------|
| `scenario`     | its name: number of the group, and `worst` or `nearest`                                     |
| `variant`      | of the system: `nominal` or `true`                                                        |
| `seed`         | of what the system draws by itself                                                        |
| a parameter    | of the start, with its unit in parentheses                                                |
| a disturbance  | its value, with its unit; none of a variant without                                       |
| `robustness`   | of the specification, not clipped                                                         |
| `violated`     | requirements, or parts of the formula, with "; " between two                              |
| `moment`       | when it is first violated; empty where that is not derived                                 |
| `rollout`      | of the campaign; of `nearest` that from which it comes                                    |
"""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ....schemas.errors import PerfboundError
from ....schemas.number_text import number_in
from ....schemas.outside import read_outside
from ....schemas.result.facts import Header
from ....schemas.system import SystemSpec, Variant
from ...store.export import csv_rows, text_of_cell
from ...store.export_tables import ExportColumn, declared_columns, robustness_unit
from .failures import Failure
from .outcome import Outcome

MOST_BYTES = 16_000_000
"""Of a table that is read."""
BETWEEN = "; "
FIRST = ("scenario", "variant", "seed")
LAST = ("robustness", "violated", "moment", "rollout")


@dataclass(frozen=True, slots=True)
class Scenario:
    """One row: a rollout, and what it showed."""

    name: str
    variant: Variant
    seed: int
    numbers: Mapping[str, float]
    """Parameters of the start and disturbances, by the names of their columns."""
    units: Mapping[str, str]
    """Of these columns."""
    outcome: Outcome
    """In the campaign."""
    rollout: str


def scenario_table(header: Header, named: Sequence[tuple[str, Failure]]) -> bytes:
    """Return the table of failures with their names, as CSV."""
    spec = header.spec
    starts, drawn = scenario_columns(spec)
    head = [ExportColumn(each, "text") for each in FIRST]
    unit = robustness_unit(header.config, spec)
    tail = [ExportColumn("robustness", unit=unit), ExportColumn("violated", "text"), ExportColumn("moment", unit="s")]
    columns = [*head, *starts, *drawn, *tail, ExportColumn("rollout", "text")]
    out = io.BytesIO()
    csv_rows(out, columns, (_row(spec, *each) for each in named))
    return out.getvalue()


def scenario_columns(spec: SystemSpec) -> tuple[tuple[ExportColumn, ...], tuple[ExportColumn, ...]]:
    """Return the columns of the parameters of a start, and of the disturbances, with the names that are free."""
    return (
        declared_columns("start", spec.own_parameters, (*FIRST, *LAST)),
        declared_columns("disturbance", spec.disturbances, (*FIRST, *LAST)),
    )


def _row(spec: SystemSpec, name: str, failure: Failure) -> tuple[str | int | float | None, ...]:
    rollout, outcome = failure.rollout, failure.outcome
    drawn = failure.disturbances or (None,) * len(spec.disturbances)
    numbers = (*failure.x[: len(spec.own_parameters)], *drawn)
    shown = outcome.robustness, BETWEEN.join(outcome.violated), outcome.moment
    return (name, rollout.variant, failure.seed, *numbers, *shown, str(rollout))


def read_scenarios(path: Path) -> dict[str, Scenario]:
    """Return the scenarios of a table, by their names.

    Raises:
        PerfboundError: it cannot be read, or is no such table; the text names the line.

    """
    try:
        text = read_outside(path, MOST_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise PerfboundError(f"{path}: cannot be read ({error}); export it again") from None
    found = dict[str, Scenario]()
    for each in _scenarios(path, csv.DictReader(io.StringIO(text, newline=""))):
        if each.name in found:
            raise PerfboundError(f"{path}: the scenario {each.name!r} is there twice; give each a name of its own")
        found[each.name] = each
    if not found:
        raise PerfboundError(f"{path}: it has no scenario; export it again")
    return found


def _scenarios(path: Path, rows: "csv.DictReader[str]") -> Iterator[Scenario]:
    titles = {title.partition(" (")[0]: title for title in rows.fieldnames or ()}
    if missing := [name for name in (*FIRST, *LAST) if name not in titles]:
        raise PerfboundError(f"{path}: it has no column {missing[0]!r}; export it again")
    numbers = [name for name in titles if name not in (*FIRST, *LAST)]
    for row in rows:
        cells = {name: row[title] or "" for name, title in titles.items()}
        try:
            yield _scenario(cells, {name: _unit(titles[name]) for name in numbers})
        except ValueError as error:
            raise PerfboundError(f"{path}, line {rows.line_num}: {error}; export it again") from None


def _unit(title: str) -> str:
    return title.partition(" (")[2].removesuffix(")")


def _scenario(cells: Mapping[str, str], numbers: Mapping[str, str]) -> Scenario:
    if cells["variant"] not in ("nominal", "true"):
        raise ValueError(f"there is no variant {cells['variant']!r}")
    return Scenario(
        name=cells["scenario"],
        variant="true" if cells["variant"] == "true" else "nominal",
        seed=int(cells["seed"]),
        numbers={name: number_in(cells[name]) for name in numbers if cells[name]},
        units=dict(numbers),
        outcome=Outcome(
            number_in(cells["robustness"]),
            tuple(filter(None, text_of_cell(cells["violated"]).split(BETWEEN))),
            number_in(cells["moment"]) if cells["moment"] else None,
        ),
        rollout=cells["rollout"],
    )
