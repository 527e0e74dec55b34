"""The incremental collector of a campaign's report data.

It reads the run directory of a running, stopped or finished campaign and changes no file in it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import zip_longest
from pathlib import Path

from ....schemas.errors import JournalError, PerfboundError
from ....schemas.file.parts import parts_of
from ....schemas.ids import CLOSING, closing_check
from ....schemas.result.block_facts import BlockProposalFact
from ....schemas.result.certificate import Certificate, Predicate
from ....schemas.result.facts import ExtensionFact, Header, ProposalFact
from ....schemas.result.known import SoFar
from ...campaign.observation import of_requirement
from ...campaign.plan import plans
from ...certificate import files
from ...certificate.words.bound_text import parameter_units
from ...certificate.words.format import replay_command
from ...certificate.words.text import check_sentences
from ...run.continuation import command_with
from ...run.known import verdict_of
from ...run.page.page_feed import LiveState
from ...store import lock
from ...store.changes import ChangeReader, Changes, Session
from ...store.robustness import is_repeated
from ...store.so_far import read_so_far
from ..data.claims import VerdictCard, assumption_row
from ..data.page import Axis, DeclaredDisturbance, ReportData, State
from ..data.ranges import long_inputs, ranges
from ..data.rollouts import RankedTest, RolloutsOfTest
from ..rollout import of_tests
from . import wording
from .cards import live_card, provenance
from .complete import ProblemCompleter, ending_counterexample
from .problem import ProblemCollector
from .recorded_tests import ProposedTests
from .scenes import SceneCache, bounded_scenes
from .trust import TrustStatistics
from .violations import ViolationStatistics
from .wording import question_words, search_sentences
from .workers import WorkerStatistics

WORST_STARTS = 8
"""Starts of each problem whose rollouts are part of the data."""


class Collector:
    """Collects the report data of one campaign; each refresh adds the new facts. Not thread-safe."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.abandoned = False  # by its orchestrator, although its lock may be held for a moment more
        self._reset()

    def _reset(self) -> None:
        self._changes = ChangeReader(self.directory)
        self._header: Header | None = None
        self._certificate: Certificate | None = None
        self._problems: dict[str, ProblemCollector] = {}
        self._checked: dict[str, ProposedTests] = {}
        """The tests of each closing check."""
        self._start = partial(_start_of, self._problems, self._checked)
        self._workers, self._trust = WorkerStatistics(), TrustStatistics()
        self._violations = ViolationStatistics(self.directory)
        self._system: str | None = None
        self._code: str | None = None
        self._scenes = SceneCache(self.directory)
        self._complete = ProblemCompleter(self.directory)
        self._verdict: VerdictCard | None = None
        self._so_far: SoFar | None = None
        self._sessions: tuple[Session, ...] = ()
        self._closing: dict[str, int] = {}

    def refresh(self, live: Mapping[str, LiveState] | None = None, at: float | None = None) -> ReportData:
        """Add the new facts and return all data; `live` is the state of the workers, `at` the Unix time to show.

        Raises:
            PerfboundError: there is no campaign in the directory, or it cannot be read. The next refresh starts over.

        """
        try:
            return self._data(self._read(), live or {}, at)
        except BaseException:
            self._reset()  # facts that were added in part would be counted twice
            raise

    def rollouts_of_test(self, problem: str, test: int) -> RolloutsOfTest:
        """Return the rollouts of one test, as of the last refresh.

        Raises:
            PerfboundError: there is no such problem or test, or the campaign cannot be read.

        """
        if self._header is None:
            self.refresh()
        if problem in self._checked and self._start(problem, test) is not None:
            return self._rollouts(problem, test)
        if problem not in self._problems:
            known = ", ".join(self._problems)
            raise PerfboundError(f"{self.directory}: no problem {problem[:80]!r}; choose one of {known}")
        number = len(self._problems[problem].proposed)
        if not 0 <= test < number:
            raise PerfboundError(f"{self.directory}: {problem} has no test {test:,}; choose one of the {number:,}")
        return self._rollouts(problem, test)

    def _read(self) -> Header:
        # The certificate before the facts: it is written after the last of them, so they are complete with it.
        certificate = self._certificate or files.read(self.directory)
        # Also before the facts: it must not be about tests that the rest of the data has not.
        self._so_far = None if certificate else read_so_far(self.directory)
        changes = self._changes.read()
        if self._certificate and changes.extended:
            # That of before; the next refresh finds the one that follows.
            certificate = self._verdict = None
            self._complete.reopen()
        header = self._header = changes.header
        _check_same(self.directory, certificate, header)
        self._certificate = certificate
        if certificate is not None and self._verdict is None:
            found = verdict_of(self.directory, header, certificate)
            worst = found.violations.rollout
            repeated = found.by_rollouts == "certain" and worst is not None and is_repeated(self.directory, worst)
            self._verdict = wording.verdict_card(found, certificate.predicate, repeated=repeated)
        if not self._problems:
            self._problems.update(_collectors(header))
        self._sessions = changes.sessions
        last = changes.sessions[-1] if changes.sessions else None
        self._system = last.system if last else None
        self._code = ", ".join(filter(None, (last.system, last.revision))) if last and last.system else None
        self._add(changes)
        return header

    def _add(self, changes: Changes) -> None:
        try:
            for fact in changes.decisions:
                if isinstance(fact, ExtensionFact):
                    _extend_all(self._problems.values(), fact)
                elif closing_check(fact.problem) is None:
                    for collector in _collectors_of(self._problems.values(), fact.problem):
                        collector.add(fact)
                elif isinstance(fact, ProposalFact | BlockProposalFact):
                    self._checked.setdefault(fact.problem, ProposedTests()).add(fact)
            for problem, number in changes.rollouts.items():
                if (check := closing_check(problem)) is not None:
                    self._closing[check] = self._closing.get(check, 0) + number
                else:
                    for collector in _collectors_of(self._problems.values(), problem):
                        collector.rollouts += number
            self._complete.add(changes.decisions, changes.violations)
        except (KeyError, ValueError) as error:
            raise JournalError(
                f"{self.directory}: the facts contradict each other ({error}); restore the database from a copy"
            ) from None
        self._workers.add(changes)
        self._trust.add(changes)
        self._violations.add(changes.violations, changed=bool(changes.decisions or changes.rollouts))

    def _data(self, header: Header, live: Mapping[str, LiveState], at: float | None) -> ReportData:
        config, violations = header.config, self._violations
        predicate = self._certificate.predicate if self._certificate else None
        violations.refresh(header, self._start)
        command = partial(replay_command, self.directory, header, system=self._system)
        results = {each.key: each for each in predicate.problems} if predicate else {}
        complete, units = self._complete.data, parameter_units(header.spec)
        problems = tuple(complete(each, results.get(key), header, predicate) for key, each in self._problems.items())
        claims = wording.worded(predicate) if predicate else ()
        running = lock.is_held(self.directory) and not self.abandoned
        workers, more = self._workers.rows(live, self._trust.workers)
        # Terms without a claim of their own compose to the risk.
        of_risk = any(each.quantity in (None, "rho_star") for each in problems)
        return ReportData(
            name=config.name,
            seed=config.seed,
            run=header.run,
            state=_state_of(self._certificate, running=running),
            updated=at,
            system=header.spec.name,
            doc=header.spec.doc,
            code=self._code,
            specification=config.formula,
            where=config.where,
            horizon=config.horizon,
            risk_weight=config.risk_weight if of_risk else None,
            clip=config.clip,
            axes=_axes(header),
            disturbances=tuple(
                DeclaredDisturbance(each.name, each.unit, each.words)
                for each in (*header.spec.disturbances, *header.spec.reported)
            ),
            now=wording.current_bound(problems, claims),
            claims=claims,
            composition=predicate.composition if predicate else None,
            assumptions=tuple(assumption_row(each, units) for each in predicate.assumptions) if predicate else (),
            checks=_after_the_tests(predicate, header) if predicate else (),
            problems=problems,
            scenes=tuple(
                bounded_scenes(
                    self._rollouts(*test) for test in _shown_tests(violations.ranked, self._problems.values())
                )
            ),
            counterexamples=tuple(
                of_tests.described(fact, self._start(*fact.rollout[:2]) or (), command(str(fact.rollout)), drawn)
                for fact, drawn in zip(
                    violations.worst, of_tests.disturbances_of(header, violations.worst), strict=True
                )
            ),
            violations=violations.number,
            later_violations=violations.later,
            ranked=violations.ranked,
            violating=violations.violating,
            rollouts=sum(each.rollouts for each in problems if each.requirement is None),
            workers=workers,
            throughput=self._workers.throughput(),
            software=header.software,
            resume=command_with(self.directory, _options_of(self._sessions)),
            failed_attempts=self._workers.failed_attempts(),
            more_workers=more,
            counterexample=ending_counterexample(
                self._problems.values(),
                violations.worst,
                predicate,
                header,
                command,
            ),
            compared=self._trust.compared_rows(),
            compared_results=self._trust.compared,
            set_aside=self._trust.pause_rows(),
            verdict=self._verdict,
            required=question_words(header, (claims or problems)[0].quantity, (claims or problems)[0].starts),
            closing_rollouts={each: self._closing[each] for each in CLOSING if each in self._closing},
            live=None if self._certificate else live_card(self._so_far, header, running=running),
            provenance=provenance(header, self._sessions, self._workers.ended()),
        )

    def _rollouts(self, series: str, test: int) -> RolloutsOfTest:
        # A closing check has no columns of its own: those of the first problem.
        collector = self._problems.get(series) or next(iter(self._problems.values()))
        x, checks = self._start(series, test), closing_check(series) is not None
        assert self._header is not None, "read before"
        assert x is not None, "proposed before"
        final = self._certificate is not None if checks else test < len(collector.observed)
        also = self._violations.ranked_of(series, test)
        return self._scenes.of_test(
            self._header, (series, test), (collector.problem, x), final=final, system=self._system, also=also
        )


