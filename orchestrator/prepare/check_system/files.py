"""Findings about the files that rollouts read: whether they are part of the system."""

from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import PurePosixPath

from ....schemas.file.toml_text import toml_value
from .findings import SystemFinding, passed, warning
from .measurements import Measurements

MOST_NAMED = 20
MOST_OF_FOLDER = 4
"""Files of a folder that are declared one by one; of more, the folder is declared."""


def judge_files(measurements: Measurements) -> SystemFinding | None:
    """Judge whether the system declares every file that its rollouts read."""
    if not measurements.rolled:
        return None
    runs = [{name for each in run.measured for name in each.undeclared} for run in measurements.runs if run.measured]
    seen = Counter(name for run in runs for name in run)
    # Each start is simulated in two processes. What only one has read may have been opened by some other program.
    found = sorted(name for name, count in seen.items() if count >= min(2, len(runs)))
    packages = sorted({name for run in measurements.runs for each in run.measured for name in each.packages})
    if packages and not found:
        return warning(
            "files",
            f"packages that rollouts import, and that are no part of the system: {', '.join(packages[:MOST_NAMED])}",
            "import them at the top of the file of the system, so that another version is refused by its name",
        )
    if not found:
        unseen = "; what the program opens elsewhere was not looked at" if measurements.program else ""
        return passed("files", f"every file that was read is part of the system{unseen}")
    more = f" and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
    listed = f"{', '.join(found[:MOST_NAMED])}{more}"
    return warning(
        "files",
        f"read while rollouts ran, and no part of the system: {listed}",
        f"declare what decides a rollout, so that a changed file is refused by its name: {declaration(found)}, in the "
        "decorator or class, or under [system] of the campaign file",
    )


def declaration(names: Iterable[str]) -> str:
    """Return the line that makes files part of a system.

    >>> declaration(["t/1", "t/2", "t/3", "t/4", "t/5", "w.pt"])
    'files = ["t", "w.pt"]'
    """
    return f"files = {toml_value(list(to_declare(names)))}"


def to_declare(names: Iterable[str]) -> tuple[str, ...]:
    """Return files as a system declares them: of many in one folder below it, the folder."""
    folders: dict[str, list[str]] = defaultdict(list)
    for name in sorted(names):
        folders[str(PurePosixPath(name).parent)].append(name)
    # The folder of the system itself has more than its files, and so may have one elsewhere.
    whole = {
        folder: len(files) > MOST_OF_FOLDER and not folder.startswith((".", "/")) for folder, files in folders.items()
    }
    return tuple(sorted(each for folder, files in folders.items() for each in ([folder] if whole[folder] else files)))
