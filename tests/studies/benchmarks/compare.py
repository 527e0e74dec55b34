"""`make bench-compare OLD=a.json NEW=b.json`: two results side by side; changes beyond 20 % are flagged."""

import json
import sys
from pathlib import Path
from typing import Any

from tests.studies.benchmarks.report import number

NOTABLE = 0.2
USAGE = "usage: make bench-compare OLD=a.json NEW=b.json (files that make bench has written: build/bench.json)"


class NotAResultError(Exception):
    """A file is not from `make bench`; the text names the file, the reason and the remedy."""


def load(path: Path) -> dict[str, Any]:
    """Return the document in `path`.

    Raises:
        NotAResultError: it cannot be read, or is something else.

    """
    try:
        found = json.loads(path.read_text())
        if all({"name", "value", "unit", "more_is_better"} <= row.keys() for row in found["rows"]):
            return dict(found)
    except OSError as error:
        raise NotAResultError(f"{path}: {error.strerror}; name a file that `make bench` has written") from None
    except (ValueError, TypeError, KeyError, AttributeError):
        pass
    raise NotAResultError(f"{path}: not a result of `make bench`; name a file that it has written")


def flag(old: float, new: float, *, more_is_better: bool) -> str:
    """Return `better` or `WORSE` for a change by more than a fifth, in either direction, else nothing.

    >>> flag(1.0, 1.3, more_is_better=False), flag(1.0, 0.7, more_is_better=False), flag(1.0, 1.1, more_is_better=True)
    ('WORSE', 'better', '')
    """
    if max(old, new) <= (1 + NOTABLE) * min(old, new):
        return ""
    return "better" if (new > old) == more_is_better else "WORSE"


def lines(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return the table: old, new, new/old, flag; rows that only one of them has are named."""
    before, after = ({row["name"]: row for row in each["rows"]} for each in (old, new))
    found = [_line("measured", "old", "new", "new/old", "")]
    for name, row in after.items():
        if name in before:
            found.append(_compared(before[name], row))
    found += [f"only in the old result: {name}" for name in before if name not in after]
    return found + [f"only in the new result: {name}" for name in after if name not in before]


def heads(name: str, result: dict[str, Any]) -> str:
    """Return where and when a result was measured."""
    return f"{name}: commit {str(result.get('commit'))[:12]}, {result.get('date')}, load {result.get('load')}"


def _compared(old: dict[str, Any], new: dict[str, Any]) -> str:
    ratio = f"{new['value'] / old['value']:.2f}" if old["value"] else "-"
    verdict = flag(old["value"], new["value"], more_is_better=new["more_is_better"])
    return _line(f"{new['name']} [{new['unit']}]", number(old["value"]), number(new["value"]), ratio, verdict)


def _line(name: str, old: str, new: str, ratio: str, verdict: str) -> str:
    return f"{name:75s} {old:>10s} {new:>10s} {ratio:>8s}  {verdict}".rstrip()


def main(arguments: list[str]) -> int:
    """Print the comparison and return the exit code."""
    if len(arguments) != 2:
        sys.stderr.write(USAGE + "\n")
        return 2
    try:
        old, new = (load(Path(argument)) for argument in arguments)
    except NotAResultError as error:
        sys.stderr.write(f"bench-compare: {error}\n")
        return 1
    sys.stdout.write("\n".join([heads("old", old), heads("new", new), "", *lines(old, new)]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
