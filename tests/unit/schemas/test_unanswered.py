"""The lines of a worker that finds no orchestrator."""

from perfbound.schemas.unanswered import no_orchestrator


def test_an_orchestrator_that_does_not_know_the_secret_may_be_an_older_one() -> None:
    line = no_orchestrator(["tcp/127.0.0.1:7447"], None, strangers=True, common_name="")
    assert line.startswith("the orchestrator at tcp/127.0.0.1:7447 does not know the secret of this worker: start both")
    assert line.endswith("; an orchestrator of an older version has none: install the same version on both")
