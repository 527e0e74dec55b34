"""The counterexample that ended a campaign, from the moment of its test on, and not only with the certificate."""

from collections.abc import Callable, Iterable, Sequence

from ...schemas.result.certificate import Counterexample
from ...schemas.result.facts import Header, RolloutFact
from . import wording
from .problem import ProblemCollector
from .rollout_data import FoundCounterexample


def ending_counterexample(
    problems: Iterable[ProblemCollector],
    violations: Sequence[RolloutFact],
    certified: Counterexample | None,
    header: Header,
    command: Callable[[str], str],
) -> FoundCounterexample | None:
    """Return the rollout that ended a campaign; None if none did.

    `violations` have the least robustness first, `certified` is that of the certificate, and `command` returns the
    command that simulates a rollout again.
    """
    for each in problems:
        last = each.ended_by_counterexample
        name = (each.problem.name, None if last is None else last.test)
        worst = next((fact for fact in violations if fact.rollout[:2] == name), None)
        if worst is not None:
            sentence = wording.counterexample_sentence(certified or _of_facts(each, worst), header)
            return FoundCounterexample(worst.rollout.problem, worst.rollout.test, sentence, command(str(worst.rollout)))
    return None


def _of_facts(problem: ProblemCollector, worst: RolloutFact) -> Counterexample:
    plan, start = problem.plan, problem.starts[worst.rollout.test]
    return Counterexample(
        rollout=str(worst.rollout),
        test=worst.rollout.test,
        rollouts=len(plan.rollouts),
        start=dict(zip(plan.parameters, start, strict=True)),
        seed=worst.seed,
        robustness=worst.robustness or 0.0,
    )
