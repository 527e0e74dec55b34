"""A recorded rollout: its fact, its file, and its request."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy import Connection

from ....schemas.amounts import some_of
from ....schemas.base import canonical_json
from ....schemas.batch import BatchRequest
from ....schemas.errors import EvidenceError, PerfboundError, one_line
from ....schemas.ids import RECHECK, RolloutId, closing_check
from ....schemas.result.facts import Header, RolloutFact
from ....schemas.rollout import RolloutRequest, WithinBatch
from ....schemas.trajectory.trajectory import Trajectory
from ...store import tables
from ...store.changes import batch_in, proposal_in, rollouts_in
from ...store.read import failures, read_header, reading
from .disturbances import words
from .of_tests import read_batch_of, read_recorded

_rollouts = tables.rollouts.c


@dataclass(frozen=True, slots=True)
class RecordedRollout:
    """One rollout of a campaign; `trajectory` is None if its file is damaged, and `damage` gives the reason."""

    header: Header
    fact: RolloutFact
    request: RolloutRequest
    trajectory: Trajectory | None
    damage: str = ""
    batch: BatchRequest | None = None
    """Of a rollout that depends on the others of its batch: only the batch as a whole can be simulated again."""


def load_recorded(directory: Path, text: str) -> RecordedRollout:
    """Return the rollout `text`, e.g. `sim_gap.3.true.0`, of the campaign in `directory`.

    Raises:
        JournalError: there is no campaign, or it cannot be read.
        PerfboundError: it has no such rollout.
        EvidenceError: the file is whole, but belongs to another request than the one that follows from the facts.

    """
    with reading(directory) as connection:
        header = read_header(connection, directory)
        fact, x = _find(connection, header, directory, text)
    # The file of a batch has no visual part, whatever the campaign asks for.
    template = replace(header.template, visual=False) if fact.batch else header.template
    # The recorded seed, for a recheck has that of the rollout it repeats; `verify` shows whether it is the right one.
    request = template.request(fact.rollout, x, fact.seed)
    whole = fact.batch and header.spec.batch_is_the_unit
    try:
        file = read_recorded(directory, fact)
    except EvidenceError as error:  # a replay can restore a damaged file
        repeated = read_batch_of(directory, fact).requested if whole and not fact.kept else None
        return RecordedRollout(header, fact, request, None, str(error), repeated)
    # As its seed, the batch that a recheck repeats.
    if (within := file.request.get("within")) and closing_check(fact.rollout.problem) == RECHECK:
        with suppress(ValueError):  # of anyone's file: then it is another request
            batch = WithinBatch.model_validate_json(canonical_json(within))
            request = template.request(fact.rollout, x, fact.seed, within=batch)
    # The digest proves that this is the recorded file, not that its worker simulated this request.
    if file.request != request.model_dump(mode="json"):
        raise EvidenceError(
            f"{directory / fact.path}: it belongs to another request than the one that follows from the facts; "
            "check the campaign with `perfbound verify`"
        )
    repeated = read_batch_of(directory, fact).requested if whole else None
    return RecordedRollout(header, fact, request, file.trajectory, batch=repeated)


def load_batch(directory: Path, recorded: RecordedRollout) -> list[RecordedRollout]:
    """Return the rollouts in the file of a recorded one that have samples there, in their order.

    Raises:
        JournalError: the database cannot be read.
        EvidenceError: the file is missing or damaged.

    """
    header, fact = recorded.header, recorded.fact
    if not fact.batch:
        return [recorded]
    with reading(directory) as connection:
        facts = {each.rollout: each for each in batch_in(connection, directory, fact) if each.kept}
    file = read_batch_of(directory, fact)
    places = ((place, facts[each]) for place, each in enumerate(file.requested.rollouts) if each in facts)
    return [
        RecordedRollout(header, each, file.requested.single(place), file.batch.trajectory(place))
        for place, each in places
    ]


def number_words(numbers: Iterable[tuple[str, str, float]]) -> str:
    """Return names and units with their values in words, of many the first ones.

    >>> number_words([("gap", "m", 20.0), ("load", "1", 0.5)])
    'gap = 20 m, load = 0.5'
    """
    return some_of([f"{name} = {value:.6g} {unit}".removesuffix(" 1").rstrip() for name, unit, value in numbers])


def description(found: RecordedRollout) -> str:
    """Return system, variant, start, seed and robustness of a rollout in one line."""
    request, spec = found.request, found.header.spec
    numbers = [(each.name, each.unit, value) for each, value in zip(spec.own_parameters, request.x, strict=True)]
    if request.disturbances:
        every = zip(spec.disturbances, request.disturbances, strict=True)
        numbers += [(law.name, law.unit, value) for law, value in every if law.name in spec.as_parameters]
    start = number_words(numbers)
    score = "" if found.fact.robustness is None else f", robustness {found.fact.robustness:.6g}"
    score += "; its sign may depend on a time stamp close to a border of a window" if found.fact.by_tolerance else ""
    drawn = words(found.header, request.variant, request.seed)
    parts = [spec.name, request.variant, start, drawn, f"seed {request.seed}{score}"]
    return ", ".join(filter(None, parts))


def _find(connection: Connection, header: Header, directory: Path, text: str) -> tuple[RolloutFact, tuple[float, ...]]:
    try:
        rollout = RolloutId.parse(text.replace("-", "."))
    except ValueError:
        raise PerfboundError(
            f"{text!r} names no rollout; use problem.test.variant.replicate, e.g. {_example(connection)}"
        ) from None
    found = {fact.rollout: fact for fact in rollouts_in(connection, directory, rollout.problem, rollout.test)}
    if rollout not in found:
        existing = _existing(connection, header, rollout, [str(each) for each in sorted(found)])
        failed = [each.failure.reason for each in failures(directory) if each.attempt.rollout == rollout]
        what = f"rollout {rollout} failed: {one_line(failed[-1])}" if failed else f"no rollout {rollout} is recorded"
        raise PerfboundError(f"{directory}: {what}; {existing}")
    return found[rollout], proposal_in(connection, directory, rollout.problem, rollout.test).x


def _example(connection: Connection) -> str:
    row = connection.execute(sa.select(tables.rollouts).order_by(_rollouts.seq).limit(1)).first()
    return f"{row.problem}.{row.test}.{row.variant}.{row.replicate}" if row else "sim_gap.0.true.0"


def _existing(connection: Connection, header: Header, rollout: RolloutId, of_test: list[str]) -> str:
    """Return the nearest choice: rollouts of the test, tests of the problem, or the problems."""
    if of_test:
        return f"choose one of its test: {', '.join(of_test[:4])}{', ...' if len(of_test) > 4 else ''}"
    # A row has the rollouts of one test, or of the tests of a batch.
    last = sa.func.max(_rollouts.test + _rollouts.places / _rollouts.replicates - 1)
    number = connection.execute(sa.select(last).where(_rollouts.problem == rollout.problem)).scalar()
    if number is not None:
        return f"choose a test of {rollout.problem} from 0 to {number:,.0f}"
    first = sa.func.min(_rollouts.seq)
    recorded = connection.execute(sa.select(_rollouts.problem).group_by(_rollouts.problem).order_by(first)).scalars()
    names = dict.fromkeys([*recorded, *(problem.name for problem in header.config.problems)])
    return f"choose a problem or a check: {', '.join(names)}"
