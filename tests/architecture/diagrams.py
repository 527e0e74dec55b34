"""The three diagrams of docs/architecture.md: places of their boxes, bends and labels of their arrows."""

from collections.abc import Set
from pathlib import Path

from perfbound.orchestrator.fleet.dispatch.machine import KNOWN
from tests.architecture import source
from tests.architecture.drawing import FRAME, Bend, Layout, Pair, plan, svg
from tests.architecture.transitions import BESIDE_CAMPAIGN, Transition, of_campaign, of_dispatch, of_legal, of_problem

FOLDER = Path(__file__).parents[2] / "docs" / "images"

DISPATCH = Layout(
    size=(900, 400),
    places={
        "unknown": (76, 120),
        "new": (250, 120),
        "idle": (430, 120),
        "sent": (610, 120),
        "busy": (800, 120),
        "shunned": (705, 270),
        "gone": (430, 370),
    },
    bends={
        ("new", "busy"): Bend(160, 0.25),
        ("busy", "idle"): Bend(-80, 0.42),
        ("sent", "idle"): Bend(55),
        ("shunned", "idle"): Bend(20, 0.6),
        ("sent", "shunned"): Bend(0, 0.4),
        ("busy", "shunned"): Bend(0, 0.4),
        ("gone", "unknown"): Bend(110, 0.6),
    },
    frame=(180, 24, 876, 312),
    ports={(FRAME, "gone"): ((388, 312), (388, 353)), ("gone", FRAME): ((472, 353), (472, 312))},
)
CAMPAIGN = Layout(
    size=(740, 290),
    places={
        "absent": (70, 110),
        "running": (270, 110),
        "complete": (470, 110),
        "closed": (670, 110),
        "answered": (170, 240),
        "going on": (370, 240),
        "spent": (570, 240),
    },
    bends={("running", "closed"): Bend(120, 0.5), ("going on", "spent"): Bend(45), ("spent", "going on"): Bend(45)},
)
LABELS = {
    ("Unwanted", "shunned"): "withdrawn",
    ("Delivered", "shunned"): "done elsewhere",
}
EARLIER = "an earlier test ends the problem"


def merged(transitions: Set[Transition]) -> dict[Pair, list[str]]:
    """Return the events of every arrow; events that all living workers share are one arrow at the frame."""
    found: dict[Pair, list[str]] = {}
    for before, event, after in sorted(transitions):
        pair = (before, after)
        if after == "gone" and {Transition(each, event, "gone") for each in KNOWN} <= transitions:
            pair = (FRAME, after)
        elif before == "gone" and {Transition("gone", event, each) for each in KNOWN} <= transitions and after in KNOWN:
            pair = (before, FRAME)
        label = LABELS.get((event, after), event)
        if label not in found.setdefault(pair, []):
            found[pair].append(label)
    return found


def texts() -> dict[str, str]:
    """Return file name and content of every diagram."""
    tests = merged(of_campaign())
    for before, _, after in BESIDE_CAMPAIGN - of_legal():
        tests[before, after] = [EARLIER]
    return {
        "rooms.svg": plan(source.FLOORS, source.parts),
        "dispatch.svg": svg(DISPATCH, merged(of_dispatch())),
        "campaign.svg": svg(CAMPAIGN, tests | merged(of_problem())),
    }
