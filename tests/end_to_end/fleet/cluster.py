"""A Slurm cluster of one node, in namespaces of its own: its network ends at its loopback, and nothing outlives it.

Without a daemon for authentication, which only a test may do.
"""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.end_to_end.processes import Processes, wait_for

PROGRAMS = ("slurmctld", "slurmd", "sbatch", "unshare", "nsenter", "ip")
REFUSED = 3.0
"""Seconds in which a node may still refuse a job that is queued again."""
CONFIGURATION = """
ClusterName=test
SlurmctldHost=localhost
AuthType=auth/none
CredType=cred/none
SlurmUser=root
SlurmdUser=root
StateSaveLocation={folder}/state
SlurmdSpoolDir={spool}
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SwitchType=switch/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=1,batch_sched_delay=0
JobRequeue=1
ReturnToService=2
KillWait=3
SlurmdParameters=config_overrides
NodeName=localhost CPUs=8 RealMemory=20000 State=UNKNOWN
PartitionName=all Nodes=localhost Default=YES MaxTime=INFINITE State=UP
"""
# Names resolve only where an interface besides the loopback has an address.
START = """
set -e
ip link set lo up
ip link add cluster0 type veth peer name cluster1
ip address add 192.0.2.1/24 dev cluster0
ip link set cluster0 up
hostname localhost
slurmctld -D -i & slurmd -D -N localhost &
wait
"""


def missing() -> str:
    """Return why no cluster can be started here; nothing if it can."""
    if os.geteuid() != 0:
        return "only root can start a Slurm cluster in namespaces of its own"
    lacking = [name for name in PROGRAMS if shutil.which(name) is None]
    if lacking:
        return f"{', '.join(lacking)}: not installed: make slurm"
    made = subprocess.run(
        ["unshare", "--net", "--pid", "--fork", "--mount-proc", "--uts", "true"], capture_output=True, check=False
    )
    return "this system lets nobody make namespaces" if made.returncode else ""


@dataclass
class Cluster:
    """A cluster that runs; `inside` turns a command into one of a user there."""

    folder: Path
    inside: tuple[str, ...]
    held: dict[str, float] = field(default_factory=dict)
    """Jobs that wait for their time, and since when they were seen to."""

    def ask(self, *command: str | Path) -> str:
        """Return what a command of Slurm prints."""
        return subprocess.run(
            [*self.inside, *command], cwd=self.folder, capture_output=True, text=True, check=True
        ).stdout

    def jobs(self) -> dict[str, tuple[str, str]]:
        """Return state and reason of every job in the queue."""
        lines = self.ask("squeue", "--noheader", "--array", "--format=%i|%T|%r").splitlines()
        return {job: (state, reason) for job, state, reason in (line.split("|", 2) for line in lines)}

    def hurry(self) -> None:
        """Start a few seconds after it was queued again what Slurm would start after two minutes."""
        now = time.monotonic()
        held = [job for job, found in self.jobs().items() if found == ("PENDING", "BeginTime")]
        self.held = {job: self.held.get(job, now) for job in held}
        for job, since in self.held.items():
            # Within a second of its end slurmd refuses it, as one whose credential is revoked, and Slurm ends it.
            if now - since > REFUSED:
                self.ask("scontrol", "update", f"JobId={job}", "StartTime=now")

    def is_empty(self) -> bool:
        """Whether no job is left; those that wait for their time are started."""
        self.hurry()
        return not self.jobs()

    def shown(self, job: str) -> str:
        """Return all that Slurm knows of a job, also after its end."""
        return self.ask("scontrol", "show", "job", job)


@contextmanager
def cluster(started: Processes) -> Iterator[Cluster]:
    """Start a cluster, whose end is that of its first process."""
    folder = started.folder / "cluster"
    (folder / "state").mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="pb") as spool:  # of its sockets, whose paths have 108 characters at most
        configuration = folder / "slurm.conf"
        configuration.write_text(CONFIGURATION.format(folder=folder, spool=spool))
        yield from _started(folder, configuration)


def _started(folder: Path, configuration: Path) -> Iterator[Cluster]:
    environment = {**os.environ, "SLURM_CONF": str(configuration)}
    namespaces = ("--net", "--pid", "--fork", "--kill-child", "--mount-proc", "--uts")
    with (folder / "log").open("wb") as log:
        popen = subprocess.Popen(
            ["unshare", *namespaces, "bash", "-c", START], cwd=folder, env=environment, stdout=log, stderr=log
        )
    try:
        yield _running(folder, popen, configuration)
    finally:
        popen.kill()
        popen.wait()


def _running(folder: Path, popen: "subprocess.Popen[bytes]", configuration: Path) -> Cluster:
    children = Path(f"/proc/{popen.pid}/task/{popen.pid}/children")
    wait_for(lambda: popen.poll() is not None or children.read_text())
    assert popen.poll() is None, (folder / "log").read_text()
    first = children.read_text().split()[0]
    enter = ("nsenter", "-t", first, "-n", "-p", "-u", "-m", f"--wd={folder.parent}")
    found = Cluster(folder, (*enter, "env", f"SLURM_CONF={configuration}"))
    wait_for(lambda: _is_up(found, ("sinfo", "--noheader", "--format=%T")))
    return found


def _is_up(found: Cluster, command: Sequence[str]) -> bool:
    asked = subprocess.run([*found.inside, *command], capture_output=True, text=True, check=False)
    return asked.stdout.strip() == "idle"
