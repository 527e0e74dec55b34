"""Invariants of the dispatch machine, asserted after every step of a test."""

from perfbound.orchestrator.fleet.dispatch.state import DispatchState


def check_invariants(state: DispatchState) -> None:
    """Assert the invariants of the state."""
    held = [worker.attempt.rollout for worker in state.workers.values() if worker.attempt is not None]
    assert len(set(held)) == len(held), "a rollout is on one worker at a time"
    assert set(held) <= set(state.open), "the rollout of a worker is open"
    assert not set(held) & set(state.waiting), "a waiting rollout is on no worker"
    assert len(set(state.waiting)) == len(state.waiting), "no rollout waits twice"
    assert set(state.waiting) <= set(state.open), "a waiting rollout is open"
    poisoned = {key for key, known in state.open.items() if known.poisoned}
    assert set(state.open) == set(held) | set(state.waiting) | poisoned, (
        "an open rollout is held, waits, or is poisoned"
    )
    for worker in state.workers.values():
        phase = worker.resumes_as if worker.phase == "gone" else worker.phase
        assert (worker.attempt is not None) == (phase in ("sent", "busy")), (
            "a busy worker has an attempt, another one has none"
        )
