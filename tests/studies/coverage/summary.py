"""The generated parts of docs/coverage.md, from the records of the study: one CSV file a kind with every row.

A record has the columns of `page.TABLES`; `origins.csv` says when, how and of which code each was written.
"""

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tests.studies.coverage.oracle import LEVEL, at_most

RESULTS = Path(__file__).with_name("results")
ORIGINS = "origins.csv"
FIGURE = "images/coverage-audit.png"
PARTS = ("claims", "audit", "laws", "comparisons", "contrast")
"""The generated parts of the page."""

Line = Mapping[str, str]
"""One row of a record, by the titles of its columns."""


class RecordError(ValueError):
    """A record is missing, or not in the form of its kind."""


class Group(NamedTuple):
    """How the page sums up the rows of one kind."""

    method: str
    family: Callable[[Line], str]
    """Rows of one family and one stated probability are one row of the page."""
    claim: str
    """Title of the column that counts false claims."""
    judged: tuple[str, ...]
    """Titles of the columns of which none may have more than `allowed`."""
    loss: Callable[[Line], float] | None = None


def _noise(line: Line) -> str:
    if line["noise"] == "none":
        return "no noise"
    return "all noises" if line["claimed delta"] == "0.5" else line["noise"]


def _claim(line: Line) -> str:
    return line["claim"].split(",")[0]


def _worst(line: Line) -> str:
    return "flat functions" if line["worst starts"] == "flat" else "one start" if line["starts"] == "1" else "several"


def _number(title: str) -> Callable[[Line], float]:
    return lambda line: float(line[title].removesuffix(" %"))


GROUPS: dict[str, Group] = {
    "rigorous": Group("`rigorous`", _noise, "bound", ("any",), _number("mean U - L")),
    "regions": Group(
        "its regions",
        lambda line: "flat functions" if line["J"] == "0 everywhere" else "random functions",
        "any",
        ("any",),
    ),
    "composition": Group(
        "compositions",
        lambda line: f"{line['nominal']} nominal system",
        "pointwise",
        ("any",),
        _number("mean loss of pointwise ell"),
    ),
    "kriging": Group(
        "`kriging`",
        lambda line: "random functions" if line["mu"] == "random" else line["mu"],
        "bound",
        ("sum", "bound", "falsely refuted"),
        _number("mean loss of ell"),
    ),
    "controls": Group(
        "control, disturbances",
        lambda line: line["disturbances"],
        "bound",
        ("bound", "other side"),
        _number("mean loss"),
    ),
    "scenario": Group(
        "`scenario`",
        lambda line: line["distribution"],
        "ell",
        ("ell", "a bound of one start", "bound on the limit of ell"),
        _number("mean loss of ell"),
    ),
    "requirements": Group(
        "several requirements",
        lambda line: f"`{line['method']}`, {_worst(line)}",
        "every requirement",
        ("every requirement", "the first one", "the last one"),
    ),
    "sampling": Group("`sample`", _claim, "false", ("false",)),
    "comparison": Group("`perfbound compare`", lambda line: line["pairs with"], "false", ("false",)),
}
"""By kind, in the order of the page."""


def read(kind: str, results: Path = RESULTS) -> list[dict[str, str]]:
    """Return the rows of a kind's record.

    Raises:
        RecordError: there is none.

    """
    try:
        text = (results / f"{kind}.csv").read_text(encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{results}: no record of {kind}; run the study with --write") from error
    return list(csv.DictReader(io.StringIO(text)))


def csv_text(lines: Sequence[Line]) -> str:
    """Return rows as a record."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def part(name: str, results: Path = RESULTS) -> str:
    """Return one generated part of the page with its marks."""
    text = {"claims": _claims, "audit": _audit, "laws": _laws, "comparisons": _comparisons, "contrast": _contrast}[
        name
    ](results)
    begin, end = marks(name)
    return f"{begin}\n\n{text}\n\n{end}"


def marks(name: str) -> tuple[str, str]:
    """Return the lines of the page between which a part is written."""
    return f"<!-- {name}: begin -->", f"<!-- {name}: end -->"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown.

    >>> print(table(["a", "b"], [["1", ""]]))
    | a | b |
    |---|---|
    | 1 | |
    """
    lines = [re.sub(r"\|  (?=\|)", "| ", f"| {' | '.join(row)} |") for row in (head, *rows)]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:]])


def _claims(results: Path) -> str:
    head = ["bounds of", "stated %", "campaigns", "false", "at most %", "most in a row", "loss", "verdict"]
    found = {kind: read(kind, results) for kind in GROUPS}
    rows = [row for kind, lines in found.items() for row in _summed(GROUPS[kind], lines)]
    checks = sum(len(GROUPS[kind].judged) * len(lines) for kind, lines in found.items())
    dates = sorted(each["written"] for each in read("origins", results))
    return (
        f"{table(head, rows)}\n\n"
        f"{checks} comparisons at level {LEVEL:g}: with correct bounds one of them fails with probability below "
        f"{100 * checks * LEVEL:.2g} %.\n"
        f"Written from records of {dates[0]} to {dates[-1]}."
    )


