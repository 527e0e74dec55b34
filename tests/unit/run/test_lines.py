"""Lines about messages of peers: some are shown, the others are counted."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.fleet.dispatch import events
from perfbound.orchestrator.run.lines import ALL, EACH, PERIOD, Throttle, poison_text
from perfbound.schemas.failure import Failure
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import Attempt, RolloutId
from perfbound.schemas.rollout import RolloutRequest
from tests.campaigns import config


def test_ten_lines_of_a_kind_from_a_worker_are_shown_in_a_minute() -> None:
    throttle = Throttle()
    shown = [throttle.admits(second, "ignored messages", "w") for second in range(50)]
    assert shown == [True] * EACH + [False] * 40
    assert throttle.admits(50, "ignored messages", "v"), "another worker"
    assert throttle.admits(50, "failed attempts", "w"), "another kind"
    assert throttle.summaries(PERIOD - 1) == []
    assert throttle.summaries(PERIOD) == ["40 more ignored messages in 60 s, not shown"]
    assert throttle.admits(PERIOD, "ignored messages", "w"), "the next minute"
    assert throttle.summaries(PERIOD) == [], "said once"


def test_names_without_end_fill_neither_the_terminal_nor_the_memory() -> None:
    throttle = Throttle()
    shown = sum(throttle.admits(0.0, "refused workers", f"w{number}") for number in range(100_000))
    assert shown == ALL
    assert throttle.summaries(PERIOD) == [f"{100_000 - ALL} more refused workers in 60 s, not shown"]
    assert sum(len(period.shown) for period in throttle._periods.values()) == 0
    for number in range(100_000):
        throttle.admits(0.0, "refused workers", f"w{number}")
    assert sum(len(period.shown) for period in throttle._periods.values()) == ALL


# The last line of a campaign that a rollout ends: its history, and a command that repeats it as it is.

ROLLOUT = RolloutId("robustness", 3, "nominal", 0)
REQUEST = SimpleNamespace(x=(0.5, -1.0), variant="nominal", seed=7, horizon=8.0, system="cars", disturbances=())


def ledger(**changes: Any) -> Ledger:
    found: CampaignConfig = config("test-function").model_copy(update=changes)
    header = SimpleNamespace(spec=SimpleNamespace(repeated="anywhere", disturbances=(), as_parameters=()))
    return cast(Ledger, SimpleNamespace(config=found, header=header))


def text(reference: str | None, ends: dict[str, str] | None = None, **changes: Any) -> str:
    failed = tuple(
        events.Fail(f"local-{number}", Attempt(ROLLOUT, number), Failure("infrastructure", "worker lost for 5 s"))
        for number in (1, 2)
    )
    request = cast(RolloutRequest, REQUEST)
    return poison_text(events.Poison(ROLLOUT, failed), request, ledger(**changes), reference, ends or {})


def command(found: str) -> str:
    return found.split("Repeat it: ")[1].split(". If", maxsplit=1)[0]


def test_the_command_names_the_system_as_it_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(text(None)).startswith("perfbound simulate test-function --x=0.5,-1.0 --variant nominal --seed 7 ")
    assert command(text(f"{tmp_path}/own/cars.toml")).startswith("perfbound simulate own/cars.toml --x=")
    assert command(text("/elsewhere/cars.py:cars")).startswith("perfbound simulate /elsewhere/cars.py:cars --x=")


def test_the_command_has_the_disturbances_that_its_seed_does_not_give() -> None:
    spec = SimpleNamespace(
        repeated="anywhere",
        disturbances=(SimpleNamespace(name="gust"), SimpleNamespace(name="mass")),
        as_parameters=("gust",),
    )
    request = SimpleNamespace(**{**vars(REQUEST), "disturbances": (5.5, 1.0)})
    found = cast(Any, ledger())
    found.header.spec = spec
    attempt = events.Fail("local-1", Attempt(ROLLOUT, 1), Failure("system", "x"))
    line = poison_text(events.Poison(ROLLOUT, (attempt,)), cast(RolloutRequest, request), found, None, {})
    assert " --seed 7 --disturbance=gust=5.5 --horizon 8 " in command(line)


def test_the_repeat_of_a_rollout_that_hangs_ends_like_its_attempts() -> None:
    assert "--timeout" not in command(text(None))
    assert "--horizon 8 --timeout 20 " in command(text(None, deadline=20.0))


def test_the_exit_code_of_a_worker_is_in_the_line() -> None:
    found = text(None, {"local-1": "exit code 3"})
    assert "worker lost for 5 s (attempt 1 on local-1 (exit code 3), attempt 2 on local-2)" in found
