"""Rows of the campaign database as facts, and facts as rows; without SQL, for every way of reading."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...schemas.base import canonical_json
from ...schemas.campaign import CampaignConfig
from ...schemas.errors import JournalError
from ...schemas.facts import (
    NO_FAILURE,
    BoundFact,
    DiscardFact,
    ExtensionFact,
    Fact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from ...schemas.failure import Failure
from ...schemas.ids import Attempt, RolloutId
from ...schemas.rules import check_rules
from ...schemas.system import SystemSpec
from ...schemas.values import Bound, Observation, Proposal

DATABASE = "campaign.db"
BESIDE = ("trajectories", "certificate.json", "manifest.sha256")
"""What a run directory has that no other folder has."""
SCHEMA_VERSION = 9
"""Of a new database. A database keeps its version: its rows are written without the columns that it lacks."""
READ_VERSIONS = tuple(range(1, SCHEMA_VERSION + 1))
ADDED_IN = {
    ("campaign", "rules"): 2,
    ("outcomes", "kind"): 3,
    ("sessions", "system"): 3,
    ("sessions", "revision"): 4,
    ("sessions", "platform"): 5,
    ("sessions", "account"): 7,
    ("sessions", "options"): 8,
    ("rollouts", "by_tolerance"): 9,
    ("rollouts", "ended"): 9,
}
"""(table, column) to the schema version that added it; every other column is as old as version 1.

