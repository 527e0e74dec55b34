"""All fault classes, by name; and what each needs of the machine."""

import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.end_to_end.fleet.hosts import no_namespaces
from tests.faults import deaths, links, machine, nodes, peers, removals, systems
from tests.faults.scene import Scene


@dataclass(frozen=True)
class Fault:
    """One class of faults."""

    act: Callable[[Scene], None]
    """Runs the campaign of a scene to its certificate, with faults."""
    subjects: tuple[str, ...] = ("function", "slow", "segway")
    missing: Callable[[], str] = str
    """Returns what the machine lacks for it; nothing, if it can be run."""

    @property
    def name(self) -> str:
        """The function's name, in words."""
        return self.act.__name__.replace("_", "-")


def _no_root() -> str:
    return "" if os.geteuid() == 0 else "needs root"


def _no_compiler() -> str:
    return "" if shutil.which("cc") else "needs a C compiler (cc)"


PLUGIN = ("function",)
BRIEF = ("brief", "function")
"""For faults that take long, or that hit a campaign anywhere."""
FAULTS = {
    fault.name: fault
    for fault in (
        Fault(deaths.kill_workers),
        Fault(deaths.mass_death, ("brief", "slow", "segway")),
        Fault(deaths.stop_workers, ("slow",)),
        Fault(deaths.kill_orchestrator),
        Fault(deaths.kill_resume, ("function", "segway")),
        Fault(deaths.kill_start, PLUGIN),
        Fault(deaths.two_resumes, BRIEF),
        Fault(deaths.stop_orchestrator),
        Fault(deaths.hang_then_kill, PLUGIN),
        Fault(links.restart_router, ("function", "slow")),
        Fault(links.router_away, ("slow",)),
        Fault(links.restart_everything, ("slow", "function")),
        Fault(links.cut_cable, ("slow",), no_namespaces),
        Fault(links.cut_and_kill, ("slow",), no_namespaces),
        Fault(links.disturb_messages, PLUGIN),
        Fault(machine.fill_disk, PLUGIN, _no_root),
        Fault(machine.slow_disk, PLUGIN, _no_compiler),
        Fault(machine.io_error, (*BRIEF, "gap"), _no_compiler),
        Fault(removals.lost_evidence, (*BRIEF, "gap")),
        Fault(removals.lost_database, BRIEF),
        Fault(machine.jump_clock, ("brief", "brief", "segway"), _no_compiler),
        Fault(peers.hostile_peer, ("brief",)),
        Fault(systems.misbehave, PLUGIN),
        Fault(systems.fail_once, PLUGIN),
        Fault(systems.odd_result, ("gap", "brief")),
        Fault(systems.big_result, ("brief",)),
        Fault(systems.poison, ("brittle",)),
        Fault(systems.hang_and_kill, PLUGIN),
        Fault(nodes.broken_node, ("slow",)),
        Fault(nodes.silent_node, ("slow",)),
        Fault(nodes.slow_node, ("slow",)),
        Fault(nodes.lying_node, ("compared",)),
        Fault(nodes.turning_node, ("sampled",)),
        Fault(deaths.mixed),
    )
}


def draw(seed: int, run: int) -> Fault:
    """Return the class of run `run` of `seed`: every class comes once before any comes again."""
    lap, place = divmod(run, len(FAULTS))
    names = random.Random(f"{seed}/{lap}").sample(sorted(FAULTS), len(FAULTS))
    return FAULTS[names[place]]


def randomness(seed: int, run: int) -> random.Random:
    """Return the randomness of one run."""
    return random.Random(f"{seed}/run {run}")


def folder_of(base: Path, run: int) -> Path:
    """Return the folder of one run."""
    return base / f"run-{run:04d}"
