"""The rollouts of one test as curves, from their files."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path, PurePosixPath

from ....schemas.errors import EvidenceError, PerfboundError, TrajectoryError
from ....schemas.file.problem_models import Problem
from ....schemas.result.facts import Header, RolloutFact
from ....schemas.trajectory.batch import Batch, BatchFile
from ....schemas.trajectory.reduced import Reduced, read_stored
from ....schemas.trajectory.trajectory import File, Trajectory, read_mcap
from ....schemas.values import Beyond
from ...campaign.seeds import VARIANTS
from ...certificate.words.format import replay_command
from ...mathematics.stl.tree import Formula
from ...store import files
from ...store.export_tables import robustness_unit
from ..data.rollouts import Curve, DrawnRollout, DrawnValue, Rollout, RolloutsOfTest
from . import curves, over_time
from .disturbances import drawn_values

MOST_REPLICATES = 3
"""Replicates with curves, the worst ones."""
MOST_ROLLOUTS = 24
"""Rollouts listed for a test."""


def of_test(
    directory: Path,
    header: Header,
    problem: Problem,
    facts: Sequence[RolloutFact],
    x: tuple[float, ...],
    *,
    system: str | None = None,
    also: Collection[str] = (),
) -> RolloutsOfTest:
    """Return the rollouts of one test, whose start is `x`; `error` names the files that cannot be read.

    `system` is the reference of a system that is not installed. Rollouts `also` have curves, whatever their robustness.
    """
    tree, beyond = curves.formula(header), header.config.beyond
    read, errors = _read(directory, _with_curves(facts, also))
    names = curves.relevant_quantities(header, problem, _deciding(read, tree, beyond))
    others = curves.further_columns(header, names)
    further = others[: curves.MOST_FURTHER]
    limits = curves.limits(header, (*names, *further))
    traces, more, drawn = list[Curve](), list[Curve](), list[DrawnRollout]()
    for fact, trajectory in read:
        label = f"{fact.rollout.variant}, replicate {fact.rollout.replicate}"
        of_rollout = partial(
            curves.of_trajectory,
            header,
            trajectory=trajectory,
            label=label,
            variant=fact.rollout.variant,
            rollout=str(fact.rollout),
        )
        traces += of_rollout(names)
        more += of_rollout(further, most=curves.FURTHER_POINTS)
        drawn.append(over_time.with_margin(fact, trajectory, tree, header.spec.after_end, beyond))
    shown, listed = over_time.shown_formula(tree), _worst_first(facts)[:MOST_ROLLOUTS]
    return RolloutsOfTest(
        problem=facts[0].rollout.problem,
        test=facts[0].rollout.test,
        traces=tuple(traces),
        limits=tuple(limit for _, limit in limits),
        rollouts=tuple(
            described(fact, x, replay_command(directory, header, str(fact.rollout), system), drawn)
            for fact, drawn in zip(listed, disturbances_of(header, listed), strict=True)
        ),
        limit_columns=tuple(column for column, _ in limits),
        error="; ".join(errors) or None,
        inputs=tuple(curves.of_signals(header, x)),
        drawn=tuple(drawn),
        margin_of=shown[0] if any(each.t for each in drawn) else "",
        attained=shown[1],
        margin_unit=robustness_unit(header.config, header.spec),
        further=tuple(more),
        further_columns=further,
        more_columns=len(others) - len(further),
        x=x,
    )


def _read(directory: Path, facts: Iterable[RolloutFact]) -> tuple[list[tuple[RolloutFact, Trajectory]], list[str]]:
    """Return the trajectories of rollouts, and of files that cannot be read the reasons."""
    read, errors = list[tuple[RolloutFact, Trajectory]](), list[str]()
    for fact in facts:
        try:
            read.append((fact, read_recorded(directory, fact).trajectory))
        except PerfboundError as error:
            errors.append(str(error))
    return read, errors


def _deciding(read: Sequence[tuple[RolloutFact, Trajectory]], tree: Formula | None, beyond: Beyond) -> frozenset[str]:
    """Return the quantities that decide the worst of several rollouts."""
    rated = [(fact.robustness, trajectory) for fact, trajectory in read if fact.robustness is not None]
    if not rated:
        return frozenset()
    return over_time.deciding_quantities(min(rated, key=lambda each: each[0])[1], tree, beyond)


def disturbances_of(header: Header, facts: Sequence[RolloutFact]) -> list[tuple[DrawnValue, ...]]:
    """Return the disturbances of recorded rollouts."""
    found = dict[RolloutFact, tuple[DrawnValue, ...]]()
    # At once: of one rollout they take as long as of a hundred.
    for variant in VARIANTS:
        own = [fact for fact in facts if fact.rollout.variant == variant]
        found.update(zip(own, drawn_values(header, variant, [fact.seed for fact in own]), strict=True))
    return [found[fact] for fact in facts]


def described(fact: RolloutFact, x: tuple[float, ...], command: str, drawn: tuple[DrawnValue, ...] = ()) -> Rollout:
    """Return the data of a recorded rollout, whose start is `x` and whose disturbances are `drawn`."""
    return Rollout(
        id=str(fact.rollout),
        **fact.rollout._asdict(),
        seed=fact.seed,
        x=x,
        robustness=fact.robustness,
        path=fact.path if _is_inside(fact.path) else "",
        command=command,
        disturbances=drawn,
    )


def read_recorded(directory: Path, fact: RolloutFact) -> File:
    """Return the file of a recorded rollout.

    Raises:
        EvidenceError: the file is missing, damaged, or not in the run directory.

    """
    if not _is_inside(fact.path):
        raise EvidenceError(
            f"{directory}: rollout {fact.rollout}: {fact.path!r} is not a path in the run directory; restore the "
            "database from a copy"
        )
    if not fact.kept:
        raise EvidenceError(f"rollout {fact.rollout}: its samples were not kept (key `keep`)")
    try:
        if fact.batch:
            return read_batch_of(directory, fact).alone(fact.rollout)
        return read_mcap(files.read_evidence(directory, fact.path, fact.sha256))
    except TrajectoryError as error:
        raise EvidenceError(f"{directory / fact.path}: {error}; restore it from a copy") from None


def read_batch_of(directory: Path, fact: RolloutFact) -> BatchFile[Batch] | BatchFile[Reduced]:
    """Return the file of the batch that a recorded rollout belongs to; raises as its reader, or EvidenceError."""
    return _batch_file(directory, fact.path, fact.batch)


@lru_cache(maxsize=2)
def _batch_file(directory: Path, path: str, sha256: str) -> BatchFile[Batch] | BatchFile[Reduced]:
    # Kept: the rollouts of a batch are read one after the other.
    return read_stored(files.read_evidence(directory, path, sha256))


def _is_inside(path: str) -> bool:
    """Return whether a path of the untrusted database is one in the run directory, and no URL of another kind."""
    parts = PurePosixPath(path).parts
    return bool(parts) and parts[0] == files.FOLDER and ".." not in parts


def _with_curves(facts: Sequence[RolloutFact], also: Collection[str]) -> Iterator[RolloutFact]:
    """Yield the worst replicates and those `also` named, each true one after its nominal one."""
    true = [fact for fact in facts if fact.rollout.variant == "true"]
    nominal = {fact.rollout.replicate: fact for fact in facts if fact.rollout.variant == "nominal"}
    yielded = set()
    for place, fact in enumerate(_worst_first(true or facts)):
        if place >= MOST_REPLICATES and str(fact.rollout) not in also:
            continue
        # A nominal system without noise has one rollout for all replicates.
        partner = nominal.get(fact.rollout.replicate) or nominal.get(0)
        if true and partner and partner.rollout not in yielded:
            yielded.add(partner.rollout)
            yield partner
        yield fact


def _worst_first(facts: Iterable[RolloutFact]) -> list[RolloutFact]:
    return sorted(facts, key=lambda fact: (fact.robustness or 0.0, fact.rollout))
