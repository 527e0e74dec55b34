"""The findings about declared disturbances, apart from `repeats`, whose rollouts differ in their seeds alone."""

import numpy as np

from ....schemas.draws.laws import ReportedLaws
from ....schemas.system_check import Measured
from ...mathematics.bounds.checks.law import LawTest
from .findings import SystemFinding, failed, passed, warning
from .measurements import Measurements
from .trials import DISTURBED, RESIDUAL, START

REPORTED_LEVEL = 1e-4
"""Of a false alarm: many systems that are right are checked, and a campaign has more numbers."""


def judge_disturbances(measurements: Measurements) -> SystemFinding | None:
    """Judge whether rollouts depend on every disturbance, and on the seed besides as the system declares."""
    spec, before = measurements.spec, dict[str, Measured]()
    ignored, differing, compared = dict[str, bool](), False, 0
    for trial, found in measurements.good:
        request = trial.request
        if request.problem == START and trial.reseed is None:
            before.setdefault(request.variant, found)
        if (first := before.get(request.variant)) is None or request.problem not in {RESIDUAL, DISTURBED}:
            continue
        differs, compared = found.samples_sha256 != first.samples_sha256, compared + 1
        if request.problem == RESIDUAL:
            differing = differing or differs
        else:
            name = spec.disturbances[request.replicate].name
            ignored[name] = ignored.get(name, True) and not differs
    if not compared:
        return None
    if differing and not spec.residual:
        return failed(
            "disturbances",
            "with equal disturbances two seeds give two rollouts, and the system declares that nothing else is random",
            "declare what the seed still decides as a disturbance, too, or leave residual=False out",
        )
    if unused := [name for name, is_ignored in ignored.items() if is_ignored]:
        return warning(
            "disturbances",
            f"another value of {' or of '.join(unused)} changes nothing at this start",
            "use the argument of this name in place of a number that the simulator draws itself",
        )
    if spec.residual and not differing:
        return warning(
            "disturbances",
            "with equal disturbances two seeds give one rollout: nothing else seems to be random",
            "declare residual=False, or leave the argument `seed` out",
        )
    rest = "the seed decides something besides" if spec.residual else "nothing else is random"
    return passed("disturbances", f"each of {len(ignored)} has an effect, and {rest}")


def judge_reported(measurements: Measurements) -> SystemFinding | None:
    """Judge whether the numbers that rollouts report have the laws that the system declares."""
    spec = measurements.spec
    # Of each seed once: equal seeds draw equal numbers, perhaps at other starts, too.
    by_seed = {
        trial.request.seed: found.reported
        for trial, found in measurements.good
        if trial.request.variant in spec.noisy and trial.reseed is None
    }
    if not by_seed:
        return None
    values = np.array(list(by_seed.values()))
    shares = ReportedLaws(spec.reported).shares(values, np.random.default_rng(0).random(values.shape))
    refuted = []
    for law, column, own in zip(spec.reported, values.T, shares.T, strict=True):
        test = LawTest(1, level=REPORTED_LEVEL / len(spec.reported))
        test.observe(own[:, np.newaxis])
        finding = test.finding()
        if finding.values.get("impossible"):
            refuted.append(f"{law.name} has values that its law, {law.words}, does not have")
        elif finding.status == "refuted":
            refuted.append(
                f"{law.name}, of mean {column.mean():.3g} and sd {column.std():.3g}, does not keep {law.words}"
            )
    if refuted:
        return failed(
            "reported",
            f"of the numbers that {len(values)} rollouts report {'; '.join(refuted)}",
            "declare the law that the system draws from, and put the number drawn into the first sample of its column",
        )
    return passed("reported", f"the numbers that {len(values)} rollouts report do not contradict their laws")
