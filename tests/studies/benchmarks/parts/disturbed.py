"""Time of a campaign with one bad worker of three, or beside a hostile peer, against the same one in peace.

Rollouts wait more than they compute, so that two cores are enough for four processes.
"""

import json
import random
import signal
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from perfbound.schemas.link.configuration import USER
from perfbound.schemas.link.seal import link_password
from perfbound.schemas.link.secret import VARIABLE
from tests.end_to_end.processes import query, wait_for
from tests.faults.memory import memory
from tests.faults.nodes import NODE
from tests.faults.scene import Scene
from tests.faults.subjects import Subject, function_campaign, install
from tests.studies.benchmarks.report import Row
from tests.studies.benchmarks.runs import RECORDED

TESTS = 300
SECRET = 64 * "5"
NAME = "bad"
BAD = {"broken": ("lack", 0.0), "silent": ("sleep", 0.0), "lying": ("lie", 1.0)}
"""What the worker does in every rollout, and the share of second opinions."""
MOST_TIME = 1.6
LEAST_THROUGHPUT = 0.8
MOST_MEMORY = 400


@dataclass(frozen=True)
class Course:
    """A campaign that has ended."""

    seconds: float
    """Wall time from the first assignment to the last result."""
    certificate: bytes
    named: bool
    memory: int
    sent: int = 0
    """Messages of the hostile peer."""


def main() -> list[Row]:
    """Compare."""
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        plugins = install(base / "plugins")
        subjects = {
            share: _subject(base / f"share-{share}", plugins, second_opinion=share, pace=0.3) for share in (0.0, 1.0)
        }
        calm = {share: _fleet(subject, base / f"good-{share}") for share, subject in subjects.items()}
        rows = [row for name in BAD for row in _beside(name, subjects, calm, base)]
        return rows + _hostile(replace(subjects[0.0], calm=base / "good-0.0" / "run"), base)


def _subject(folder: Path, plugins: Path, **changes: float) -> Subject:
    folder.mkdir()
    campaign = folder / "campaign.toml"
    campaign.write_text(function_campaign("disturbed", "function", tests=TESTS, **changes))
    return Subject("disturbed", campaign, folder / "calm", plugins, 2.0)


def _beside(name: str, subjects: dict[float, Subject], calm: dict[float, Course], base: Path) -> list[Row]:
    kind, share = BAD[name]
    found, best = _fleet(subjects[share], base / name, bad=kind), calm[share]
    label = f"two good workers and a {name} one"
    same = found.certificate == best.certificate and found.named
    return [
        Row(f"{label}: time against the two alone", found.seconds / best.seconds, "times less", at_most=MOST_TIME),
        Row(f"{label}: another certificate, or not named", float(not same), "cases", at_most=0.0),
    ]


def _hostile(subject: Subject, base: Path) -> list[Row]:
    quick = _subject(base / "quick", subject.plugins, pace=0.04)
    quick = replace(quick, calm=subject.calm)
    alone, rows = _fleet(quick, base / "alone"), list[Row]()
    for inside in (False, True):
        beside = _fleet(quick, base / f"hostile-{inside}", hostile=True, inside=inside)
        rows += _against(alone, beside, "with" if inside else "without")
    return rows


def _against(alone: Course, beside: Course, how: str) -> list[Row]:
    sent = beside.sent / beside.seconds
    label, peace = f"beside a hostile peer {how} the link's password, {sent:.0f} messages/s", "in peace"
    rate, usual = TESTS / beside.seconds, TESTS / alone.seconds
    taken, little = beside.memory / 2**20, alone.memory / 2**20
    return [
        Row(f"{label}: throughput", rate, "tests/s", peace, usual, ratio_at_least=LEAST_THROUGHPUT),
        Row(f"{label}: most memory", taken, "MB", peace, little, at_most=MOST_MEMORY),
    ]


def _fleet(subject: Subject, folder: Path, *, bad: str = "", hostile: bool = False, inside: bool = False) -> Course:
    """Run a campaign with two good workers, and perhaps a third one, or a process without the secret."""
    scene = Scene(subject, folder, random.Random(1), remote=True)
    alone, scene.environment = dict(scene.environment), scene.environment | {VARIABLE: SECRET}
    try:
        scene.start(workers=0)
        wait_for(lambda: query(scene.directory, "SELECT run FROM campaign"))
        stop = _disturb(scene, alone, inside=inside) if hostile else lambda: 0
        if bad:
            scene.join(NAME, **{NODE: bad})
        scene.join()
        scene.join()
        with memory(scene) as used:
            ended = scene.finish()
        if bad == "sleep":
            scene.fleet[0].popen.kill()
        seconds: Any = query(scene.directory, RECORDED)[0][2]
        certificate = (scene.directory / "certificate.json").read_bytes()
        named = any(NAME in line for line in ended.err.splitlines())
        return Course(float(seconds), certificate, named, used(), stop())
    finally:
        scene.close()


def _disturb(scene: Scene, environment: dict[str, str], *, inside: bool) -> Callable[[], int]:
    """Start a hostile peer at full rate; return what ends it, and counts its messages."""
    link = {"user": USER, "password": link_password(SECRET.encode())}
    peer = scene.processes.start(
        *("python", "-m", "tests.faults.hostile", scene.listening, scene.directory, "--other", scene.subject.calm),
        *("--seed", "1", "--rate", "0", *(("--link", json.dumps(link)) if inside else ())),
        **environment,
    )

    def stop() -> int:
        peer.popen.send_signal(signal.SIGTERM)
        return int(peer.wait().out)

    return stop