def _start_of(
    problems: Mapping[str, ProblemCollector], checked: Mapping[str, ProposedTests], series: str, test: int
) -> tuple[float, ...] | None:
    """Return the start of a test of a problem or closing check; None for one that is not known."""
    found = checked.get(series) if closing_check(series) else problems[series].proposed if series in problems else None
    return None if found is None else found.start(test)


def _options_of(sessions: Sequence[Session]) -> str | None:
    """Return the options of the last session that had workers."""
    return next((each.options for each in reversed(sessions) if each.options is not None), None)


def _state_of(certificate: Certificate | None, *, running: bool) -> State:
    if certificate is not None:
        return "finished"
    return "running" if running else "stopped"


def _shown_tests(ranked: Iterable[RankedTest], collectors: Iterable[ProblemCollector]) -> list[tuple[str, int]]:
    """Return the tests whose rollouts are part of the data, those that a report needs most first."""
    return list(dict.fromkeys([*((each.problem, each.test) for each in ranked), *_worst_tests(collectors)]))


def _worst_tests(collectors: Iterable[ProblemCollector]) -> list[tuple[str, int]]:
    """Return the worst tests of every problem and requirement: the worst of each, then the second of each."""
    tests = ([(each.problem.name, test) for test in each.worst_tests(WORST_STARTS)] for each in collectors)
    return [test for place in zip_longest(*tests) for test in place if test is not None]


