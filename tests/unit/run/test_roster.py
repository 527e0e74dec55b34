"""Names of workers come and go for weeks: those that are kept are bounded."""

import pytest

from perfbound.orchestrator.fleet.dispatch import events
from perfbound.orchestrator.fleet.link.transport import Heartbeat, Token
from perfbound.orchestrator.run import roster as module
from perfbound.orchestrator.run.roster import Roster
from perfbound.schemas import __version__
from perfbound.schemas.link.messages import HEARTBEAT, MOST, PROTOCOL, WorkerState
from perfbound.schemas.platforms import ANY
from perfbound.workers.systems import load_system

SPEC = load_system("test-function").spec


def state_of(worker: str) -> WorkerState:
    systems = {SPEC.name: SPEC.digest}
    return WorkerState(
        protocol=PROTOCOL, version=__version__, worker=worker, host="h", pid=1, systems=systems, state="idle"
    )


def appear(roster: Roster, worker: str, at: float = 0.0) -> list[events.Event]:
    """Show the token and the first heartbeat of a worker."""
    found = [*roster.token(Token(at, worker, alive=True))]
    heartbeat = Heartbeat(at, worker, state_of(worker))
    assert roster.refusal(heartbeat) is None
    return [*found, *roster.heartbeat(heartbeat)]


def test_dead_workers_are_forgotten_the_oldest_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DEAD_KEPT", 3)
    roster = Roster(SPEC, ANY)
    appear(roster, "alive")
    for number in range(100):
        assert appear(roster, f"w{number}")
        assert roster.token(Token(1.0, f"w{number}", alive=False)) != ()
    assert set(roster.records) == {"alive", "w97", "w98", "w99"}
    assert [type(event).__name__ for event in roster.token(Token(2.0, "w98", alive=True))] == ["WorkerUp"]
    assert roster.token(Token(2.0, "w0", alive=True)) == (), "it reports first"
    assert roster.admitted("w0") is None
    assert [type(event).__name__ for event in appear(roster, "w0")][-1] == "Reported"
    assert set(roster.records) == {"alive", "w0", "w97", "w98", "w99"}


@pytest.mark.parametrize("local", [False, True])
def test_a_local_worker_that_ends_does_not_come_back(local: bool) -> None:
    roster = Roster(SPEC, ANY)
    appear(roster, "w")
    down = roster.token(Token(1.0, "w", alive=False), local=local)
    assert down == (events.WorkerDown(1.0, "w", replaced=local),)


@pytest.mark.parametrize(
    ("here", "there", "what"),
    [
        ({"code": {"cars.py": "0" * 64}}, {"code": {"cars.py": "1" * 64}}, "another or no cars.py"),
        ({}, {"code": {"cars.py": "0" * 64, "b.py": "1" * 64}}, "1 files or packages more"),
        (
            {"versions": dict.fromkeys("abcde", "1.0")},
            {"versions": {"a": "2.0"}},
            "another or no a 1.0, b 1.0, c 1.0 and 2 more",
        ),
        ({"max_horizon": 2.0}, {}, "other parameters, columns or options"),
    ],
)
def test_a_refusal_says_in_one_short_sentence_what_differs(
    here: dict[str, object], there: dict[str, object], what: str
) -> None:
    base = SPEC.model_copy(update={"code": {"cars.py": "0" * 64}, "versions": {"a": "1.0"}})
    ours, theirs = base.model_copy(update=here), base.model_copy(update=there)
    roster = Roster(ours, ANY)
    roster.token(Token(0.0, "w", alive=True))
    state = state_of("w").model_copy(
        update={"systems": {SPEC.name: theirs.digest}, "parts": {SPEC.name: tuple(theirs.parts)}}
    )
    reason = roster.refusal(Heartbeat(0.0, "w", state))
    assert reason == f"the worker's 'test-function' has {what} than the campaign's; use the same on both"


def test_tokens_without_heartbeats_leave_nothing() -> None:
    roster = Roster(SPEC, ANY)
    for number in range(1000):
        roster.token(Token(0.0, f"w{number}", alive=True))
        roster.token(Token(0.0, f"w{number}", alive=True))
        roster.token(Token(0.0, f"w{number}", alive=False))
        roster.token(Token(0.0, f"w{number}", alive=False))
    assert (roster.records, roster._dead, roster._living) == ({}, {}, 0)


def test_living_workers_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIVING", 5)
    roster = Roster(SPEC, ANY)
    for number in range(100):
        roster.token(Token(0.0, f"w{number}", alive=True))
    assert len(roster.records) == 5
    assert roster.is_one_too_many(Token(0.0, "w99", alive=True))
    assert not roster.is_one_too_many(Token(0.0, "w99", alive=False))
    assert not roster.is_one_too_many(Token(0.0, "w4", alive=True))
    roster.token(Token(0.0, "w0", alive=False))
    assert not roster.is_one_too_many(Token(0.0, "late", alive=True))
    assert appear(roster, "late")


def test_a_fleet_that_has_grown_is_told_its_interval_once() -> None:
    roster = Roster(SPEC, ANY)
    few = int(MOST * HEARTBEAT)
    for number in range(few):
        appear(roster, f"w{number}")
    assert roster.new_intervals(60.0) == {}
    appear(roster, "one-more")
    assert roster.new_intervals(60.0) == dict.fromkeys(roster.living, 2 * HEARTBEAT)
    assert len(roster.living) == few + 1
    assert roster.new_intervals(60.0) == {}
    appear(roster, "late")
    assert roster.new_intervals(60.0) == {"late": 2 * HEARTBEAT}


def test_a_worker_that_was_away_is_told_again_and_one_that_is_not_admitted_never() -> None:
    roster = Roster(SPEC, ANY)
    for number in range(int(MOST * HEARTBEAT) + 5):
        appear(roster, f"w{number}")
    roster.token(Token(0.0, "silent", alive=True))
    assert "silent" not in roster.new_intervals(60.0)
    roster.token(Token(1.0, "w0", alive=False))
    assert roster.new_intervals(60.0) == {}
    roster.token(Token(2.0, "w0", alive=True))
    assert roster.new_intervals(60.0) == {"w0": 2 * HEARTBEAT}


def test_a_fleet_that_has_become_small_has_the_interval_of_before_again() -> None:
    roster = Roster(SPEC, ANY)
    for number in range(4 * int(MOST)):
        appear(roster, f"w{number}")
    assert set(roster.new_intervals(60.0).values()) == {4.0}
    for number in range(1, 4 * int(MOST)):
        roster.token(Token(1.0, f"w{number}", alive=False))
    assert roster.new_intervals(60.0) == {"w0": HEARTBEAT}
