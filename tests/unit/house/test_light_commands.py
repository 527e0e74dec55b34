"""Commands that people repeat while they wait load no numerical library, and typos are answered before anything is."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.campaigns import FOLDER

pytestmark = pytest.mark.integration

HEAVY = {"numpy", "scipy", "sklearn", "mcap", "matplotlib"}


@pytest.mark.integration
@pytest.mark.parametrize("command", ["status", "stop"])
def test_what_is_called_while_a_campaign_runs_loads_no_numerical_library(command: str) -> None:
    program = "print(*{name.partition('.')[0] for name in sys.modules})"
    program = f"import sys, perfbound.orchestrator.cli.{command}; {program}"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert HEAVY.isdisjoint(ended.stdout.split())


LARGE = HEAVY | {"sqlalchemy", "zenoh", "rich"}
MAIN = """import sys
from perfbound.orchestrator.cli import main
sys.argv[0] = "perfbound"
try:
    main()
finally:
    print(*{name.partition('.')[0] for name in sys.modules})
"""


@pytest.mark.integration
@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("rnu c.toml", "Did you mean 'run'?"),
        ("run c.toml --wokers 2", "No such option '--wokers'"),
        ("run missing.toml", "missing.toml: No such file"),
        ("run c.toml", "c.toml: sede: unknown key; did you mean 'seed'?"),
        ("run c.toml --sign missing.key", "missing.key: No such file"),
        ("orchestrate c.toml", "c.toml: sede: unknown key"),
        ("calibrate c.toml", "c.toml: sede: unknown key"),
        ("check-system c.toml", "c.toml: sede: unknown key"),
        ("simulate c.toml --x 1,1 --out o.mcap", "c.toml: sede: unknown key"),
        ("simulate missing.py:cars --x 1,1 --out o.mcap", "missing.py: there is no such Python file"),
        ("init missing.py:cars", "missing.py: there is no such Python file"),
        *(
            (f"{command} nowhere", "nowhere: no campaign here")
            for command in ("status", "stop", "resume", "report", "export")
        ),
        ("replay nowhere sim_gap.3.true.0", "nowhere: no campaign here"),
        ("verify nowhere", "'nowhere' does not exist"),
    ],
)
def test_a_typo_is_answered_before_anything_large_is_loaded(line: str, fault: str, tmp_path: Path) -> None:
    text = (FOLDER / "test-function.toml").read_text()
    assert "\nseed" in text
    (tmp_path / "c.toml").write_text(text.replace("\nseed", "\nsede"))
    ended = subprocess.run(
        [sys.executable, "-c", MAIN, *line.split()], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode in {1, 2}
    assert fault in ended.stderr
    assert LARGE.isdisjoint(ended.stdout.split()), "each of them takes longer than the rest"
    assert [each.name for each in tmp_path.iterdir()] == ["c.toml"]
