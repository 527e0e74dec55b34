"""The two diagrams: where their boxes stand, and what their arrows say."""

from collections.abc import Set
from pathlib import Path

from perfbound.orchestrator.fleet.dispatch import KNOWN
from tests.architecture.drawing import FRAME, Bend, Layout, Pair, svg
from tests.architecture.transitions import BESIDE_CAMPAIGN, Transition, of_campaign, of_dispatch, of_legal

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
    size=(740, 150),
    places={"absent": (70, 110), "running": (270, 110), "complete": (470, 110), "closed": (670, 110)},
    bends={("running", "closed"): Bend(120, 0.5)},
)
SAID = {
    ("Unwanted", "shunned"): "withdrawn",
    ("Delivered", "shunned"): "done elsewhere",
}
EARLIER = "an earlier test ends the problem"


def merged(transitions: Set[Transition]) -> dict[Pair, list[str]]:
    """Return the events of every arrow; what all living workers share is one arrow at the frame."""
    found: dict[Pair, list[str]] = {}
    for before, event, after in sorted(transitions):
        pair = (before, after)
        if after == "gone" and {Transition(each, event, "gone") for each in KNOWN} <= transitions:
            pair = (FRAME, after)
        elif before == "gone" and {Transition("gone", event, each) for each in KNOWN} <= transitions and after in KNOWN:
            pair = (before, FRAME)
        said = SAID.get((event, after), event)
        if said not in found.setdefault(pair, []):
            found[pair].append(said)
    return found


def texts() -> dict[str, str]:
    """Return file name and content of both diagrams."""
    tests = merged(of_campaign())
    for before, _, after in BESIDE_CAMPAIGN - of_legal():
        tests[before, after] = [EARLIER]
    return {"dispatch.svg": svg(DISPATCH, merged(of_dispatch())), "campaign.svg": svg(CAMPAIGN, tests)}
