"""A fleet of workers with a behaviour each, against the dispatch machine, on a simulated clock; no message is lost."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from perfbound.orchestrator.fleet.dispatch import machine
from perfbound.orchestrator.fleet.dispatch.events import (
    Action,
    Delivered,
    Event,
    Fail,
    HandOut,
    Outvoted,
    Poison,
    Record,
    Reported,
    Revoke,
    RouterChanged,
    SetAside,
    Start,
    TakeBack,
    Tick,
    Wanted,
    WorkerDown,
    WorkerUp,
)
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.state import DispatchState
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, RolloutId, WorkId, first_of
from tests.fakes.invariants import check_invariants

Behaviour = Literal["good", "slow", "broken", "raises", "silent", "endless", "dies", "absent", "lies"]
"""`silent` never answers, and does not listen either; `endless` makes progress without end; `dies` comes back."""
STEP = 0.25
SECONDS: Mapping[str, float] = {"good": 2.0, "slow": 20.0, "broken": 0.0, "raises": 0.0, "dies": 0.5, "lies": 1.0}
"""Duration of an attempt."""
COMES_BACK = 5.0
GRACE = 30.0
"""Seconds for workers to return after a router has come or gone."""
FAILURES: Mapping[str, Failure] = {
    "broken": Failure("infrastructure", "no simulator"),
    "raises": Failure("system", "no licence"),
}


@dataclass
class Member:
    """A worker; its behaviour may be changed in mid-run."""

    host: str
    behaviour: Behaviour
    running: Attempt | None = None
    since: float = 0.0
    dead_since: float | None = None
    away_until: float = 0.0
    """Until then it is out of reach, and continues."""


@dataclass
class Fleet:
    """Workers by name; `run` plays until all rollouts are recorded, one is poisoned, or the time is up."""

    members: dict[str, Member]
    rollouts: int
    limits: Limits = field(default_factory=Limits)
    bad_rollout: Mapping[int, Behaviour] = field(default_factory=dict)
    """Rollouts, by test, that make every worker behave so."""
    now: float = 0.0
    recorded: dict[WorkId, str] = field(default_factory=dict)
    second_opinion: tuple[int, ...] | None = None
    """Rollouts, by test, that are compared; None without comparisons."""
    outvoted: list[str] = field(default_factory=list)
    true: dict[WorkId, bool] = field(default_factory=dict)
    """Of each recorded rollout, whether it is."""
    poison: Poison | None = None
    pauses: list[tuple[float, SetAside | TakeBack]] = field(default_factory=list)
    starts: list[tuple[float, Start]] = field(default_factory=list)
    fails: list[Fail] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state = DispatchState(self.limits, second_opinion=self.second_opinion is not None)
        wanted = tuple((RolloutId("p", test, "true", 0), 0) for test in range(self.rollouts))
        compared = frozenset(RolloutId("p", test, "true", 0) for test in self.second_opinion or ())
        self._take(Wanted(0.0, wanted, compared=compared))
        self._present: set[str] = set()

    @property
    def done(self) -> bool:
        """Whether nothing is left to do."""
        return self.poison is not None or len(self.recorded) == self.rollouts

    @property
    def set_aside(self) -> list[str]:
        """Names of the workers and hosts that were set aside, each time."""
        return [pause.place.name for _, pause in self.pauses if isinstance(pause, SetAside)]

    def run(self, seconds: float) -> None:
        """Play for so long."""
        end = self.now + seconds
        while not self.done and self.now < end:
            for name, member in self.members.items():
                self._live(name, member)
            self._take(Tick(self.now))
            self._take(HandOut(self.now))
            self.now += STEP

    def cut(self, seconds: float, lags: Mapping[str, float]) -> None:
        """End the router for so long; workers return so many seconds after it."""
        self._take(RouterChanged(self.now, GRACE))
        for name, lag in lags.items():
            self.members[name].away_until = self.now + seconds + lag
        self.run(seconds)
        self._take(RouterChanged(self.now, GRACE))

    def _live(self, name: str, member: Member) -> None:
        if self.now < member.away_until:
            if name in self._present:
                self._present.remove(name)
                self._take(WorkerDown(self.now, name))
            return
        if member.dead_since is not None and self.now - member.dead_since >= COMES_BACK:
            member.dead_since = None
        if member.behaviour == "absent" or member.dead_since is not None:
            if name in self._present:
                self._present.remove(name)
                self._take(WorkerDown(self.now, name))
            return
        if name not in self._present:
            self._present.add(name)
            if not member.away_until:
                member.running = None
            member.away_until = 0.0
            self._take(WorkerUp(self.now, name, member.host))
        if member.running is not None:
            self._work(name, member, member.running)
        if member.dead_since is None:
            progress = 0 if member.behaviour == "silent" else round((self.now - member.since) / STEP)
            self._take(Reported(self.now, name, member.running, progress))

    def _work(self, name: str, member: Member, attempt: Attempt) -> None:
        behaviour = self.bad_rollout.get(first_of(attempt.rollout).test, member.behaviour)
        if behaviour in ("silent", "endless") or self.now - member.since < SECONDS[behaviour]:
            return
        member.running = None
        if behaviour == "dies":
            member.dead_since = self.now
            self._present.discard(name)
            self._take(WorkerDown(self.now, name))
        else:
            digest = f"false, by {name}" if behaviour == "lies" else "true"
            self._digest = digest
            self._take(Delivered(self.now, name, attempt, FAILURES.get(behaviour), digest))

    def _take(self, event: Event) -> None:
        self.state, actions = machine.advance(self.state, event)
        check_invariants(self.state)
        for action in actions:
            self._act(action)

    def _act(self, action: Action) -> None:
        match action:
            case Start(worker, attempt):
                self.starts.append((self.now, action))
                self.members[worker].running, self.members[worker].since = attempt, self.now
            case Revoke(worker, attempt) if self.members[worker].behaviour != "silent":
                self.members[worker].running = None
            case Record(worker, attempt):
                assert attempt.rollout not in self.recorded, "recorded once"
                self.recorded[attempt.rollout] = worker
                self.true[attempt.rollout] = self._digest == "true"
            case Poison():
                self.poison = action
            case SetAside() | TakeBack():
                self.pauses.append((self.now, action))
            case Fail():
                self.fails.append(action)
            case Outvoted(worker):
                self.outvoted.append(worker)
