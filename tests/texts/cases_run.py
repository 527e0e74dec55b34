"""What a run and `perfbound status` say before the end."""

import re
from pathlib import Path

from perfbound.orchestrator.certificate.words.known_text import holding_rows, so_far_line
from tests.fakes.simulators import simulate
from tests.texts import Cases
from tests.texts.cases_certificate import hurried
from tests.unit.run.display import test_so_far


def status(folder: Path) -> Cases:
    """Yield what holds so far, what is expected, and the lines of a terminal."""
    with hurried(folder):
        for name, after in _CUT_AFTER.items():
            config, function, noisy = test_so_far.CASES[name]
            test_so_far.cut(Path(name), config, function, after=after, noisy=noisy)
            found, output = test_so_far.shown(Path(name))
            yield f"{name}: a line of the terminal", so_far_line(found)
            yield f"{name}: rows", "\n".join(" | ".join(row) for row in holding_rows(found))
            yield f"{name}: status", _status(Path(name))
            for each, then in output.refutations:
                yield f"{name}: {each} is refuted", then
        config, function, noisy = test_so_far.CASES["exact"]
        simulate(Path("finished"), config, function, noisy=noisy)
        yield "a finished campaign: status", _status(Path("finished"))


_CUT_AFTER = {"rigorous": 60, "refuted": 40, "violated": 20, "exact": 6, "sample": 30, "kriging": 60}
"""Rollouts after which campaigns are stopped."""
_OF_THE_RUN = {
    r"run \w{16}": "run ID",
    r"[\d.,]+ rollouts/s": "N rollouts/s",
    r"\d+ s ago": "0 s ago",
    r"worker puppet.*\n": "",
}


def _status(directory: Path) -> str:
    text = test_so_far.in_words(directory)
    for pattern, other in _OF_THE_RUN.items():
        text = re.sub(pattern, other, text)
    return text
