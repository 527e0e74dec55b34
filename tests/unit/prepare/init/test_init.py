"""A first campaign after a pilot that hangs: the file says what is known, and names the rollout and its place."""

import subprocess
import time
from pathlib import Path

import pytest

from perfbound.orchestrator.prepare.init import init
from perfbound.orchestrator.prepare.init.init import Wish, write_first_campaign
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.file.problem_models import RigorousProblem
from perfbound.schemas.file.reader import parse_campaign
from tests.facts import facts, says

pytestmark = pytest.mark.integration

HANGS = """import time
from pathlib import Path
import perfbound as pb

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": "m"})
def hangs(x, *, seed):
    while x == 1:
        Path(__file__).with_name("hangs").touch()
        time.sleep(0.01)
    return x
"""


ONE_SAMPLE = """import perfbound as pb

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": "m"})
def one(x):
    return 1 + x
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a system whose third rollout hangs; no time is over before it does."""
    (tmp_path / "own.py").write_text(HANGS)
    monkeypatch.chdir(tmp_path)
    communicate = subprocess.Popen.communicate

    def waits(child: subprocess.Popen[str], timeout: float | None = None) -> object:
        if "pilot" not in child.args or child.poll() is not None:  # type: ignore[operator]
            return communicate(child, timeout=timeout)
        while not (tmp_path / "hangs").exists():
            time.sleep(0.01)
        raise subprocess.TimeoutExpired("", 0)

    monkeypatch.setattr(subprocess.Popen, "communicate", waits)
    monkeypatch.setattr(init, "SECONDS", 0.5)
    return tmp_path


def test_a_pilot_that_hangs_names_the_rollout_and_the_place(folder: Path) -> None:
    lines = list(write_first_campaign(Wish("own.py:hangs", "worst", "y >= 0.5", None, None)))
    reason = "x = 1, seed 2: the rollout gave no result within 0.5 s, and was ended in own.py, line "
    assert says(lines[2], f"^hangs.toml: took too long: {reason}")
    assert says(lines[-1], "perfbound check-system hangs.toml")
    assert "perfbound run" not in lines[-1], "not before it is fixed"
    text = " ".join((folder / "hangs.toml").read_text().replace("\n# ", " ").split())
    assert f"GUESSED, because the pilot took too long: {reason}" in text
    assert "do not follow from this formula, because the pilot took too long." in text
    assert "Put your formula here" not in text
    assert text.count("A guess: `perfbound calibrate` proposes") == 3, "clip, prior_mean and rkhs_norm"
    assert parse_campaign((folder / "hangs.toml").read_bytes(), "c").specification == "y >= 0.5"


def test_a_horizon_for_rollouts_of_one_sample_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was ignored, and the file had none."""
    (tmp_path / "own.py").write_text(ONE_SAMPLE)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PerfboundError, match=facts("--horizon 5: rollouts")):
        list(write_first_campaign(Wish("own.py:one", "worst", "y >= 0.5", 5.0, None)))
    assert not (tmp_path / "one.toml").exists()
    list(write_first_campaign(Wish("own.py:one", "worst", "y >= 0.5", None, None)))
    assert (tmp_path / "one.toml").exists()


def test_guesses_are_about_the_formula_that_the_file_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They were about the column, although the formula compares it with a limit that the pilot chose."""
    (tmp_path / "own.py").write_text(ONE_SAMPLE.replace("return 1 + x", "return 1000 + x"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(init, "FEWEST_ROLLOUTS", 10**9)
    lines = list(write_first_campaign(Wish("own.py:one", "worst", None, None, None)))
    assert "the constants are guessed, because" in lines[-3]
    # The constants fit the formula of the pilot, and no other one.
    assert says(lines[-2], "formula own.py:one --question worst --specification --out")
    assert says(lines[-1], "^Check perfbound check-system one.toml perfbound run one.toml")
    (problem,) = parse_campaign((tmp_path / "one.toml").read_bytes(), "c").problems
    assert isinstance(problem, RigorousProblem)
    assert -1.5 < problem.prior_mean < 0.0, "minus the robustness, which is at most 1.1"


CAR = """import numpy as np
import perfbound as pb

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"speed": "m/s", "rpm": "1/min"}, step=0.5)
def car(x, *, horizon):
    t = np.arange(0, horizon + 0.25, 0.5)
    return {"speed": 10 * x * t, "rpm": 1000 + 3000 * x + 0 * t}
"""


def test_a_search_compares_predicates_by_their_ranges_in_the_pilot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.py").write_text(CAR)
    monkeypatch.chdir(tmp_path)
    list(write_first_campaign(Wish("own.py:car", "fails", "always (speed < 15 or rpm < 3750)", 2.0, None)))
    found = parse_campaign((tmp_path / "car.toml").read_bytes(), "c").falsify
    assert found is not None
    assert found.scale == {"speed": 20.0, "rpm": 3000.0}
