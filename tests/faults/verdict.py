"""Checks after every fault run."""

import hashlib
import json
import os
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from perfbound.orchestrator.store import lock, read
from perfbound.orchestrator.store.facts import observed_rollouts
from perfbound.schemas.atomic import TEMPORARY
from tests.end_to_end.processes import query
from tests.faults.scene import Scene

EXPECTED = {"campaign.db", "campaign.db-wal", "campaign.db-shm", "certificate.json", "manifest.sha256", "attempts.json"}
EXPECTED |= {"report.html", "counterexamples.csv", lock.LOCK_FILE}


REPRODUCIBLE = "reproducible_rollouts"
"""The assumption that is refuted by a failure of the system that does not repeat with its seed."""


@dataclass
class Verdict:
    """The findings of one run; empty without a fault."""

    twice: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    different: list[str] = field(default_factory=list)
    leftovers: list[str] = field(default_factory=list)
    early: list[str] = field(default_factory=list)
    """Campaigns that ended although they could continue."""
    failures: list[str] = field(default_factory=list)
    """Whatever else a fault expects."""

    @property
    def good(self) -> bool:
        """Whether the promise was kept."""
        return not (self.twice or self.lost or self.different or self.leftovers or self.early or self.failures)


def judge(scene: Scene, found: Verdict) -> None:
    """Check the run directory of a scene that has ended: facts, files, certificate, lock."""
    directory, calm = scene.directory, scene.subject.calm
    rows = query(directory, "SELECT path, sha256, size FROM rollouts")
    found.twice += _twice(directory, rows)
    found.lost += _lost(directory, rows)
    if not scene.misled:
        found.lost += _missing(calm, rows) if scene.subject.batch == 1 else []
        found.different += _other_rollouts(directory, calm)
    for name in ("certificate.json", "manifest.sha256"):
        path = directory / name
        if not path.exists():
            found.different.append(f"no {name}")
        elif not (scene.misled or _equal(path, calm / name, scene)):
            found.different.append(f"{name} differs from the calm one")
    count = read.irreproducible(directory) + _failed_in_batches(directory)
    if bool(count) != scene.irreproducible:
        found.different.append(f"{count} rollouts are irreproducible")
    found.leftovers += _orphans(directory, {str(row[0]) for row in rows})
    if directory.exists() and lock.is_held(directory):
        found.leftovers.append("the lock is held")


def _equal(path: Path, calm: Path, scene: Scene) -> bool:
    """Whether a file has the bytes of the calm one; where rollouts failed one assumption of the certificate differs.

    What failed in its batch is in another file, and so the manifest is another one.
    """
    if not scene.irreproducible:
        return path.read_bytes() == calm.read_bytes()
    if path.name != "certificate.json":
        return scene.subject.batch > 1 or path.read_bytes() == calm.read_bytes()
    ours, theirs = (without(each.read_bytes(), REPRODUCIBLE) for each in (path, calm))
    if scene.subject.batch > 1:
        for each in (ours, theirs):
            del each["subject"], each["predicate"]["evidence"]["manifest_sha256"]
    return ours == theirs


def _other_rollouts(directory: Path, calm: Path) -> list[str]:
    """Return the observed rollouts that are not those of the calm run, or are there twice; also within batches."""
    ours, theirs = (
        Counter((fact.rollout, fact.seed, fact.sha256) for fact in observed_rollouts(each))
        for each in (directory, calm)
    )
    return [f"{rollout} is not the one of the calm run" for rollout, *_ in ((ours - theirs) + (theirs - ours))]


def _failed_in_batches(directory: Path) -> int:
    """Return the number of rollouts that failed in their batches."""
    rows = query(directory, "SELECT failures FROM rollouts WHERE failures IS NOT NULL")
    return sum(len(json.loads(str(failures))) for (failures,) in rows)


def without(certificate: bytes, assumption: str) -> dict[str, Any]:
    """Return a certificate without one assumption: neither its status and sentence, nor its place in the claims."""
    found: dict[str, Any] = json.loads(certificate)
    predicate = found["predicate"]
    predicate["assumptions"] = [each for each in predicate["assumptions"] if each["id"] != assumption]
    for claim in predicate["claims"]:
        for part in ("assumptions", "refuted"):
            claim[part] = [each for each in claim[part] if each != assumption]
    return found


def _twice(directory: Path, rows: list[tuple[object, ...]]) -> list[str]:
    """Return rollouts that do not have exactly one row, one file and one attempt that was recorded."""
    paths = [row[0] for row in rows]
    found = [f"two rows of {path}" for path in sorted({str(path) for path in paths if paths.count(path) > 1})]
    text = (
        "SELECT path, count(outcome) FROM rollouts "
        "LEFT JOIN outcomes ON path LIKE '%/' || rollout || '.mcap' AND outcome = 'recorded' "
        "GROUP BY path HAVING count(outcome) != 1"
    )
    return found + [f"{count} attempts recorded of {rollout}" for rollout, count in query(directory, text)]


def _lost(directory: Path, rows: list[tuple[object, ...]]) -> list[str]:
    """Return rollouts without the file that was recorded."""
    found = []
    for path, sha256, size in rows:
        file = directory / str(path)
        data = file.read_bytes() if file.exists() else b""
        if hashlib.sha256(data).hexdigest() != sha256 or len(data) != size:
            found.append(f"{path} is not the file that was recorded")
    return found


def _missing(calm: Path, rows: list[tuple[object, ...]]) -> list[str]:
    """Return the rollouts of the calm run that have no row."""
    wanted = {line.split()[1] for line in (calm / "manifest.sha256").read_text().splitlines()}
    return [f"{path} has no row" for path in sorted(wanted - {str(row[0]) for row in rows})]


def _orphans(directory: Path, recorded: set[str]) -> list[str]:
    found = []
    for path in sorted(each for each in directory.rglob("*") if each.is_file()):
        name = str(path.relative_to(directory))
        if name.endswith(TEMPORARY) or name not in recorded | EXPECTED:
            found.append(name)
    return found


def shared_memory() -> set[str]:
    """Return the shared-memory segments of Zenoh."""
    return {name for name in os.listdir("/dev/shm") if "zenoh" in name}


def of_machine(scene: Scene) -> list[str]:
    """Return mounts below the scene's folder and network namespaces of its name that are left."""
    table = Path("/proc/self/mountinfo").read_text().splitlines()
    mounts = [f"mount {line.split()[4]}" for line in table if str(scene.folder) in line]
    folder = Path("/run/netns")
    return mounts + [f"namespace {each.name}" for each in folder.glob(f"{prefix(scene)}*")]


def prefix(scene: Scene) -> str:
    """Return what the names of the scene's network namespaces start with; short enough for the kernel."""
    return "pb" + hashlib.sha256(str(scene.folder).encode()).hexdigest()[:8]
