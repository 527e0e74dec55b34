"""Findings about rollouts that are compared with one another: repeats, seeds, global random states."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

from ....schemas.system_check import Measured
from .findings import SystemFinding, failed, passed, warning
from .measurements import Measurements, Rolled
from .trials import GROWTH, RANDOM, SEED, START


def _outcome(found: Measured) -> str:
    return "error" if found.error else found.file_sha256


def _groups(rolled: Iterable[Rolled]) -> Iterator[list[Rolled]]:
    groups: dict[str, list[Rolled]] = defaultdict(list)
    for trial, found in rolled:
        if trial.reseed is None:
            groups[trial.request.model_dump_json()].append((trial, found))
    return (group for group in groups.values() if len(group) > 1)


_REMEDY_STATE = (
    "set every variable anew at the beginning of a rollout: no global, attribute or default argument may keep what an "
    "earlier rollout has changed"
)
_REMEDY_FALSE_NOISY = (
    "use `seed`: np.random.default_rng(seed); or declare that nothing is random, with noisy=() or without the argument "
    "`seed`"
)

_REMEDY_IGNORED = "use the values of the declared disturbances; or declare none, where nothing is random"


def judge_repeatable(measurements: Measurements) -> SystemFinding | None:
    """Judge whether equal requests give equal bytes."""
    groups = list(_groups(measurements.rolled))
    if not groups or not measurements.good:
        return None
    differing = [group for group in groups if len({_outcome(found) for _, found in group if not found.error}) > 1]
    count = sum(len(group) for group in groups)
    if not differing and (failing := [each for each in groups if len({_outcome(found) for _, found in each}) > 1]):
        # Another fault, which `errors` names: it says nothing on state that is kept.
        at = f"at {failing[0][0][0].request.words(measurements.spec)}"
        text = f"{len(failing)} of {len(groups)} rollouts fail in one repeat and not in another; {at}"
        return failed("repeatable", text, "fix the failure first, then check again")
    if not differing:
        processes = len([run for run in measurements.runs if run.measured])
        return passed("repeatable", f"{count} rollouts repeat one another, in {processes} processes")
    at = f"at {differing[0][0][0].request.words(measurements.spec)}"
    cause, remedy = _cause(measurements, differing)
    return failed("repeatable", f"{len(differing)} of {len(groups)} rollouts {cause}; {at}", remedy)


def _cause(measurements: Measurements, differing: Sequence[list[Rolled]]) -> tuple[str, str]:
    """Return what the differences of equal rollouts depend on, and what to do about it."""
    if all(len({found.samples_sha256 for _, found in group}) == 1 for group in differing):
        return "repeat their samples, but not their visual part", "draw the visual part from the trajectory alone"
    if _depends_on_global_state(measurements):
        return (
            "differ when they are repeated: they depend on the global random state",
            "draw every random number from np.random.default_rng(seed), made in the rollout from its `seed`, or "
            "declare it as a disturbance",
        )
    fresh, first, start = measurements.rows(0), measurements.rows(1), len(measurements.runs[0].trials)
    # Both processes begin with the same rollouts, and nothing ran before them.
    processes = any(_outcome(a) != _outcome(b) for (_, a), (_, b) in zip(fresh, first, strict=False))
    at_once = any(_outcome(a) != _outcome(b) for (_, a), (_, b) in zip(first, first[start : 2 * start], strict=False))
    if processes and at_once:
        return (
            "differ when they are repeated, in a new process too",
            "draw every random number from np.random.default_rng(seed), and use no clock, no os.urandom and no "
            "threads whose order decides a result",
        )
    if processes:
        return (
            "differ between two processes, but not within one",
            "let nothing depend on the process: sort what comes from a set, use no hash(), id(), pid or start time",
        )
    if any(group[0][0].request.problem == START for group in differing):
        return "differ after other rollouts: the system keeps state from one rollout to the next", _REMEDY_STATE
    return (
        "differ between two processes that ran them in opposite orders",
        f"{_REMEDY_STATE}; draw random numbers from np.random.default_rng(seed) alone; use nothing of the process",
    )


def _depends_on_global_state(measurements: Measurements) -> bool:
    """Whether equal global random states give equal rollouts, and unequal ones do not."""
    groups: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
    for trial, found in measurements.rolled:
        if trial.reseed is not None and not found.error:
            groups[trial.request.model_dump_json()][trial.reseed].add(found.samples_sha256)
    return any(
        all(len(each) == 1 for each in by_seed.values()) and len(set.union(*by_seed.values())) > 1
        for by_seed in groups.values()
    )


def judge_seed(measurements: Measurements) -> SystemFinding | None:
    """Judge whether the rollouts depend on the seed as the system declares."""
    if (cut := _cut_seeds(measurements)) is not None:
        return cut
    pairs: dict[tuple[str, tuple[float, ...]], dict[int, str]] = defaultdict(dict)
    for trial, found in measurements.good:
        if trial.request.problem in {RANDOM, GROWTH}:
            pairs[trial.request.variant, trial.request.x][trial.request.seed] = found.samples_sha256
    tried = {key: len(set(found.values())) for key, found in pairs.items() if len(found) > 1}
    if not tried:
        return None
    texts = []
    for variant in sorted({variant for variant, _ in tried}):
        differing = sum(count > 1 for (each, _), count in tried.items() if each == variant)
        total = sum(each == variant for each, _ in tried)
        noisy = variant in measurements.spec.noisy
        name = f"rollouts of the variant {variant}" if len(measurements.spec.variants) > 1 else "rollouts"
        if noisy and not differing:
            text = f"{name} are declared as noisy, but at {total} starts two seeds give the same one"
            # The finding about disturbances says what to do about one that is ignored.
            disturbed = bool(measurements.spec.disturbances)
            return failed("seed", text, _REMEDY_IGNORED if disturbed else _REMEDY_FALSE_NOISY)
        if not noisy and differing:
            text = f"{name} are not declared as noisy, but at {differing} of {total} starts two seeds give two of them"
            return failed("seed", text, f"declare it, noisy=[{variant!r}], or do not use the seed in this variant")
        agree = f"differ at {differing}" if noisy else f"are the same at {total}"
        texts.append(f"{name} with two seeds {agree} of {total} starts")
    return passed("seed", "; ".join(texts))


def _cut_seeds(measurements: Measurements) -> SystemFinding | None:
    """Return the finding about a system that makes few different rollouts of many seeds."""
    by_variant: dict[str, list[str]] = defaultdict(list)
    for trial, found in measurements.good:
        if trial.request.problem == SEED:
            by_variant[trial.request.variant].append(found.samples_sha256)
    for digests in by_variant.values():
        # All equal: this start has no noise, or the seed is not used, which `judge_seed` tells at several starts.
        if 1 < (different := len(set(digests))) < len(digests):
            return warning(
                "seed",
                f"{len(digests)} seeds at one start give only {different} different rollouts: the seed seems to be "
                "cut, as by `seed % 7`, so that rollouts are not independent",
                "give the whole seed to the generator, and declare seed_bits=32 if it takes no longer one; if its "
                "noise, or what the columns record of it, has so few outcomes, this is no fault",
            )
    return None


def judge_random_state(measurements: Measurements) -> SystemFinding | None:
    """Judge the use of the global random states."""
    if not measurements.rolled:
        return None
    changed = sorted({name for _, found in measurements.rolled for name in found.reseeded})
    own = "make a generator in the rollout, np.random.default_rng(seed) or random.Random(seed), and draw from it alone"
    if _depends_on_global_state(measurements):
        return failed("random state", "another global random state gives another rollout", own)
    if changed:
        text = f"rollouts change the global state of {' and '.join(changed)}, and do not depend on it"
        return warning("random state", text, own)
    return passed("random state", "no global generator is used or read")
