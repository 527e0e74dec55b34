"""The small campaigns that faults are done to, and how each of them ends when nothing happens."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from tests.end_to_end.processes import processes, query, write_campaign

ROOT = Path(__file__).parents[2]
PLUGIN = Path(__file__).with_name("faulty_function.py")
ENTRY_POINT = "[perfbound.systems]\nfaulty-function = faulty_function:FaultyFunction\n"
METADATA = "Metadata-Version: 2.1\nName: faulty-function\nVersion: 1.0\n"

FUNCTION = """name = "{name}"
seed = 1
composition = "single"
resolution = 16
max_tests = {tests}
visual = "none"
window = 4
max_attempts = {max_attempts}
hung_after = {hung_after}
deadline = {deadline}
spot_check = 8
recheck = 4
second_opinion = {second_opinion}

[system]
name = "faulty-function"
pace = {pace}

[space]
z1 = {{ low = 0.0, high = 5.0, unit = "1" }}
z2 = {{ low = 0.0, high = 5.0, unit = "1" }}

[[problems]]
name = "maximum"
column = "value"
method = "rigorous"
sense = "max"
delta = 0.05
alpha = 0.001
rkhs_norm = 2.0
noise_scale = 0.005
kernel = {{ nu = 10.0, length_scale = 1.0 }}
"""


@dataclass(frozen=True)
class Subject:
    """A campaign file, its plug-in and the run directory of a calm run."""

    campaign: Path
    calm: Path
    plugins: Path
    hung_after: float

    @property
    def rollouts(self) -> int:
        """Number of rollouts of the calm run."""
        return len(self.seeds)

    @property
    def path(self) -> str:
        """PYTHONPATH of its processes: the plug-in, and the code beside this file."""
        return f"{self.plugins}:{ROOT}"

    @property
    def seeds(self) -> list[int]:
        """Of the rollouts of observed tests, in their order; another run need not try a withdrawn one."""
        observed = "JOIN observations USING (problem, test)"
        rows = query(self.calm, f"SELECT seed FROM rollouts {observed} ORDER BY problem, test, variant, replicate")
        return [int(str(row[0])) for row in rows]


LIMITS = {
    "function": {"tests": 48, "pace": 0.08, "max_attempts": 50, "hung_after": 2.0, "deadline": 6.0},
    "slow": {"tests": 36, "pace": 0.3, "max_attempts": 50, "hung_after": 2.0, "deadline": 30.0},
    "compared": {
        "tests": 24,
        "pace": 0.3,
        "max_attempts": 50,
        "hung_after": 2.0,
        "deadline": 30.0,
        "second_opinion": 1.0,
    },
    "brittle": {"tests": 24, "pace": 0.08, "max_attempts": 5, "hung_after": 2.0, "deadline": 4.0},
}
"""Of the campaigns on the plug-in; patience is short, and nothing is poison unless it shall be."""
NAMES = (*LIMITS, "segway")


def install(folder: Path) -> Path:
    """Make a folder which, on PYTHONPATH, is an installed plug-in."""
    about = folder / "faulty_function-1.0.dist-info"
    about.mkdir(parents=True)
    shutil.copy(PLUGIN, folder)
    (about / "METADATA").write_text(METADATA)
    (about / "entry_points.txt").write_text(ENTRY_POINT)
    return folder


def prepare(name: str, folder: Path) -> Subject:
    """Write a campaign, and run it in peace."""
    folder.mkdir(parents=True)
    campaign, plugins = folder / "campaign.toml", install(folder / "plugins")
    if name == "segway":
        write_campaign(campaign, hung_after="3.0", max_attempts="50")
        hung_after = 3.0
    else:
        campaign.write_text(FUNCTION.format(name=name, **{"second_opinion": 0.0, **LIMITS[name]}))
        hung_after = LIMITS[name]["hung_after"]
    subject = Subject(campaign, folder / "calm", plugins, hung_after)
    with processes(folder) as started:
        calm = started.start("perfbound", "run", campaign, "--out", subject.calm, PYTHONPATH=subject.path).wait()
    assert calm.code == 0, calm.err
    return subject
