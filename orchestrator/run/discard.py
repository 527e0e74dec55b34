"""The discard of a recorded rollout from which the objective of its test cannot be computed."""

from contextlib import closing
from pathlib import Path

from ...schemas.errors import PerfboundError, RequestError, one_line
from ...schemas.ids import RolloutId
from ...schemas.ranges import MAX_FILE_BYTES
from ...schemas.result.facts import DiscardFact, RolloutFact
from ...schemas.trajectory.trajectory import Trajectory, decode
from ..campaign import state
from ..campaign.admission import objective_fault
from ..campaign.ledger import Ledger
from ..certificate import files
from ..store.discard import write_discard
from ..store.files import contents
from ..store.journal import Journal
from ..store.lock import campaign_lock
from ..store.rows import existing

LONGEST = 300
"""Characters of a reason."""


def discard_rollout(directory: Path, name: str, reason: str) -> DiscardFact:
    """Discard a recorded rollout, so that a resume simulates it again with the same seed.

    A valid observation stays: only what the border of today would refuse can be discarded, before its test is observed.

    Raises:
        PerfboundError: there is no such rollout, its objective can be computed, its test is observed, the campaign is
            running or finished, or the reason is empty or too long.

    """
    existing(directory)
    reason = one_line(reason.strip())
    if not 0 < len(reason) <= LONGEST:
        raise PerfboundError(f"--reason: has {len(reason)} characters; give 1 to {LONGEST}, for the certificate")
    with campaign_lock(directory) as held:
        # Under the lock: a run that had it may have finished a moment ago.
        if files.read(directory) is not None:
            raise PerfboundError(f"{directory}: the campaign has finished, and its evidence never changes")
        with closing(Journal.open(directory)) as journal:
            ledger = Ledger(directory, journal)
            ledger.replay()
            fact = _recorded(ledger, journal, name)
            _refuse_valid(ledger, directory, fact)
        # The replay may have taken minutes, in which the file server can give the lock of this node away.
        held.check()
        return write_discard(directory, fact, reason)


def _recorded(ledger: Ledger, journal: Journal, name: str) -> RolloutFact:
    """Return a recorded rollout of a test that is not observed."""
    try:
        rollout = RolloutId.parse(name)
    except ValueError:
        raise RequestError(f"{name!r} is no rollout; give one like nominal_robustness.3.true.0") from None
    if state.plan_of(ledger.state, rollout.problem).batch > 1:
        raise RequestError(f"{name}: in a campaign with batches a rollout without an objective is made again by itself")
    found = [fact for fact in journal.recorded() if fact.rollout == rollout and isinstance(fact, RolloutFact)]
    if not found:
        raise RequestError(f"{name}: no such rollout is recorded; `perfbound export` lists them")
    series = ledger.series.get(rollout.problem)
    if series is None or found[0] not in series.rollouts.get(rollout.test, ()):
        raise RequestError(f"{name}: its test is observed, and an observation is never discarded")
    return found[0]


def _refuse_valid(ledger: Ledger, directory: Path, fact: RolloutFact) -> None:
    series, rollout = ledger.series[fact.rollout.problem], fact.rollout

    def others(key: tuple[str, int]) -> list[Trajectory]:
        partner = RolloutId(*rollout[:2], *key)
        recorded = [ledger.recorded.read(each) for each in series.rollouts[rollout.test] if each.rollout == partner]
        # What was discarded of the pair as well: it may be the other one that is at fault.
        kept = [each.path for each in series.discards if each.rollout == partner]
        return recorded + [decode(contents(directory / path, MAX_FILE_BYTES)) for path in kept]

    if objective_fault(ledger, rollout, ledger.recorded.read(fact), others) is None:
        raise RequestError(
            f"{rollout}: the objective can be computed from it, so it is evidence, and evidence is never discarded"
        )
