"""Six campaigns about one car, one for each way to end: their files, and the verdict that each must get."""

from dataclasses import dataclass
from pathlib import Path

from perfbound.schemas.result.known import VerdictWord

SYSTEM = '''"""A car brakes behind another one, after a reaction time that may vary."""

import numpy as np

import perfbound as pb

PARAMETERS = {"gap": pb.Parameter(5, 60, unit="m"), "speed": pb.Parameter(5, 35, unit="m/s")}
COLUMNS = {"distance": "m", "speed": "m/s"}


@pb.system(parameters=PARAMETERS, columns=COLUMNS, step=0.05)
def car(gap, speed, *, seed, horizon):
    """Brake ahead with 6 m/s2, and behind with 7 m/s2 after a reaction time of .4 to .8 s."""
    return braked(gap, speed, horizon, np.random.default_rng(seed).uniform(0.4, 0.8))


@pb.system(parameters=PARAMETERS, columns=COLUMNS, step=0.05, noisy=[])
def exact_car(gap, speed, *, seed, horizon):
    """Brake ahead with 6 m/s2, and behind with 7 m/s2 after a reaction time of .6 s."""
    return braked(gap, speed, horizon, 0.6)


def braked(gap, speed, horizon, delay):
    t = np.arange(0.0, horizon + 0.025, 0.05)
    ahead = np.maximum(speed - 6 * t, 0)
    follower = np.maximum(speed - 7 * np.maximum(t - delay, 0), 0)
    return gap + 0.05 * np.cumsum(ahead - follower), follower
'''
COMMON = """horizon = 8.0
specification = "always (distance >= 2)"
kernel = { length_scale = { gap = 30, speed = 20 } }
"""
NOISY = """system.python = "car.py:car"
clip = [-20, 60]
noise_scale = 3.5
"""
NEAR = "space = { gap = { low = 20, high = 50 }, speed = { low = 10, high = 30 } }\n"
TOO_NEAR = "space = { gap = { low = 5, high = 20 }, speed = { low = 20, high = 35 } }\n"


@dataclass(frozen=True, slots=True)
class Case:
    """One campaign: its file, and what a reader must learn."""

    name: str
    file: str
    verdict: VerdictWord
    words: str
    """Part of the first reason."""


def _case(name: str, file: str, verdict: VerdictWord, words: str) -> Case:
    return Case(name, COMMON + file, verdict, words)


CASES = (
    _case(
        "standing",
        f"{NOISY}{NEAR}rkhs_norm = 40\nprior_mean = -25\nmax_tests = 60\nreplicates = 8\nalpha = 3.0\n",
        "SHOWN",
        "Required at least 0 m.",
    ),
    _case(
        "violated",
        f'system.python = "car.py:exact_car"\n{TOO_NEAR}rkhs_norm = 60\nnoise_scale = 0\nalpha = 0.5\n'
        "required_margin = 1\n",
        "VIOLATED",
        "the robustness is",
    ),
    _case(
        "violated-mean",
        f"{NOISY}{TOO_NEAR}rkhs_norm = 40\nprior_mean = -10\nmax_tests = 60\nreplicates = 8\nalpha = 3.0\n",
        "VIOLATED",
        "with probability at least 0.95",
    ),
    _case(
        "refuted",
        f"{NOISY}{NEAR}rkhs_norm = 4\nprior_mean = -25\nmax_tests = 60\nreplicates = 8\nalpha = 3.0\n",
        "NOT SHOWN",
        "The data refute that the norm bound B is large enough",
    ),
    _case(
        "vacuous",
        f"{NOISY}{NEAR}rkhs_norm = 4000\nprior_mean = -25\nmax_tests = 20\nreplicates = 2\nalpha = 3.0\n",
        "NOT SHOWN",
        "shows nothing",
    ),
    _case(
        "budget",
        f"{NOISY}{NEAR}rkhs_norm = 80\nprior_mean = -25\nmax_tests = 6\nreplicates = 8\nalpha = 3.0\n",
        "NOT SHOWN",
        "tests is spent",
    ),
)


def write(folder: Path) -> None:
    """Write the system and the six campaign files."""
    (folder / "car.py").write_text(SYSTEM)
    for case in CASES:
        (folder / f"{case.name}.toml").write_text(case.file)