def _summed(group: Group, lines: Sequence[Line]) -> Iterator[list[str]]:
    """Yield one row of the page for each family and stated probability, in the order of the record."""
    families = list(dict.fromkeys(map(group.family, lines)))
    keys = dict.fromkeys((group.family(line), line["claimed delta"]) for line in lines)
    for family, claimed in sorted(keys, key=lambda key: families.index(key[0])):
        chosen = [line for line in lines if (group.family(line), line["claimed delta"]) == (family, claimed)]
        campaigns, false = (sum(int(line[title]) for line in chosen) for title in ("campaigns", group.claim))
        most, limit = max((max(int(line[title]) for title in group.judged), int(line["allowed"])) for line in chosen)
        yield [
            f"{group.method}: {family}",
            f"{100 * float(claimed):g}",
            f"{campaigns:,}",
            f"{false}",
            f"{100 * at_most(false, campaigns):.2g}",
            f"{most}/{limit}",
            f"{sum(map(group.loss, chosen)) / len(chosen):.2f}".replace("-0.00", "0.00") if group.loss else "",
            "ok" if all(line["verdict"] == "ok" for line in chosen) else "**FAILS**",
        ]


KINDS = {"kriging": "`kriging`", "mean": "`sample`, mean"}
FACTORS = ("1.2", "1.25", "2", "4")
"""By which B is too small, in the table of the audit; the figure has more."""


def _audit(results: Path) -> str:
    head = ["method and noise", "B too small by", "B refuted %", "bound wrong %", "not refuted %"]
    own, weighted = read("audit", results), read("kriging-audit", results)
    rows = [
        (f"`rigorous`, R = {line['true R']}", line, "bound wrong and nothing refuted")
        for line in own
        if line["R too small by a factor"] == "1"
    ]
    rows += [(f"`kriging`, {line['rollouts']}", line, "bound wrong and B not refuted") for line in weighted]
    cells = [
        _plain([name, line["B too small by a factor"], line["B refuted"], line["bound wrong"], line[silent]])
        for name, line, silent in rows
        if line["B too small by a factor"] in FACTORS
    ]
    right = [line for line in (*own, *weighted) if line["verdict"] != "-"]
    verdict = "ok" if all(line["verdict"] == "ok" for line in right) else "**FAILS**"
    counts = {title: sum(_count(line, title) for line in right) for title in ("B refuted", "bound wrong")}
    spread = sum(_count(line, "R refuted (replicates)") for line in right if "R refuted (replicates)" in line)
    campaigns = sum(int(line["campaigns"]) for line in right)
    words = (
        f"With the right B and R, in {campaigns:,} campaigns, B was refuted {counts['B refuted']} times, "
        f"R {spread} times, and {counts['bound wrong']} bounds were wrong: {verdict}."
    )
    return f"{table(head, cells)}\n\n{words}\n\n![Power of the audit]({FIGURE})"


def _laws(results: Path) -> str:
    head = ["bound of", "true scale", "rollouts", "law refuted %", "bound wrong %", "not refuted %"]
    titles = ["law refuted", "bound wrong", "bound wrong and nothing refuted"]
    lines = read("law-audit", results)
    cells = [
        _plain(
            [
                KINDS[line["bounds of"]],
                line["true scale, of the declared one"],
                f"{int(line['rollouts']):,}",
                *(line[title] for title in titles),
            ]
        )
        for line in lines
        if line["verdict"] == "-"
    ]
    right = [line for line in lines if line["verdict"] != "-"]
    verdict = "ok" if all(line["verdict"] == "ok" for line in right) else "**FAILS**"
    counts = {title: sum(_count(line, title) for line in right) for title in ("law refuted", "bound wrong")}
    words = (
        f"With the right law, in {sum(int(line['campaigns']) for line in right):,} campaigns, it was refuted "
        f"{counts['law refuted']} times, and {counts['bound wrong']} bounds were wrong: {verdict}."
    )
    return f"{table(head, cells)}\n\n{words}"


def _count(line: Line, title: str) -> int:
    return round(float(line[title].removesuffix(" %")) / 100 * int(line["campaigns"]))


def _comparisons(results: Path) -> str:
    head = ["pairs with", "pairs", "comparisons", "false", "allowed", "means decided %", "t-test at the end %"]
    head.append("t-test, every 50 pairs %")
    tests = {line["pairs with"]: line for line in read("t-test", results)}
    titles = ["pairs with", "pairs", "campaigns", "false", "allowed", "means decided"]
    others = ["significant at the end", "significant at some look"]
    cells = [
        _plain(
            [*(line[title] for title in titles), *(tests.get(line["pairs with"], {}).get(each, "") for each in others)]
        )
        for line in read("comparison", results)
    ]
    return table(head, cells)


def _contrast(results: Path) -> str:
    head = ["claim", "sigma", "B too small by", "stated %", "false on the box %", "B refuted %", "stopped %"]
    titles = ["claim", "sigma", "B too small by a factor", "claimed to fail at most"]
    titles += ["false on the box", "B refuted", "stopped by F <= alpha"]
    lines = [line for line in read("paper", results) if line["B too small by a factor"] != "2"]
    return table(head, (_plain([line[title] for title in titles]) for line in lines))


def _plain(cells: Sequence[str]) -> list[str]:
    """Return cells without the sign of per cent, and without that of an empty cell.

    >>> _plain(["5.0 %", "-", "ok"])
    ['5.0', '', 'ok']
    """
    return [cell.removesuffix(" %") if cell != "-" else "" for cell in cells]
