"""The story of a run directory, told again and again: a look reads what was added since the last one.

It works beside a running campaign, of a stopped one and of a finished one, and changes no file.
"""

from collections.abc import Mapping
from pathlib import Path

from ...schemas.campaign import Scenarios
from ...schemas.certificate import ProblemResult
from ...schemas.errors import PerfboundError
from ...schemas.facts import Header
from ..run.format import resume_command
from ..store import lock
from ..store.changes import rollouts_of
from . import rollouts, wording
from .data import Axis, ReportData, RolloutsOfTest, State
from .known import Known
from .problem import ProblemCollector
from .workers import LiveState

SCENES = 8
"""Of each problem, one a start."""
MOST_KEPT = 200
"""Scenes that are not made again."""


class Collector:
    """Somebody who tells the story of a campaign; one thread at a time may ask."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._known: Known | None = None
        self._scenes: dict[tuple[str, int], RolloutsOfTest] = {}

    def look(self, live: Mapping[str, LiveState] | None = None, at: float | None = None) -> ReportData:
        """Return the story now; `live` is what an orchestrator knows of its workers, `at` the Unix time to be shown.

        Raises:
            PerfboundError: there is no campaign in the directory, or it cannot be read. The next look starts over.

        """
        try:
            if self._known is None:
                self._known = Known(self.directory)
            else:
                self._known.look()
            return self._story(self._known, live or {}, at)
        except BaseException:
            self._known = None
            self._scenes.clear()
            raise

    def scene(self, problem: str, test: int) -> RolloutsOfTest:
        """Return the rollouts of one test that somebody asks for, as far as the last look knows of it.

        Raises:
            PerfboundError: there is no such problem or test, or the campaign cannot be read.

        """
        if self._known is None:
            self._known = Known(self.directory)
        told = self._known.told.get(problem)
        if told is None:
            known = ", ".join(self._known.told)
            raise PerfboundError(f"{self.directory}: no problem {problem[:80]!r}; allowed are {known}")
        if not 0 <= test < len(told.starts):
            raise PerfboundError(f"{self.directory}: {problem} has no test {test}; there are {len(told.starts)}")
        return self._scene(self._known.header, told, test)

    def _story(self, known: Known, live: Mapping[str, LiveState], at: float | None) -> ReportData:
        config, spec, certificate = known.header.config, known.header.spec, known.certificate
        results: dict[str, ProblemResult] = {}
        if certificate:
            results |= {each.name: each for each in certificate.predicate.problems}
        problems = tuple(told.told(results.get(name)) for name, told in known.told.items())
        claims = wording.claims(certificate)
        return ReportData(
            name=config.name,
            seed=config.seed,
            run=known.header.run,
            state=self._state(known),
            updated=at,
            system=spec.name,
            doc=spec.doc,
            specification=config.specification,
            horizon=config.horizon,
            risk_weight=config.risk_weight,
            clip=config.clip,
            axes=_axes(known.header),
            now=wording.now(problems, claims),
            claims=claims,
            composition=wording.composition(certificate),
            assumptions=wording.assumptions(certificate),
            problems=problems,
            scenes=tuple(
                self._scene(known.header, told, test) for told in known.told.values() for test in told.worst(SCENES)
            ),
            counterexamples=known.counterexamples,
            violations=known.violations,
            rollouts=sum(told.rollouts for told in known.told.values()),
            workers=known.crew.workers(live),
            throughput=known.crew.throughput(),
            software=known.header.software,
            resume=resume_command(self.directory),
        )

    def _state(self, known: Known) -> State:
        if known.certificate is not None:
            return "finished"
        return "running" if lock.is_held(self.directory) else "stopped"

    def _scene(self, header: Header, told: ProblemCollector, test: int) -> RolloutsOfTest:
        """Return the scene of a test; what is whole is kept, for it never changes."""
        key = (told.problem.name, test)
        if key in self._scenes:
            return self._scenes[key]
        facts = rollouts_of(self.directory, *key)
        if not facts:
            raise PerfboundError(f"{self.directory}: test {test} of {key[0]} has no rollout yet; ask again later")
        found = rollouts.scene(self.directory, header, told.problem, facts, told.starts[test])
        if found.error is None and test < len(told.observed):
            self._scenes[key] = found
            if len(self._scenes) > MOST_KEPT:
                del self._scenes[next(iter(self._scenes))]
        return found


def _axes(header: Header) -> tuple[Axis, ...]:
    """Return the parameters with the ranges of D, in the order of the system."""
    space, parameters = header.config.space, header.spec.parameters
    if isinstance(space, Scenarios):
        ranges = [(min(values), max(values)) for values in zip(*space.scenarios, strict=True)]
    else:
        ranges = [(space[each.name].low, space[each.name].high) for each in parameters]
    return tuple(Axis(each.name, each.unit, *ends) for each, ends in zip(parameters, ranges, strict=True))
