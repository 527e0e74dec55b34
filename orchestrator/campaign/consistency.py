"""Constants that contradict each other or the data: sentences for the user, who may have reasons; nothing is refused.

Every function is pure: of the plan alone before the start, of the plan and the closed tests during the campaign.
"""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...schemas.file.objectives import OBJECTIVES, replicates_are_robustness
from ...schemas.file.problem_models import KernelProblem, PaperProblem, Problem, RigorousProblem
from ...schemas.system import SystemSpec
from ..mathematics.bounds.checks.audit import replicate_spread
from ..mathematics.gp.lattice import Lattice
from .plan import Plans, ProblemPlan, bounded_plans

FEWEST = 10
"""Values before a clip or a spread is worth a sentence."""
FAR = 100.0
"""Times the spread of replicates from which on a noise scale is called far too large."""


def before(plans: Plans, spec: SystemSpec) -> list[str]:
    """Return a line for every contradiction within the campaign file."""
    return [line for plan in bounded_plans(plans) for line in of_plan(plan, spec)]


def of_plan(plan: ProblemPlan, spec: SystemSpec) -> Iterator[str]:
    """Yield a line for every contradiction within the constants of one problem."""
    problem = plan.problem
    if not isinstance(problem, KernelProblem):
        return
    name, length = plan.key, problem.kernel.length_scale
    if isinstance(plan.candidates, Lattice):
        steps = zip(plan.parameters, plan.candidates.spacing, strict=True)
        lengths = length if isinstance(length, dict) else dict.fromkeys(plan.parameters, length)
        coarse = ", ".join(f"{step:.3g} along {axis}" for axis, step in steps if step > lengths[axis])
        if coarse:
            given = problem.kernel.described
            yield (
                f"{name}: kernel.length_scale = {given} is below the spacing of the lattice, {coarse}: between two "
                "nodes the objective may change as much as over the whole box; raise resolution or length_scale"
            )
    units = list(dict.fromkeys(parameter.unit for parameter in spec.parameters))
    if len(units) > 1 and not isinstance(length, dict):
        yield (
            f"{name}: kernel.length_scale = {length:g} is one length for parameters in {_listed(units)}: the objective "
            "then changes as fast along each of them; give one length per parameter: { name = number, ... }"
        )
    noisy = set(plan.variants) & set(spec.noisy)
    if not isinstance(problem, PaperProblem | RigorousProblem):
        return  # it assumes no noise scale
    if noisy and plan.replicates == 1 and problem.noise_scale != "derived" and problem.noise_scale > 0:
        yield (
            f"{name}: noise_scale = {problem.noise_scale:g} is a guess that no data are compared with, because "
            "replicates = 1; choose at least 2"
        )


def of_tests(
    plan: ProblemPlan, y: Sequence[float], each: Iterable[Sequence[float]], robustness: Sequence[float]
) -> dict[str, str]:
    """Return a line for every key whose constant contradicts the closed tests of a problem.

    `y` has the observations, `each` the replicates of each, and `robustness` the clipped robustness of the rollouts.
    """
    found: dict[str, str] = {}
    if len(robustness) >= FEWEST:
        found |= _clip(plan, robustness)
    if isinstance(plan.problem, KernelProblem) and y:
        found |= _norm(plan, plan.problem, y)
    if isinstance(plan.problem, PaperProblem | RigorousProblem) and y:
        found |= _noise(plan, plan.problem, each)
    return found


def robustness_of(problem: Problem, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the clipped robustness of the rollouts (n,) from the values of replicates; empty where these have none."""
    objective = OBJECTIVES[problem.name]
    if objective.measured != "robustness":
        return np.empty(0)
    if replicates_are_robustness(problem.name, problem.method):
        return values
    return np.empty(0) if objective.risk else -values  # a linearised risk is no robustness


def _clip(plan: ProblemPlan, robustness: Sequence[float]) -> dict[str, str]:
    low, high = plan.clip
    if all(value <= low for value in robustness):
        end = f"lower clip {low:g}"
    elif all(value >= high for value in robustness):
        end = f"upper clip {high:g}"
    else:
        return {}
    line = f"{plan.key}: all {len(robustness)} robustness values so far are at the {end}"
    return {"clip": f"{line}: the clip hides every difference between starts; choose one that contains them"}


def _norm(plan: ProblemPlan, problem: KernelProblem, y: Sequence[float]) -> dict[str, str]:
    largest = max(abs(value - problem.prior_mean) for value in y)
    tau = problem.misspecification if isinstance(problem, RigorousProblem) else 0.0
    # k(z, z) = 1, so that no |J - m0| exceeds B. Noise can: this is a hint, the audit has the test.
    if largest <= problem.rkhs_norm + tau:
        return {}
    noise = f", with noise of scale {plan.noise:.3g}" if plan.noise else ""
    return {
        "rkhs_norm": f"{plan.key}: rkhs_norm = {problem.rkhs_norm:g} is below |y - prior_mean| = {largest:.3g} of a "
        f"test{noise}: B bounds this distance everywhere, so B is too small, or prior_mean = {problem.prior_mean:g} "
        "is far off"
    }


def _noise(
    plan: ProblemPlan, problem: PaperProblem | RigorousProblem, values: Iterable[Sequence[float]]
) -> dict[str, str]:
    each = list(values)
    # The paper's risk is no mean of its replicates: their spread is not that of its noise.
    mean = not (problem.method == "paper" and plan.objective.risk)
    if not mean or plan.noise == 0 or sum(map(len, each)) < FEWEST:
        return {}
    planned = plan.budget * plan.replicates
    spread = replicate_spread(each, noise_scale=plan.noise_per_rollout, delta=problem.delta, planned=planned)
    sd = None if spread is None else spread.values["sd"]
    if not isinstance(sd, float) or plan.noise_per_rollout < FAR * sd:
        return {}
    times = "while replicates do not differ at all" if sd == 0 else f"{_round(plan.noise_per_rollout / sd)} times that"
    observed = "" if sd == 0 else f" of replicates, {sd:.3g}"
    return {
        "noise_scale": f"{plan.key}: the noise scale per rollout is {plan.noise_per_rollout:.3g}, {times}{observed}: "
        "the bound pays for noise that the data do not show. Take more replicates, or assume a smaller noise_scale"
    }


def _round(times: float) -> str:
    return f"{times:.0f}" if math.isfinite(times) and times < 1e6 else f"{times:.1e}"


def _listed(units: Sequence[str]) -> str:
    names = [f'"{unit}"' if unit else "no unit" for unit in units]
    return f"{', '.join(names[:-1])} and {names[-1]}"


# Which starts of a box the claims are about


def scope(plans: Plans, *, listed_alone: bool = False) -> Iterator[str]:
    """Yield a line for the problems that choose among starts of a box; none for a list, which is its own box.

    With `listed_alone` there is none either where the claim is about the whole box.
    """
    # The problems of a campaign have one list or none: the file is checked for that.
    found = [plan for plan in plans.values() if plan.box and plan.candidates is not None]
    if not found:
        return
    names, listed = ", ".join(plan.name for plan in found), found[0].listed
    if listed is None:
        yield from [] if listed_alone else [f"{names}: the claim is about every start of the box"]
        return
    count = len(found[0].parameters)
    yield (
        f"{names}: the claim is about the worst of {listed:,} listed starts, spread over the ranges of {count} "
        f"parameter{'s' if count > 1 else ''}, and about no start between them; for the whole ranges method "
        "'kriging' bounds the worst start, and 'sample' how often drawn ones fail"
    )
