"""The paper's Table I and its claims beside those of the study, read from the certificates of its campaigns."""

import statistics
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from ....schemas.result.certificate import Predicate
from ...certificate.words.bound_text import outward
from .study import DIRECT, FUNCTION, PAPER, RIGOROUS, SCENARIO
from .table_text import csv_text, markdown

# The printed results: Table I, the claims below it, and the numbers of tests in its text


@dataclass(frozen=True, slots=True)
class Printed:
    """One result of the paper, as text, because it rounds."""

    symbol: str
    bound: str
    probability: str = ""
    tests: str = ""


THEOREM_2 = "theorem 2"
"""Row of the composed claim; the other rows are named after their problem."""

TABLE = {
    "true_risk": Printed("rho* >=", "0.31", "0.92", "385"),
    "nominal_robustness": Printed("rho~ =", "0.46"),
    "sim_gap": Printed("e~ =", "0.38"),
    THEOREM_2: Printed("rho* >=", "0", "0.84", "128"),
    "maximum": Printed("eps =", "(0.5, 0.53]"),
}
"""The rows of Table I, then those of the text: both problems together, and the test function."""


PARAMETERS = {"B": "rkhs_norm", "R": "noise_scale", "delta": "delta", "alpha": "alpha", "c": "c"}
"""Columns of Table I, and their keys in a campaign file."""
COLUMNS = (
    *("row", "symbol", *PARAMETERS, "printed_bound", "printed_probability", "printed_tests", "seeds"),
    *("bound_median", "bound_least", "bound_greatest", "probability"),
    *("tests_median", "tests_least", "tests_greatest", "true_rollouts_median"),
)
CLAIM_COLUMNS = (
    *("source", "seed", "quantity", "sense", "bound", "probability", "method", "rule"),
    *("tests", "nominal_rollouts", "true_rollouts", "refuted"),
)
MARKDOWN_COLUMNS = ("source", "seed", "bound", "probability", "tests", "true_rollouts", "refuted")


@dataclass(frozen=True, slots=True)
class Finished:
    """A campaign of the study with the predicate of its certificate."""

    preset: str
    predicate: Predicate

    @property
    def counts(self) -> dict[str, int]:
        """Tests and rollouts of all its problems."""
        problems = self.predicate.problems
        return {
            "tests": sum(each.tests for each in problems),
            "nominal_rollouts": sum(each.rollouts.nominal for each in problems),
            "true_rollouts": sum(each.rollouts.true for each in problems),
        }


