"""The assumptions behind tests of a rig: their starts, and the logs of those made before the campaign."""

from collections.abc import Iterable, Iterator

import numpy as np

from ....schemas.draws.laws import ReportedLaws
from ....schemas.file.distributed import DISTRIBUTIONS
from ....schemas.file.disturbance import Disturbance
from ....schemas.file.logs import LogMapping
from ....schemas.file.parameters import Range, parameter_ranges
from ....schemas.file.problem_models import RigorousProblem
from ....schemas.result.certificate import Assumption
from ....schemas.result.facts import Header
from ...campaign.plan import ProblemPlan
from ...mathematics.bounds.checks.law import LawTest
from .sentences import assumption

MOST_STEPS = 1000
"""Steps of a range that are compared one by one."""


def of_rig(found: Iterable[Assumption], plan: ProblemPlan, header: Header) -> Iterator[Assumption]:
    """Yield the assumptions of a problem with those on starts that a rig drove.

    Where its tests are logs, those on drawn starts are on these.
    """
    yield from _of_logs(found, plan.name, header)
    if (tolerance := header.config.system.tolerance) is not None:
        units = {each.name: each.unit for each in header.spec.parameters}
        words = ", ".join(f"{name} within {value:g} {units[name]}".rstrip() for name, value in tolerance.items())
        counted = isinstance(plan.problem, RigorousProblem)
        form = "driven_and_counted" if counted else None
        yield assumption(
            f"driven_starts/{plan.key}", "derived" if counted else "assumed", {"tolerance": words}, form=form
        )


def _of_logs(found: Iterable[Assumption], name: str, header: Header) -> Iterator[Assumption]:
    tests = header.config.recorded
    for each in found:
        if not tests or each.id != f"drawn_starts/{name}":
            yield each
            continue
        yield assumption(each.id, "assumed", {"samples": len(tests)}, form="starts_of_logs")
        yield _law_of_starts(name, header)
        yield _columns(name, header.config.system.logs or LogMapping())


def _law_of_starts(name: str, header: Header) -> Assumption:
    """Return the assumption that the starts of logs have the law of `[space]`, tested one parameter at a time."""
    laws = _laws(header)
    if not laws:
        return assumption(f"law_of_starts/{name}", "assumed")
    values = np.array([[test.start[law.name] for law in laws] for test in header.config.recorded])
    known, test = ReportedLaws(laws), LawTest(len(laws))
    # Independent of the starts: any fixed sequence is.
    test.observe(known.shares(values, np.random.default_rng(0).random(values.shape)))
    finding = test.finding()
    law = laws[int(finding.values["kind"])]
    return assumption(f"law_of_starts/{name}", finding.status, {**finding.values, "kind": law.name, "law": law.words})


def _laws(header: Header) -> list[Disturbance]:
    """Return the laws of the parameters that have one of their own."""
    space = header.config.space
    # Of a region or a table the parameters depend on one another.
    if not isinstance(space, dict) or header.config.where is not None:
        return []
    laws = (_law(name, box) for name, box in parameter_ranges(space).items())
    return [law for law in laws if law is not None]


def _law(name: str, box: Range) -> Disturbance | None:
    if box.choices is not None:
        return Disturbance(name=name, unit=box.unit, choices=box.choices) if len(set(box.choices)) > 1 else None
    if box.step is not None:
        if box.distribution != "uniform" or not 0 < box.steps < MOST_STEPS:
            return None
        values = tuple(box.low + k * box.step for k in range(box.steps + 1))
        return Disturbance(name=name, unit=box.unit, choices=values)
    if not box.low < box.high:
        return None
    keys = {key: getattr(box, key) for key in DISTRIBUTIONS[box.distribution]}
    return Disturbance(name=name, unit=box.unit, low=box.low, high=box.high, distribution=box.distribution, **keys)


def _columns(name: str, mapping: LogMapping) -> Assumption:
    """Return the assumption that the mapping makes of logs what the columns mean."""
    if mapping.resample is None:
        return assumption(f"columns_of_logs/{name}", "assumed")
    words = {"linear": "linear between two samples of a log", "previous": "that of the sample before"}
    values: dict[str, int | float | str] = {"resample": mapping.resample, "between": words[mapping.between]}
    return assumption(f"columns_of_logs/{name}", "assumed", values, form="resampled_logs")