def _collectors_of(collectors: Iterable[ProblemCollector], problem: str) -> list[ProblemCollector]:
    """Return the collector of a problem, and those of its requirements."""
    found = [each for each in collectors if each.problem.name == problem]
    if not found:
        raise KeyError(problem)
    return found


def _extend_all(collectors: Iterable[ProblemCollector], fact: ExtensionFact) -> None:
    for each in collectors:
        each.extend(fact)


def _check_same(directory: Path, certificate: Certificate | None, header: Header) -> None:
    if certificate and certificate.predicate.campaign.config_sha256 != header.config_sha256:
        raise JournalError(
            f"{directory}: the certificate is that of another campaign than the database; restore one of them"
        )


def _collectors(header: Header) -> Iterator[tuple[str, ProblemCollector]]:
    """Yield the collector of each problem, followed by those of its requirements, with the keys of their plans."""
    for plan in plans(header.config, header.spec).values():
        yield plan.key, ProblemCollector(header, plan, header.config)
        for place, (part, config) in enumerate(zip(plan.parts, parts_of(header.config), strict=True)):
            yield part.key, ProblemCollector(header, part, config, partial(of_requirement, plan, place))


def _after_the_tests(predicate: Predicate, header: Header) -> tuple[str, ...]:
    """Return what followed the tests, in a sentence each; what a search found is beside its counterexample, if any."""
    searched = search_sentences(predicate, header) if predicate.counterexample is None else ()
    return (*searched, *check_sentences(predicate, parameter_units(header.spec)))


def _axes(header: Header) -> tuple[Axis, ...]:
    ends = ranges(header)
    long = long_inputs(header)
    return tuple(
        Axis(each.name, each.unit, *ends[each.name], long.get(each.name, "")) for each in header.spec.parameters
    )