@dataclass(frozen=True, slots=True)
class Outcome:
    """One seed's part of a row; `bound` in the unit of the problem."""

    bound: float
    probability: float
    tests: int
    true_rollouts: int
    parameters: dict[str, object]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of Table I: the printed numbers, and the outcome of every seed."""

    name: str
    printed: Printed
    outcomes: tuple[Outcome, ...]

    @property
    def parameters(self) -> list[object]:
        """The columns of `PARAMETERS`, equal for all seeds; empty where there are none."""
        found = self.outcomes[0].parameters if self.outcomes else {}
        return [found.get(name, "") for name in PARAMETERS]

    @property
    def published(self) -> list[object]:
        """The printed numbers, and the number of seeds beside them."""
        return [self.printed.bound, self.printed.probability, self.printed.tests, len(self.outcomes)]

    @property
    def bounds(self) -> list[float]:
        """The bound of every seed."""
        return [each.bound for each in self.outcomes]

    @property
    def tests(self) -> list[int]:
        """The number of tests of every seed."""
        return [each.tests for each in self.outcomes]


def rows(finished: Sequence[Finished]) -> tuple[Row, ...]:
    """Return Table I, with a row also for problems that were not run."""
    found: dict[str, list[Outcome]] = {name: [] for name in TABLE}
    for each in finished:
        # The scenario method bounds the linearised risk, another quantity than that of Table I.
        if each.preset in (FUNCTION.name, PAPER.name, DIRECT.name):
            for name, outcome in _outcomes(each):
                found[name].append(outcome)
    return tuple(Row(name, printed, tuple(found[name])) for name, printed in TABLE.items())


def _outcomes(campaign: Finished) -> Iterator[tuple[str, Outcome]]:
    for each in campaign.predicate.problems:
        parameters = {column: each.parameters[key] for column, key in PARAMETERS.items()}
        yield each.name, Outcome(each.bound, each.probability, each.tests, each.rollouts.true, parameters)
    if campaign.predicate.composition is not None:
        claim, counts = campaign.predicate.claims[0], campaign.counts
        yield THEOREM_2, Outcome(claim.bound, claim.probability, counts["tests"], counts["true_rollouts"], {})


def table_csv(table: Iterable[Row]) -> str:
    """Return Table I as CSV, one row for each problem; numbers of problems that were not run are empty."""
    return csv_text(COLUMNS, map(_cells, table))


def _cells(row: Row) -> list[object]:
    head = [row.name, row.printed.symbol, *row.parameters, *row.published]
    if not row.outcomes:
        return [*head, *[""] * 8]
    return [
        *head,
        *(statistics.median(row.bounds), min(row.bounds), max(row.bounds), min(o.probability for o in row.outcomes)),
        *(statistics.median(row.tests), min(row.tests), max(row.tests)),
        statistics.median(each.true_rollouts for each in row.outcomes),
    ]


def table_markdown(table: Iterable[Row]) -> str:
    """Return Table I as Markdown: numbers as median, and least to greatest over the seeds."""
    head = ["", *PARAMETERS, "paper", "prob.", "tests", "seeds", "ours", "prob.", "tests", "true rollouts"]
    return markdown(head, map(_texts, table))


def _texts(row: Row) -> list[str]:
    head = [f"{row.name}: {row.printed.symbol}", *map(str, row.parameters), *map(str, row.published)]
    if not row.outcomes:
        return [*head, *["-"] * 4]
    return [
        *head,
        _spread(row.bounds, ".3f"),
        outward(min(each.probability for each in row.outcomes), ">="),
        _spread(row.tests, ".0f"),
        f"{statistics.median(each.true_rollouts for each in row.outcomes):.0f}",
    ]


def _spread(values: Sequence[float], form: str) -> str:
    """Return median and range of `values`.

    >>> _spread([0.25, 0.5, 0.125], ".3f"), _spread([4], ".0f")
    ('0.250 (0.125 to 0.500)', '4')
    """
    middle, least, greatest = (format(value, form) for value in (statistics.median(values), min(values), max(values)))
    return middle if least == greatest else f"{middle} ({least} to {greatest})"


def claim_rows(finished: Iterable[Finished]) -> list[dict[str, object]]:
    """Return every claim about the true Segway with the columns of claims.csv, the printed ones first.

    The claim of a campaign is its first one, which is fixed before the campaign.
    """
    by_preset: dict[str, list[dict[str, object]]] = {
        PAPER.name: [_printed_claim(TABLE[THEOREM_2], "product")],
        DIRECT.name: [_printed_claim(TABLE["true_risk"], "single")],
        RIGOROUS.name: [],
        SCENARIO.name: [],
    }
    for each in finished:
        if each.preset in by_preset:
            by_preset[each.preset].append(_first_claim(each))
    return [claim for found in by_preset.values() for claim in found]


def _printed_claim(printed: Printed, rule: str) -> dict[str, object]:
    known = {"source": "printed in the paper", "quantity": "rho_star", "sense": ">=", "method": "paper", "rule": rule}
    known |= {"bound": printed.bound, "probability": printed.probability, "tests": printed.tests}
    return {column: known.get(column, "") for column in CLAIM_COLUMNS}


def _first_claim(campaign: Finished) -> dict[str, object]:
    claim = campaign.predicate.claims[0]
    return {
        "source": campaign.preset,
        "seed": campaign.predicate.campaign.seed,
        **claim.model_dump(exclude={"assumptions", "refuted"}),
        **campaign.counts,
        "refuted": " ".join(claim.refuted),
    }


def claims_csv(found: Iterable[dict[str, object]]) -> str:
    """Return the claims as CSV; refuted assumptions by their ids, separated by spaces."""
    return csv_text(CLAIM_COLUMNS, ([claim[column] for column in CLAIM_COLUMNS] for claim in found))


def claims_markdown(found: Iterable[dict[str, object]]) -> str:
    """Return the claims as Markdown, rounded to the safe side."""
    head = ["campaign", "seed", "rho* >=", "probability", "tests", "true rollouts", "refuted assumptions"]
    return markdown(head, ([_claim_text(claim, column) for column in MARKDOWN_COLUMNS] for claim in found))


def _claim_text(claim: dict[str, object], column: str) -> str:
    value = claim[column]
    if column == "refuted":
        # The assumptions of a printed claim, which has no seed, are unknown.
        return ", ".join(str(value).split()) or ("" if claim["seed"] == "" else "none")
    return outward(value, ">=") if isinstance(value, float) else str(value)
