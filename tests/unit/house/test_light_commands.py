"""Commands that people repeat while they wait load no numerical library."""

import subprocess
import sys

HEAVY = {"numpy", "scipy", "sklearn", "mcap", "matplotlib"}


def test_status_loads_no_numerical_library() -> None:
    program = "import sys, perfbound.orchestrator.cli.status; print(*{name.partition('.')[0] for name in sys.modules})"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert HEAVY.isdisjoint(ended.stdout.split())
