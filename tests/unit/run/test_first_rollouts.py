"""The first rollout of a campaign, before its workers: which one it is, and what becomes of one that fails."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.certificate.verify.rerun import MemoryFactStore, NullFileStore
from perfbound.orchestrator.fleet.children.rollouts import ChildRolloutError, ChildSystem, SlowRolloutError, file_of
from perfbound.orchestrator.run import first_rollouts
from perfbound.orchestrator.run.first_rollouts import PATIENCE, check_first_rollouts, first_requests, is_own_system
from perfbound.schemas.batch import BatchRequest
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.result.facts import Header
from perfbound.schemas.rollout import RolloutRequest
from perfbound.workers.batch import run_on
from perfbound.workers.simulate import requested_system
from perfbound.workers.systems import load_system
from tests.campaigns import config

SAMPLE: dict[str, Any] = {
    "specification": "always (value >= -0.65)",
    "problems": [{"name": "robustness", "method": "sample"}],
}
WHERE = "c.toml: system.python"
Requests = Sequence[RolloutRequest | BatchRequest]


def header_of(name: str, spec: dict[str, Any] | None = None, **changes: Any) -> Header:
    found = config(name, **changes)
    return Header.new(found, load_system(found.system.name).spec.model_copy(update=spec or {}), {}, run="0" * 16)


def requests_of(header: Header) -> Requests:
    return first_requests(header, plans(header.config, header.spec))


@pytest.mark.parametrize(
    "header",
    [header_of("segway-paper"), header_of("test-function-rigorous"), header_of("test-function", **SAMPLE)],
    ids=["paper", "rigorous", "sample"],
)
def test_it_is_the_first_one_that_a_worker_gets(header: Header, tmp_path: Path) -> None:
    ledger = Ledger(tmp_path, MemoryFactStore(header), files=NullFileStore())
    wanted = ledger.outstanding().wanted
    assert requests_of(header) == [ledger.request(wanted[0])]


def test_of_two_simulators_there_is_one_of_each() -> None:
    found = requests_of(header_of("segway-paper", {"simulators": {"nominal": "1" * 64, "true": "2" * 64}}))
    assert [each.variant for each in found] == ["nominal", "true"]
    assert [each.spec_sha256 for each in found] == ["1" * 64, "2" * 64]


def test_a_vectorised_system_of_a_campaign_in_batches_has_a_batch() -> None:
    """An axis of rollouts that is missing shows with two of them."""
    (alone,) = requests_of(header_of("test-function", {"vectorised": True}, **SAMPLE))
    (batch,) = requests_of(header_of("test-function", {"vectorised": True}, **SAMPLE, batch=16))
    assert isinstance(alone, RolloutRequest)
    assert isinstance(batch, BatchRequest)
    assert (len(batch), len(batch.x)) == (2, 1)


def checked(monkeypatch: pytest.MonkeyPatch, child: Callable[..., None], **changes: Any) -> list[str]:
    """Return the lines of a check whose child is a function."""
    lines: list[str] = []
    monkeypatch.setattr(first_rollouts, "simulate_in_child", child)
    check_first_rollouts(header_of("test-function", **changes), "test-function", WHERE, lines.append)
    return lines


def simulated(_system: ChildSystem, requests: Requests, folder: Path, _done: Callable[[int], None]) -> None:
    for number, request in enumerate(requests):
        file_of(folder, number).write_bytes(run_on(requested_system(request), request, lambda _step: None))


def test_a_sound_one_prints_nothing_and_leaves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert checked(monkeypatch, simulated) == []
    assert list(tmp_path.iterdir()) == []


def test_one_that_fails_is_a_line_with_place_and_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_arguments: object) -> None:
        raise ChildRolloutError("x = 1, seed 2: ZeroDivisionError: division by zero (cars.py, line 17)")

    with pytest.raises(CampaignError) as caught:
        checked(monkeypatch, fails)
    (line,) = caught.value.lines
    assert line.startswith(f"{WHERE}: the first rollout of test-function fails, at x = 1, seed 2: ZeroDivisionError")
    assert "fix this, then run again (nothing was started, and `perfbound check-system test-function`" in line


def test_the_campaign_file_is_what_check_system_gets(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """By FILE.py:NAME it would try another horizon, and other knots."""

    def fails(*_arguments: object) -> None:
        raise ChildRolloutError("x = 1, seed 2: it fails")

    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").touch()
    with pytest.raises(CampaignError, match=r"`perfbound check-system c[.]toml` tries more"):
        checked(monkeypatch, fails)


def test_one_that_the_campaign_would_refuse_is_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def other(system: ChildSystem, requests: Requests, folder: Path, done: Callable[[int], None]) -> None:
        simulated(system, [each.model_copy(update={"seed": each.seed + 1}) for each in requests], folder, done)  # type: ignore[union-attr]

    with pytest.raises(
        CampaignError, match=r"the trajectory was simulated for another request \(other seed\); at z1.*; fix"
    ):
        checked(monkeypatch, other)


def hangs(system: ChildSystem, *_arguments: object) -> None:
    raise SlowRolloutError(f"x = 1: the rollout gave no result within {system.limit:g} s, and was ended")


def test_one_longer_than_its_deadline_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CampaignError, match="within 2 s, and was ended; let it end, or give a longer `deadline`"):
        checked(monkeypatch, hangs, deadline=2.0)


def test_a_long_one_is_left_to_the_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    (line,) = checked(monkeypatch, hangs, deadline=3600.0)
    assert f"has not ended within {PATIENCE:g} s; it is left to the workers" in line


def test_a_line_says_what_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])

    def slow(system: ChildSystem, requests: Requests, folder: Path, done: Callable[[int], None]) -> None:
        for now[0] in (3.9, 4.0, 5.0):  # the clock
            done(0)
        simulated(system, requests, folder, done)

    assert checked(monkeypatch, slow) == ["simulating the first rollout of test-function, before workers start"]


def test_systems_that_come_with_perfbound_are_not_tried() -> None:
    assert not is_own_system("segway")
    assert is_own_system("cars.py:cars")
    assert is_own_system("pendulum.toml")
    assert is_own_system("my-robot")


def test_one_that_fails_once_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[Path] = []

    def flaky(system: ChildSystem, requests: Requests, folder: Path, done: Callable[[int], None]) -> None:
        tries.append(folder)
        if len(tries) == 1:
            raise ChildRolloutError("x = 1, seed 2: the process of the system crashed")
        simulated(system, requests, folder, done)

    assert checked(monkeypatch, flaky) == []
    assert len(set(tries)) == 2, "each in a folder of its own"
