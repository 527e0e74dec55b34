"""The key of a run's assignments: kept over restarts, made anew where it is lost or others know it."""

from pathlib import Path

import pytest

from perfbound.orchestrator.run.outbox import KEY, Assignments, forget
from perfbound.schemas.ids import Attempt, RolloutId
from perfbound.schemas.link.messages import ResultHeader
from perfbound.schemas.link.seal import result_proof

ATTEMPT = Attempt(RolloutId("maximum", 0, "true", 0), 1)


def a_result(secret: str) -> ResultHeader:
    header = ResultHeader(rollout=str(ATTEMPT.rollout), attempt=1, worker="w", outcome="done", sha256="a" * 64)
    return header.model_copy(update={"proof": result_proof(secret, header)})


def test_results_are_proved_after_a_restart(tmp_path: Path) -> None:
    header = a_result(Assignments(tmp_path, "run").secret("w", ATTEMPT))
    assert (tmp_path / KEY).stat().st_mode & 0o777 == 0o600
    assert Assignments(tmp_path, "run").proved("w", header)
    assert not Assignments(tmp_path, "run").proved("v", header)
    assert not Assignments(tmp_path, "another").proved("w", header)
    forget(tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert not Assignments(tmp_path, "run").proved("w", header)


@pytest.mark.parametrize("how", ["short", "long", "open", "link"])
def test_a_key_that_is_none_is_made_anew(tmp_path: Path, how: str) -> None:
    header = a_result(Assignments(tmp_path, "run").secret("w", ATTEMPT))
    key = tmp_path / KEY
    match how:
        case "short":
            key.write_bytes(b"")
        case "long":
            key.write_bytes(bytes(33))
        case "open":
            key.chmod(0o644)
        case "link":
            key.symlink_to(key.rename(tmp_path / "elsewhere"))
    assert not Assignments(tmp_path, "run").proved("w", header)
    assert not key.is_symlink()
    assert key.stat().st_mode & 0o777 == 0o600
