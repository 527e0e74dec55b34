"""The processes of `check-system`: their limit, what a hang leaves to the others, and what a stop says."""

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from perfbound.orchestrator.prepare.check_system import check as system_check
from perfbound.orchestrator.prepare.check_system.check import SystemCheck, checked_system
from perfbound.schemas.errors import Stopped
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.system_check import ChildRun, Measured, Trial
from tests.unit.prepare.check_system.test_judge import SPEC, sound

CAMPAIGN = """name = "carts"
seed = 1
horizon = 10.0
specification = "always (y >= 0)"
max_tests = 3
alpha = 1.0
rkhs_norm = 1.0
noise_scale = 1.0
clip = [-1.0, 1.0]
kernel = { length_scale = 1.0 }
[system]
name = "cart"
[space]
x = { low = 0.0, high = 1.0, unit = "m" }
v = { low = 0.0, high = 1.0, unit = "m/s" }
"""

Ends = Callable[[int, int, Trial], bool]
"""Whether the process ends in a rollout: a function of the process, the place in it and the trial."""


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[SystemCheck, list[float]]]:
    """Check a sound system whose processes end where `ends` says; also return the limit of each process."""

    def checked(ends: Ends, text: str = CAMPAIGN, limit: float | None = None) -> tuple[SystemCheck, list[float]]:
        limits: list[float] = []

        def measured(
            works: Sequence[Sequence[Trial]], _: Any, *, limit: float, done: Callable[[int], None]
        ) -> tuple[ChildRun, ...]:
            limits.append(limit)
            return tuple(ran(number, trials, done) for number, trials in enumerate(works))

        def ran(number: int, trials: Sequence[Trial], done: Callable[[int], None]) -> ChildRun:
            lost = next((k for k, each in enumerate(trials) if ends(len(limits) - 1, k, each)), len(trials))
            done(number)
            found = tuple(sound(each) for each in trials[:lost])
            ended = "gave no answer" if lost < len(trials) else ""
            return ChildRun(trials=tuple(trials), loaded=Measured(), measured=found, ended=ended, hung=bool(ended))

        monkeypatch.setattr(system_check, "measure_in_children", measured)
        monkeypatch.setattr(system_check, "simulated_spec", lambda *_: SPEC)
        monkeypatch.setattr(system_check, "system_options", lambda _: [])
        monkeypatch.setattr(system_check, "named_campaign", lambda _: parse_campaign(text.encode(), "c.toml"))
        found = checked_system(
            "c.toml", variant=None, horizon=None, options=(), seed=0, limit=limit, report=lambda *_: None
        )
        return found, limits

    return checked


Check = Callable[..., tuple[SystemCheck, list[float]]]


def others(found: SystemCheck) -> set[str]:
    return {each.check for each in found.findings if each.status != "passed"}


def test_the_limit_is_that_of_the_option_of_the_file_or_the_default(check: Check) -> None:
    never: Ends = lambda *_: False  # noqa: E731
    assert check(never)[1] == [60.0] * 4
    assert check(never, f"deadline = 300.0\n{CAMPAIGN}")[1] == [300.0] * 4
    assert check(never, f"deadline = 300.0\n{CAMPAIGN}", limit=7.0)[1] == [7.0] * 4


def test_the_horizon_of_the_file_is_compared_with_half_of_it(check: Check) -> None:
    (horizon,) = [each for each in check(lambda *_: False)[0].findings if each.check == "horizon"]
    assert horizon.detail == "trajectories of 10 s and of half of it agree in the part that they share"


def test_a_first_start_that_hangs_leaves_the_other_checks(check: Check) -> None:
    first: list[tuple[float, ...]] = []

    def ends(process: int, place: int, trial: Trial) -> bool:
        first.append(trial.request.x)
        return trial.request.x == first[0]

    assert others(check(ends)[0]) == {"ends"}


def test_a_later_start_that_hangs_leaves_those_behind_it(check: Check) -> None:
    found, limits = check(lambda process, place, trial: trial.request.rollout == "random.0.nominal.0")
    assert len(limits) == 3
    assert others(found) == {"ends", "together"}, "both processes come to two seeds at every start"


def test_a_system_that_always_hangs_is_tried_at_two_starts(check: Check) -> None:
    found, limits = check(lambda *_: True)
    assert len(limits) == 2
    assert {each.status for each in found.findings if each.check != "ends"} == {"skipped"}


def test_a_stop_says_what_was_ended(check: Check) -> None:
    def stops(*_: Any) -> bool:
        raise Stopped(2)

    with pytest.raises(Stopped) as stopped:
        check(stops)
    assert stopped.value.state.startswith("the check was ended after 0 of ")
    assert stopped.value.state.endswith(" rollouts (start), nothing was written")
