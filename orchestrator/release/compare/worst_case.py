"""The worst cases of two systems against each other, by a bound of either from both sides.

| symbol | meaning                                                          | unit |
|--------|------------------------------------------------------------------|------|
| L, U   | bounds of the worst case of a system, both true with 1 - delta/2 | v    |
| delta  | failure probability of the comparison                            | -    |

The worst case is the least robustness over all starts, of noisy rollouts the least mean.
With 1 - delta the worst case of B less that of A is in [L_B - U_A, U_B - L_A].
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from ....schemas.errors import CampaignError, PerfboundError
from ....schemas.file.problem_models import RigorousProblem, ScenarioProblem
from ....schemas.result.certificate import Certificate
from ....schemas.result.comparison import Comparison
from ...certificate.counter_evidence import other_side
from ...certificate.words.text import claim_words
from ...mathematics.bounds.rounding import round_down, round_up
from ...run.options import RunOptions
from ...store.export_tables import robustness_unit
from .conduct import Terms, check_equal, comparison, ended, in_folder, run_to_end, write
from .differences import Interval, judged
from .systems import Compared


def bounded(systems: Sequence[Compared], seed: int | None, delta: float) -> list[Compared]:
    """Return both systems with their own campaigns, each at half of delta.

    Raises:
        CampaignError: one does not bound its worst start from both sides.

    """
    found = []
    for system in systems:
        config, (problem, *others) = system.config, system.config.problems
        two_sided = isinstance(problem, RigorousProblem | ScenarioProblem) and problem.name == "robustness"
        if others or not two_sided or config.specifications or config.may_end_early:
            raise CampaignError(
                f"{system.given}: a worst case is compared by one problem `robustness` of method 'rigorous' or "
                "'scenario' with one specification, and without a search, whose bounds are from both sides; give such "
                "a campaign file, or leave out --worst-case"
            )
        halved = (problem.model_copy(update={"delta": delta / 2}),)
        update = {"problems": halved, "seed": config.seed if seed is None else seed}
        found.append(replace(system, config=config.model_copy(update=update)))
    listed = [each.config.starts_of(each.config.problems[0]) for each in found]
    if listed[0] != listed[1]:
        words = " and ".join("every start" if each is None else f"{each} starts" for each in listed)
        raise CampaignError(
            f"{systems[0].given} and {systems[1].given}: are about {words} of the box; give both the same `candidates`"
        )
    return found


def compare_worst(
    systems: Sequence[Compared], out: Path, terms: Terms, options: RunOptions, console: Console
) -> Comparison:
    """Bound the worst case of both systems, and write what follows; the same call continues.

    Raises:
        PerfboundError: another comparison is in `out`, a campaign cannot be run, or its constants are refuted.
        Stopped: a signal arrived.

    """
    check_equal(terms.equal, ("worst_case",))
    both = in_folder(systems, out)
    certificates = []
    for directory, system in both.items():
        run_to_end(directory, system, options, console)
        certificates.append(ended(directory, system))
    about = [each.predicate.claims[0] for each in certificates]
    if len({(each.quantity, each.starts) for each in about}) > 1:
        words = " and ".join(map(claim_words, about))
        raise PerfboundError(f"{out}: the bounds are about {words}; give both campaigns the same candidates and noise")
    (low_a, high_a), (low_b, high_b) = map(_ends, both, certificates)
    interval = Interval(
        (low_a + high_a) / 2, (low_b + high_b) / 2, round_down(low_b - high_a), round_up(high_b - low_a)
    )
    header = systems[0].header
    unit = robustness_unit(header.config, header.spec)
    found = comparison(both, [judged("worst_case", interval, terms.equal.get("worst_case"), unit)], terms)
    write(out, found)
    return found


def _ends(directory: Path, certificate: Certificate) -> tuple[float, float]:
    """Return the bounds of a worst case from below and from above."""
    upper = other_side(certificate.predicate)
    if upper is None:
        raise PerfboundError(
            f"{directory}: the certificate has no bound from the other side, so that nothing can be compared"
        )
    return certificate.predicate.claims[0].bound, upper
