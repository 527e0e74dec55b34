"""The paper's Table I and its claims beside those of our campaigns, read from their certificates."""

import statistics
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from ....schemas.certificate import Predicate
from ...certificate.text import outward
from .published import TABLE, THEOREM_2, Printed
from .study import DIRECT, FUNCTION, PAPER, RIGOROUS, SCENARIO
from .text import csv_text, markdown

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


@dataclass(frozen=True, slots=True)
class Finished:
    """A campaign of the study and what its certificate says."""

    preset: str
    predicate: Predicate

    @property
    def seed(self) -> int:
        """The seed of the campaign."""
        return self.predicate.campaign.seed

    @property
    def tests(self) -> int:
        """Tests of all its problems."""
        return sum(problem.tests for problem in self.predicate.problems)

    @property
    def nominal_rollouts(self) -> int:
        """Nominal rollouts of all its problems."""
        return sum(problem.rollouts.nominal for problem in self.predicate.problems)

    @property
    def true_rollouts(self) -> int:
        """True rollouts of all its problems."""
        return sum(problem.rollouts.true for problem in self.predicate.problems)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one seed contributes to a row; `bound` in the unit of the problem."""

    bound: float
    probability: float
    tests: int
    true_rollouts: int
    parameters: dict[str, object]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of Table I: what was printed, and what our seeds gave."""

    name: str
    printed: Printed
    outcomes: tuple[Outcome, ...]

    @property
    def bounds(self) -> list[float]:
        """The bound of every seed."""
        return [each.bound for each in self.outcomes]

    @property
    def tests(self) -> list[int]:
        """The number of tests of every seed."""
        return [each.tests for each in self.outcomes]


def rows(finished: Sequence[Finished]) -> tuple[Row, ...]:
    """Return Table I, with a row also where nothing was run."""
    found: dict[str, list[Outcome]] = {name: [] for name in TABLE}
    for each in finished:
        if each.preset in (FUNCTION.name, PAPER.name, DIRECT.name):
            for name, outcome in _outcomes(each):
                found[name].append(outcome)
    return tuple(Row(name, printed, tuple(found[name])) for name, printed in TABLE.items())


def _outcomes(campaign: Finished) -> Iterator[tuple[str, Outcome]]:
    for each in campaign.predicate.problems:
        parameters = {column: each.parameters[key] for column, key in PARAMETERS.items()}
        yield each.name, Outcome(each.bound, each.probability, each.tests, each.rollouts.true, parameters)
    if campaign.predicate.composition is not None:
        claim = campaign.predicate.claims[0]
        yield THEOREM_2, Outcome(claim.bound, claim.probability, campaign.tests, campaign.true_rollouts, {})


def table_csv(table: Iterable[Row]) -> str:
    """Return Table I as CSV, one row a problem, empty where there is nothing."""
    return csv_text(COLUMNS, map(_cells, table))


def _cells(row: Row) -> list[object]:
    printed = row.printed
    head = [row.name, printed.symbol]
    published = [printed.bound, printed.probability, printed.tests, len(row.outcomes)]
    if not row.outcomes:
        return [*head, *[""] * len(PARAMETERS), *published, *[""] * 8]
    first = row.outcomes[0]
    return [
        *head,
        *(first.parameters.get(name, "") for name in PARAMETERS),
        *published,
        *(statistics.median(row.bounds), min(row.bounds), max(row.bounds), min(o.probability for o in row.outcomes)),
        *(statistics.median(row.tests), min(row.tests), max(row.tests)),
        statistics.median(each.true_rollouts for each in row.outcomes),
    ]


def table_markdown(table: Iterable[Row]) -> str:
    """Return Table I for people: numbers as median, and least to greatest over the seeds."""
    head = ["", *PARAMETERS, "paper", "prob.", "tests", "seeds", "ours", "prob.", "tests", "true rollouts"]
    return markdown(head, map(_texts, table))


def _texts(row: Row) -> list[str]:
    printed = row.printed
    left = [f"{row.name}: {printed.symbol}"]
    published = [printed.bound, printed.probability, printed.tests, str(len(row.outcomes))]
    if not row.outcomes:
        return [*left, *[""] * len(PARAMETERS), *published, *["-"] * 4]
    first = row.outcomes[0]
    return [
        *left,
        *(str(first.parameters.get(name, "")) for name in PARAMETERS),
        *published,
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
    middle = format(statistics.median(values), form)
    least, greatest = format(min(values), form), format(max(values), form)
    return middle if least == greatest else f"{middle} ({least} to {greatest})"


def claims(finished: Iterable[Finished]) -> list[dict[str, object]]:
    """Return every claim about the true Segway with the columns of claims.csv, the printed ones before ours.

    The claim of a campaign is the one that was chosen beforehand.
    """
    by_preset: dict[str, list[dict[str, object]]] = {
        PAPER.name: [_printed(TABLE[THEOREM_2], "product")],
        DIRECT.name: [_printed(TABLE["true_risk"], "single")],
        RIGOROUS.name: [],
        SCENARIO.name: [],
    }
    for each in finished:
        if each.preset in by_preset:
            by_preset[each.preset].append(_claim(each))
    return [claim for found in by_preset.values() for claim in found]


def _printed(printed: Printed, rule: str) -> dict[str, object]:
    known = {"source": "printed in the paper", "quantity": "rho_star", "sense": ">=", "method": "paper", "rule": rule}
    known |= {"bound": printed.bound, "probability": printed.probability, "tests": printed.tests}
    return {column: known.get(column, "") for column in CLAIM_COLUMNS}


def _claim(campaign: Finished) -> dict[str, object]:
    claim = campaign.predicate.claims[0]
    return {
        "source": campaign.preset,
        "seed": campaign.seed,
        **claim.model_dump(include={"quantity", "sense", "bound", "probability", "method", "rule"}),
        "tests": campaign.tests,
        "nominal_rollouts": campaign.nominal_rollouts,
        "true_rollouts": campaign.true_rollouts,
        "refuted": " ".join(claim.refuted),
    }


def claims_csv(found: Iterable[dict[str, object]]) -> str:
    """Return the claims as CSV; refuted assumptions by their ids, separated by spaces."""
    return csv_text(CLAIM_COLUMNS, ([claim[column] for column in CLAIM_COLUMNS] for claim in found))


def claims_markdown(found: Iterable[dict[str, object]]) -> str:
    """Return the claims for people, rounded so that none promises more than its certificate."""
    head = ["campaign", "seed", "rho* >=", "probability", "tests", "true rollouts", "refuted assumptions"]
    return markdown(head, ([_text(claim, column) for column in _SHOWN] for claim in found))


_SHOWN = ("source", "seed", "bound", "probability", "tests", "true_rollouts", "refuted")


def _text(claim: dict[str, object], column: str) -> str:
    value = claim[column]
    if column == "refuted":
        return ", ".join(str(value).split()) or ("" if claim["seed"] == "" else "none")
    return outward(value, ">=") if isinstance(value, float) else str(value)
