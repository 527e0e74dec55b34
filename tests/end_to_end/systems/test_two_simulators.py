"""Two simulators in one campaign: workers that have both or one, and what a certificate says of them."""

import json
import re
import shutil
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, wait_for

MODEL = """
import numpy as np
import perfbound as pb

@pb.system(parameters={"gap": pb.Parameter(0, 1, unit="m")}, columns={"distance": "m", "extra": ""}, step=0.1)
def model(gap, *, slope=0.5):
    t = np.arange(0, 1.05, 0.1)
    return gap + slope * np.sin(3 * gap) * t, t
"""
PLANT = """
import numpy as np
import perfbound as pb

@pb.system(parameters={"gap": pb.Parameter(0, 2, unit="m")}, columns={"other": "", "distance": "m"}, step=0.02)
def plant(gap, *, seed):
    t = np.arange(0, 1.01, 0.02)
    noise = 0.02 * np.random.default_rng(seed).uniform(-1, 1)
    return t, gap + 0.52 * np.sin(3 * gap) * t + noise
"""
CAMPAIGN = """
horizon = 1
specification = "always (distance >= -0.5)"
clip = [-1, 2]
gap = { kind = "signal_sup", column = "distance", lipschitz = 1 }
composition = "pointwise"
spot_check = 9
recheck = 6
[system]
columns = { distance = "m" }
nominal = { python = "model.py:model", slope = 0.45 }
true = { python = "plant.py:plant" }
[space]
gap = [0, 1]
[[problems]]
name = "nominal_robustness"
alpha = 0.1
rkhs_norm = 3
noise_scale = 0
max_tests = 12
[[problems]]
name = "sim_gap"
alpha = 0.05
rkhs_norm = 1
noise_scale = 0.03
replicates = 4
max_tests = 12
"""


@pytest.fixture
def campaign(started: Processes) -> Path:
    """The campaign with both simulators."""
    (started.folder / "model.py").write_text(MODEL)
    (started.folder / "plant.py").write_text(PLANT)
    file = started.folder / "two.toml"
    file.write_text(CAMPAIGN)
    return file


def certificate(directory: Path) -> bytes:
    return (directory / "certificate.json").read_bytes()


@pytest.mark.journey
def test_workers_with_one_of_them_make_the_same_certificate(started: Processes, campaign: Path) -> None:
    """One worker with both; and three, of which each has another selection."""
    folder = started.folder
    alone = started.run("perfbound", "run", campaign, "--out", folder / "alone", "--workers", "1")
    assert alone.code == 0, alone
    server = started.start("perfbound", "orchestrate", campaign, "--out", folder / "three")
    wait_for(lambda: "waiting for workers" in server.err)
    connect = ("perfbound-worker", "--connect", server.err.split("--connect ")[1].split()[0], "--system")
    for name, kept in (("nominal", "model.py"), ("true", "plant.py"), ("both", "")):
        place = folder / name
        place.mkdir()
        for file in ("two.toml", "model.py", "plant.py"):
            if file in {"two.toml", kept or file}:
                shutil.copy(folder / file, place)
        started.start(*connect, place / "two.toml", "--name", name)
        if name == "nominal":
            # Alone it simulates the nominal rollouts, and the others wait for one that has their simulator.
            wait_for(lambda: "has the simulator of nominal alone" in server.err)
    assert server.wait().code == 0
    assert certificate(folder / "three") == certificate(folder / "alone")
    found = json.loads(certificate(folder / "alone"))["predicate"]
    names = {each["id"]: each["status"] for each in found["assumptions"]}
    assert names["common_times/sim_gap"] == "assumed", "11 and 51 samples are compared"
    verify = started.run("perfbound", "verify", folder / "three", "--resimulate", "4", "--system", campaign)
    assert verify.code == 0, verify
    (folder / "plant.py").write_text(PLANT.replace("0.52", "0.53"))
    refused = started.run("perfbound", "verify", folder / "three", "--resimulate", "4", "--system", campaign)
    assert refused.code == 1
    assert "plant.py is another" in " ".join(refused.out.split())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"plant.py:plant"', '"plnt.py:plant"', r"two\.toml: system: true: .*plnt\.py: there is no such Python file"),
        ('{ distance = "m" }', '{ distnce = "m" }', r"system\.columns: 'distnce' is no column of nominal: .*distance"),
        ('{ distance = "m" }', '{ distance = "cm" }', "columns: distance is in 'm' in nominal, and not in 'cm'"),
        ("slope = 0.45", "slpe = 0.45", r"system\.nominal\.slpe: model has no such option"),
        ('columns = { distance = "m" }\n', "", r"system\.columns: required by two simulators"),
        ('true = { python = "plant.py:plant" }\n', "", r"system\.true: required by two simulators"),
    ],
)
def test_what_does_not_fit_is_one_line(started: Processes, campaign: Path, old: str, new: str, message: str) -> None:
    text = campaign.read_text()
    assert old in text
    campaign.write_text(text.replace(old, new))
    ended = started.run("perfbound", "run", campaign, "--out", started.folder / "run")
    assert ended.code != 0
    assert re.search(message, ended.last_line), ended.last_line
    assert not (started.folder / "run").exists()
