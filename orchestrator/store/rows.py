"""Rows of the campaign database as facts, and facts as rows; without SQL, for every way of reading."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...schemas.base import canonical_json
from ...schemas.errors import JournalError, OtherVersionError
from ...schemas.failure import Failure
from ...schemas.file.config import CampaignConfig
from ...schemas.ids import Attempt
from ...schemas.result.facts import (
    NO_FAILURE,
    BoundFact,
    ExtensionFact,
    Header,
    check_rules,
)
from ...schemas.system import SystemSpec
from ...schemas.values import Bound

DATABASE = "campaign.db"
BESIDE = ("trajectories", "certificate.json", "manifest.sha256")
"""What a run directory has that no other folder has."""
SCHEMA_VERSION = 1
LONGEST_NUMBER = 20
"""Characters of a schema version that are shown."""


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


def check_version(directory: Path, version: object) -> None:
    """Refuse a database by its schema version, which may be anything.

    Raises:
        OtherVersionError: this perfbound does not read it.

    """
    if version != SCHEMA_VERSION:
        found = "no schema version" if version is None else f"schema version {repr(version)[:LONGEST_NUMBER]}"
        raise OtherVersionError(
            f"{directory / DATABASE}: {found}, this perfbound reads {SCHEMA_VERSION}; use the perfbound that wrote it"
        )


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


def bound_fact(row: Any) -> BoundFact:
    """Read a row of `bounds`."""
    budget = row.stopped_by == "budget"
    bound = Bound(row.upper, row.lower, None if budget else row.stopped_by)
    return BoundFact(row.problem, row.test, bound, budget, row.test + 1 - row.block)


def extension_fact(row: Any) -> ExtensionFact:
    """Read a row of `extensions`."""
    budgets = tuple((str(problem), int(tests)) for problem, tests in json.loads(row.budgets))
    return ExtensionFact(row.number, budgets)


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


def work_name(path: str) -> str:
    """Return what attempts call the rollout or the batch of a trajectory file, by its path."""
    return Path(path).stem


def attempt_key(attempt: Attempt) -> dict[str, Any]:
    """Return the key of an attempt in `attempts` and `outcomes`."""
    return {"rollout": str(attempt.rollout), "attempt": attempt.number}


def outcome_fields(outcome: str | Failure) -> dict[str, Any]:
    """Return the outcome of an attempt as columns of `outcomes`."""
    kind, text = (outcome.kind, outcome.reason) if isinstance(outcome, Failure) else (None, outcome)
    if kind and text in NO_FAILURE:  # a reason is text of a system under test, and may be anything
        text = f"failed: {text}"
    return {"outcome": text, "kind": kind}
