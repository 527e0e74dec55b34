"""One fault run: a class of faults done to a campaign, then judged."""

import random
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.faults.catalogue import Fault
from tests.faults.scene import EndedEarly, Scene
from tests.faults.subjects import Subject
from tests.faults.verdict import Verdict, judge, of_machine, shared_memory


@dataclass(frozen=True)
class Run:
    """A fault run that has ended."""

    number: int
    fault: str
    subject: str
    seconds: float
    injected: int
    done: tuple[str, ...]
    verdict: Verdict


def perform(
    fault: Fault, chance: random.Random, subjects: Mapping[str, Subject], folder: Path, *, number: int = 0
) -> Run:
    """Do `fault` to one of its `subjects` that are there, in a new `folder`."""
    name = chance.choice([name for name in fault.subjects if name in subjects])
    shared, found = shared_memory(), Verdict()
    scene = Scene(subjects[name], folder, chance)
    steps: tuple[Callable[[], None], ...] = (lambda: fault.act(scene), lambda: judge(scene, found))
    for step in steps:
        try:
            step()
        except EndedEarly as error:
            found.early.append(str(error))
        except Exception:  # noqa: BLE001  (every exception is a finding, and is reported)
            found.failures.append(traceback.format_exc(limit=-3).strip())
    found.leftovers += scene.close()
    found.leftovers += of_machine(scene) + sorted(shared_memory() - shared)
    seconds = time.monotonic() - scene.began
    return Run(number, fault.name, name, seconds, scene.injected, tuple(scene.done), found)
