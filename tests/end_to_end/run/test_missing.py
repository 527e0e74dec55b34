"""What needs PyBullet is left out with a line where there is none."""

import pytest

from perfbound.schemas.errors import UnknownSystemError
from perfbound.workers.systems.segway.bullet import NEEDS
from tests.studies.benchmarks.__main__ import unless_missing


@pytest.mark.parametrize("fault", [UnknownSystemError(NEEDS), ModuleNotFoundError("No module named 'pybullet'")])
def test_a_benchmark_without_pybullet_is_a_line(fault: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    def measured() -> list[object]:
        raise fault

    assert unless_missing("rollout", measured, NEEDS) == []  # type: ignore[arg-type]
    assert capsys.readouterr().err == f"skipped  rollout: {NEEDS}\n"
    with pytest.raises(type(fault)):  # here it is no reason
        unless_missing("rollout", measured, "")  # type: ignore[arg-type]
