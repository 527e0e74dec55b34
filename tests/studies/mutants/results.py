"""Mutants, what became of them, and the share that was caught; one JSON line a judgement, so a killed run continues."""

import hashlib
import json
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

EQUIVALENT = Path(__file__).with_name("equivalent.toml")
CAUGHT, TIMED_OUT, SURVIVED = "caught", "timed out", "survived"
SHOWN = 110


@dataclass(frozen=True)
class Mutant:
    """A changed module."""

    path: str
    line: int
    was: str
    becomes: str
    text: str
    """Of the whole module."""

    @property
    def key(self) -> str:
        """What its judgements are found by: its text, so another version of the module is another mutant."""
        return hashlib.sha256(f"{self.path}\n{self.text}".encode()).hexdigest()[:16]

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {_short(self.was)}  ->  {_short(self.becomes)}"


@dataclass(frozen=True)
class Judgement:
    """What the tests of one stage said of a mutant."""

    mutant: str
    stage: int
    outcome: str
    test: str
    """That failed first; empty if none did, or if pytest did not come so far."""
    seconds: float
    tree: str
    """Digest of product and tests."""


@dataclass(frozen=True)
class Equivalent:
    """A mutant that no test can notice."""

    file: str
    was: str
    becomes: str
    reason: str


def judgements(path: Path, tree: str) -> dict[str, list[Judgement]]:
    """Return the judgements that still hold, by mutant: a survivor is judged again once product or tests differ."""
    found: dict[str, list[Judgement]] = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            each = Judgement(**json.loads(line))
        except (ValueError, TypeError):
            continue  # the last line of a killed run
        if each.outcome != SURVIVED or each.tree == tree:
            found.setdefault(each.mutant, []).append(each)
    return found


def append(path: Path, judgement: Judgement) -> None:
    """Write a judgement; a line that a kill has cut off ends first."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cut = path.exists() and not path.read_bytes().endswith(b"\n")
    with path.open("a") as file:
        file.write("\n" * cut + json.dumps(asdict(judgement)) + "\n")


def equivalents(path: Path = EQUIVALENT) -> list[Equivalent]:
    """Return the mutants that are not counted."""
    return [Equivalent(**each) for each in tomllib.loads(path.read_text()).get("equivalent", [])]


def is_equivalent(mutant: Mutant, listed: Iterable[Equivalent]) -> bool:
    """Whether a mutant is in the list."""
    return any((each.file, each.was, each.becomes) == (mutant.path, mutant.was, mutant.becomes) for each in listed)


def line(mutant: Mutant, found: Sequence[Judgement], last: int) -> str:
    """Return the line of a mutant, whose tests end with stage `last`."""
    return f"{mutant}: {_verdict(found, last)}"


def share(mutants: Sequence[Mutant], found: Mapping[str, Sequence[Judgement]], last: int) -> str:
    """Return the last line: how many of the mutants were caught, and by which stage."""
    ends = [_end(found.get(each.key, ()), last) for each in mutants]
    stages = Counter(each.stage for each in ends if each is not None and each.outcome != SURVIVED)
    judged, caught = sum(each is not None for each in ends), stages.total()
    parts = [f"{number} in stage {stage}" for stage, number in sorted(stages.items())]
    parts += [f"{len(ends) - judged} not judged yet"] if judged < len(ends) else []
    # Those that are caught are judged sooner: a share of the judged ones alone would be too good.
    percent = f" ({100 * caught / judged:.0f} %)" if judged and judged == len(ends) else ""
    return f"caught: {caught} of {len(ends)}{percent}" + (f"; {', '.join(parts)}" if parts else "")


def _end(found: Sequence[Judgement], last: int) -> Judgement | None:
    """Return the judgement that decides: the first that caught the mutant, else that of the last stage."""
    caught = [each for each in found if each.outcome != SURVIVED and each.stage <= last]
    survived = [each for each in found if each.outcome == SURVIVED and each.stage == last]
    return min(caught, key=lambda each: each.stage, default=None) or next(iter(survived), None)


def _verdict(found: Sequence[Judgement], last: int) -> str:
    end = _end(found, last)
    if end is None:
        return "not judged yet"
    if end.outcome == SURVIVED:
        return f"SURVIVED, up to stage {last}"
    by = f" by {end.test}" if end.test else ""
    return f"{end.outcome} in stage {end.stage}{by} ({end.seconds:.0f} s)"


def _short(text: str) -> str:
    text = text or "(nothing)"
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."