Campaigns without `rules` follow rules 1; the kind of a failure without `kind` is unknown.
"""
TABLES_ADDED_IN = {"discards": 5, "set_aside": 5, "opinions": 5, "extensions": 6}
"""Table to the schema version that added it; every other table is as old as version 1."""
_HEADER = ("run", "name", "seed", "config", "config_sha256", "system", "software", "rules")


def existing(directory: Path) -> Path:
    """Return the database of a campaign.

    Raises:
        JournalError: there is none in `directory`, or it is empty.

    """
    path = directory / DATABASE
    if not path.is_file():
        if any((directory / name).exists() for name in BESIDE):
            raise JournalError(f"{path}: missing, beside the files of its campaign; restore it from a copy")
        raise JournalError(
            f"{directory}: no campaign here (no {DATABASE}); start one with `perfbound run CAMPAIGN.toml`, or wait "
            "until a submitted job has begun it"
        )
    if not path.stat().st_size:
        raise JournalError(f"{path}: it was emptied; restore it from a copy")
    return path


# From rows to facts; a row has the columns of its table as attributes.


def checked_version(directory: Path, version: int | None) -> int:
    """Return the schema version of a database.

    Raises:
        JournalError: this perfbound does not read it.

    """
    if version is None or version not in READ_VERSIONS:
        raise JournalError(
            f"{directory / DATABASE}: schema version {version}, this perfbound reads 1 to {SCHEMA_VERSION}; "
            "use the perfbound that wrote it, or a newer one"
        )
    return version


def has_column(table: str, column: str, version: int) -> bool:
    """Whether a table has a column in databases of this schema version."""
    return ADDED_IN.get((table, column), 1) <= version


def has_table(table: str, version: int) -> bool:
    """Whether databases of this schema version have a table."""
    return TABLES_ADDED_IN.get(table, 1) <= version


def header_columns(version: int) -> tuple[str, ...]:
    """Return the columns of table `campaign` in a database of this schema version."""
    return tuple(name for name in _HEADER if has_column("campaign", name, version))


def checked_header(directory: Path, rows: Sequence[Any]) -> Header:
    """Return the header in the rows of table `campaign`.

    Raises:
        JournalError: it is missing, or was changed, or follows rules that this perfbound has not.

    """
    try:
        return _parsed_header(directory, rows)
    except (ValueError, AttributeError, TypeError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise JournalError(
            f"{directory / DATABASE}: the header was changed after the start ({reason}); restore it from a copy"
        ) from None


def _parsed_header(directory: Path, rows: Sequence[Any]) -> Header:
    if len(rows) != 1:
        raise ValueError("there are several" if rows else "it is missing")
    row = rows[0]
    software = json.loads(row.software)
    rules = check_rules(row.rules, software, str(directory / DATABASE))
    config, spec = CampaignConfig.model_validate_json(row.config), SystemSpec.model_validate_json(row.system)
    if config.digest != row.config_sha256:
        raise ValueError("the campaign file is another one")
    if (row.name, row.seed) != (config.name, config.seed):
        raise ValueError("name or seed are not the file's")
    return Header(row.run, config, spec, software, config.digest, spec.digest, rules)


def proposal_fact(row: Any) -> ProposalFact:
    """Read a row of `tests`."""
    x = tuple(json.loads(row.x))
    return ProposalFact(row.problem, row.test, Proposal(row.node, x, row.mu, row.sigma, row.beta, row.F))


def rollout_fact(row: Any) -> RolloutFact:
    """Read a row of `rollouts`."""
    rollout = RolloutId(row.problem, row.test, row.variant, row.replicate)
    file = (row.sha256, row.size, row.path)
    return RolloutFact(rollout, row.seed, *file, row.robustness, bool(row.by_tolerance), row.ended)


def discard_fact(row: Any) -> DiscardFact:
    """Read a row of `discards`."""
    rollout = RolloutId(row.problem, row.test, row.variant, row.replicate)
    return DiscardFact(rollout, row.seed, row.sha256, row.size, row.path, row.reason)


def observation_fact(row: Any) -> ObservationFact:
    """Read a row of `observations`."""
    found = Observation(row.y, tuple(json.loads(row.each)))
    return ObservationFact(row.problem, row.test, found, row.chain)


def bound_fact(row: Any) -> BoundFact:
    """Read a row of `bounds`."""
    budget = row.stopped_by == "budget"
    bound = Bound(row.upper, row.lower, None if budget else row.stopped_by)
    return BoundFact(row.problem, row.test, bound, budget)


def extension_fact(row: Any) -> ExtensionFact:
    """Read a row of `extensions`."""
    budgets = tuple((str(problem), int(tests)) for problem, tests in json.loads(row.budgets))
    return ExtensionFact(row.number, budgets)


READERS: dict[str, Callable[[Any], Fact]] = {
    "tests": proposal_fact,
    "rollouts": rollout_fact,
    "discards": discard_fact,
    "observations": observation_fact,
    "bounds": bound_fact,
    "extensions": extension_fact,
}
"""By the name of the table."""


# From facts to rows


def header_row(header: Header) -> dict[str, Any]:
    """Return the row of `campaign`, without its sequence number."""
    return {
        "run": header.run,
        "name": header.config.name,
        "seed": header.config.seed,
        "config": canonical_json(header.config.model_dump(mode="json")),
        "config_sha256": header.config_sha256,
        "system": canonical_json(header.spec.model_dump(mode="json")),
        "software": canonical_json(header.software),
        "rules": header.rules,
    }


def fact_row(fact: Fact) -> tuple[str, dict[str, Any]]:
    """Return the table of a fact, and its row without the sequence number.

    Raises:
        ValueError: a number is not finite.

    """
    match fact:
        case ProposalFact(problem, test, chosen):
            row = {"problem": problem, "test": test, **_fields(chosen), "x": canonical_json(list(chosen.x))}
            table = "tests"
        case RolloutFact():
            row = _fields(fact)
            row |= row.pop("rollout")._asdict()
            table = "rollouts"
        case DiscardFact():
            raise TypeError("a discard moves a row of `rollouts`: see store.discard")
        case ObservationFact(problem, test, found, chain):
            row = {"problem": problem, "test": test, "y": found.y, "each": canonical_json(list(found.each))}
            row["chain"] = chain
            table = "observations"
        case BoundFact(problem, test, bound):
            row = {"problem": problem, "test": test, "upper": bound.upper, "lower": bound.lower}
            row["stopped_by"] = fact.stopped_by
            table = "bounds"
        case ExtensionFact(number, budgets):
            row = {"number": number, "budgets": canonical_json([list(each) for each in budgets])}
            table = "extensions"
    canonical_json(row)  # SQLite stores NaN as NULL without an error; this raises, for every kind of fact
    return table, row


def attempt_key(attempt: Attempt) -> dict[str, Any]:
    """Return the key of an attempt in `attempts` and `outcomes`."""
    return {"rollout": str(attempt.rollout), "attempt": attempt.number}


def outcome_fields(outcome: str | Failure, version: int) -> dict[str, Any]:
    """Return the outcome of an attempt as columns of `outcomes` in a database of this schema version."""
    kind, text = (outcome.kind, outcome.reason) if isinstance(outcome, Failure) else (None, outcome)
    if kind and text in NO_FAILURE:  # a reason is text of a system under test, and may be anything
        text = f"failed: {text}"
    return {"outcome": text} | ({"kind": kind} if has_column("outcomes", "kind", version) else {})


def _fields(value: RolloutFact | Proposal) -> dict[str, Any]:
    return {name: getattr(value, name) for name in value.__slots__}
