"""The small campaigns that faults are done to, and how each of them ends when nothing happens."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from perfbound.orchestrator.store.facts import observed_rollouts
from perfbound.schemas.ids import closing_check
from tests.end_to_end.processes import processes, query, recorded, write_campaign

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

GAP = """name = "gap"
seed = 1
horizon = 1.0
specification = "always (value <= 0.45)"
clip = [-0.2, 1.0]
gap = {{ kind = "signal_sup", column = "value", lipschitz = 1.0 }}
composition = "sum"
resolution = 8
max_tests = {tests}
visual = "none"
window = 2
replicates = 2
max_attempts = {max_attempts}
hung_after = {hung_after}
deadline = {deadline}
spot_check = 0
recheck = 2

[system]
name = "faulty-function"
pace = {pace}

[space]
z1 = {{ low = 0.0, high = 5.0, unit = "1" }}
z2 = {{ low = 0.0, high = 5.0, unit = "1" }}

[[problems]]
name = "nominal_robustness"
method = "rigorous"
delta = 0.05
alpha = 0.001
rkhs_norm = 2.0
noise_scale = 0.0
kernel = {{ nu = 10.0, length_scale = 1.0 }}

[[problems]]
name = "sim_gap"
method = "rigorous"
delta = 0.05
alpha = 0.0001
rkhs_norm = 0.5
noise_scale = 0.005
kernel = {{ nu = 10.0, length_scale = 1.0 }}
"""
"""Two trajectories are compared in every test of the gap."""

BATCHES = """name = "{name}"
seed = 1
horizon = 1.0
specification = "always (value >= -0.45)"
clip = [-1.0, 1.0]
claims = [{{ quantity = "failure_probability", delta = 0.05 }}, {{ quantity = "mean", delta = 0.05 }}]
batch = {batch}
visual = "none"
max_attempts = {max_attempts}
hung_after = {hung_after}
deadline = {deadline}
recheck = 4
second_opinion = {second_opinion}

[system]
name = "faulty-function"
pace = {pace}

[space]
z1 = {{ low = 0.0, high = 5.0, unit = "1" }}
z2 = {{ low = 0.0, high = 5.0, unit = "1" }}

[[problems]]
name = "robustness"
method = "sample"
max_tests = {tests}
"""
"""In place of each of the others, where faults are done to batches."""


@dataclass(frozen=True)
class Subject:
    """A campaign file, its plug-in and the run directory of a calm run."""

    name: str
    campaign: Path
    calm: Path
    plugins: Path
    hung_after: float
    batch: int = 1

    @property
    def rollouts(self) -> int:
        """Number of recorded rollouts, or batches, of the calm run."""
        return len(self.seeds) if self.batch == 1 else recorded(self.calm)

    @property
    def path(self) -> str:
        """PYTHONPATH of its processes: the plug-in, and the code beside this file."""
        return f"{self.plugins}:{ROOT}"

    @property
    def seeds(self) -> list[int]:
        """Of the rollouts of observed tests, in their order; another run need not try a withdrawn one."""
        if self.batch > 1:
            return [fact.seed for fact in observed_rollouts(self.calm) if not closing_check(fact.rollout.problem)]
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
    "sampled": {
        "tests": 400,
        "pace": 0.02,
        "max_attempts": 50,
        "hung_after": 60.0,
        "deadline": 120.0,
        "second_opinion": 0.05,
    },
    "brief": {"tests": 16, "pace": 0.08, "max_attempts": 50, "hung_after": 60.0, "deadline": 120.0},
    "gap": {"tests": 6, "pace": 0.08, "max_attempts": 50, "hung_after": 2.0, "deadline": 6.0},
    "brittle": {"tests": 24, "pace": 0.08, "max_attempts": 5, "hung_after": 2.0, "deadline": 4.0},
}
"""Of the campaigns on the plug-in; nothing is poison unless it shall be. `sampled` and `brief` have patience."""
NAMES = (*LIMITS, "segway")


def function_campaign(name: str, limits: str, batch: int = 1, /, **changes: float) -> str:
    """Return the file of a campaign with the limits of a subject; its batches last twice as long as its rollouts."""
    text, found = GAP if limits == "gap" else FUNCTION, {"second_opinion": 0.0, **LIMITS[limits], **changes}
    if batch > 1:
        text, each = BATCHES, 2 / batch
        found |= {"tests": int(found["tests"] / each), "pace": found["pace"] * each}
        found |= {"deadline": max(1.0, found["deadline"] * each)}
    return text.format(name=name, batch=batch, **found)


def _hung_after(name: str) -> float:
    return LIMITS[name]["hung_after"] if name in LIMITS else 3.0


def install(folder: Path) -> Path:
    """Make a folder which, on PYTHONPATH, is an installed plug-in."""
    about = folder / "faulty_function-1.0.dist-info"
    about.mkdir(parents=True)
    shutil.copy(PLUGIN, folder)
    (about / "METADATA").write_text(METADATA)
    (about / "entry_points.txt").write_text(ENTRY_POINT)
    return folder


def prepare(name: str, folder: Path, batch: int = 1) -> Subject:
    """Write a campaign, and run it in peace, unless that has been done in `folder`."""
    campaign, plugins = folder / "campaign.toml", folder / "plugins"
    if (folder / "calm" / "certificate.json").exists():
        return Subject(name, campaign, folder / "calm", plugins, _hung_after(name), batch)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    install(plugins)
    if name == "segway":
        write_campaign(campaign, hung_after=str(_hung_after(name)), max_attempts="50")
    else:
        campaign.write_text(function_campaign(name, name, batch))
    subject = Subject(name, campaign, folder / "calm", plugins, _hung_after(name), batch)
    with processes(folder) as started:
        calm = started.start("perfbound", "run", campaign, "--out", subject.calm, PYTHONPATH=subject.path).wait()
    assert calm.code == 0, calm.err
    return subject
