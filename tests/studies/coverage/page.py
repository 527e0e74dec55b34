"""The study's tables, one line for each of its rows, its verdict, and the records that the page is written from."""

import datetime
import os
import platform
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.studies.coverage.oracle import LEVEL, allowed, at_most
from tests.studies.coverage.plot import power_curve
from tests.studies.coverage.records import DIRECTORY, Chunk, Row, code, read, together
from tests.studies.coverage.study import CHUNK
from tests.studies.coverage.summary import FIGURE, ORIGINS, PARTS, RESULTS, RecordError, csv_text, marks, part
from tests.studies.coverage.summary import read as read_record
from tests.studies.pages import PageError, page_text, with_part

JUDGED: dict[str, tuple[str, ...]] = {
    "rigorous": ("failed",),
    "scenario": ("ell", "each", "upper"),
    "sampling": ("false",),
    "composition": ("failed",),
    "regions": ("failed",),
    "requirements": ("every", "first", "last"),
    "kriging": ("sum", "bound", "refuted"),
    "controls": ("lower", "upper"),
    "audit": ("refuted", "spread"),
    "kriging-audit": ("bound", "refuted"),
    "law-audit": ("bound", "norm", "law"),
    "comparison": ("false",),
    "t-test": (),
    "paper": (),
}
"""The statements of a kind that must not fail more often than claimed; `failed` is any of the others."""


class Found(NamedTuple):
    """A row with what its campaigns found."""

    row: Any  # one of the rows' classes; the columns of its kind know which
    results: Chunk

    @property
    def campaigns(self) -> int:
        return len(next(iter(self.results.values()), ()))

    def count(self, name: str) -> int:
        return int(sum(self.results[name]))

    def mean(self, name: str) -> float:
        return float(np.mean(self.results[name]))

    @property
    def allowed(self) -> int:
        return self.limit("")

    def limit(self, name: str) -> int:
        """Return how often a statement may be false: by its own level, if it has one."""
        return allowed(self.campaigns, getattr(self.row, "levels", {}).get(name, self.row.claimed))

    @property
    def judged(self) -> tuple[str, ...]:
        """Requirement on this row: nothing where the premises are wrong on purpose."""
        wrong = any(getattr(self.row, name, 1.0) != 1.0 for name in ("small_b", "small_r", "law_scale"))
        return () if wrong else JUDGED[self.row.kind]

    @property
    def fails(self) -> bool:
        return any(self.count(name) > self.limit(name) for name in self.judged)


Column = tuple[str, Callable[[Found], str]]


def _of(attribute: str) -> Callable[[Found], str]:
    return lambda found: f"{getattr(found.row, attribute):g}" if attribute != "noise" else found.row.noise


def _sum(name: str) -> Callable[[Found], str]:
    return lambda found: str(found.count(name))


def _mean(name: str, digits: int = 2) -> Callable[[Found], str]:
    return lambda found: f"{found.mean(name):.{digits}f}"


def _share(name: str) -> Callable[[Found], str]:
    return lambda found: f"{100 * found.mean(name):.1f} %"


def _verdict(found: Found) -> str:
    return "**FAILS**" if found.fails else "ok"


def _claimed(found: Found) -> str:
    return f"{found.row.claimed:.3g}"


CAMPAIGNS: Column = ("campaigns", lambda found: str(found.campaigns))
LIMIT: Column = ("allowed", lambda found: str(found.allowed))
RULED: list[Column] = [LIMIT, ("verdict", _verdict)]
PLACE: list[Column] = [("domain", lambda found: found.row.place), ("dimension", _of("dimension")), ("nu", _of("nu"))]

TABLES: dict[str, tuple[str, list[Column]]] = {
    "rigorous": (
        "Method `rigorous`: campaigns in which a statement was ever false",
        [
            *PLACE,
            ("noise", lambda found: found.row.noise if found.row.noise_scale else "none"),
            ("R", _of("noise_scale")),
            ("window", _of("window")),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("set", _sum("set")),
            ("band", _sum("band")),
            ("bound", _sum("bound")),
            ("falsely refuted", _sum("refuted")),
            ("any", _sum("failed")),
            *RULED,
            ("converged", _sum("converged")),
            ("mean tests", _mean("tests", 1)),
            ("mean U - L", _mean("width")),
        ],
    ),
    "scenario": (
        "Method `scenario`: campaigns in which a statement was ever false",
        [
            ("distribution", lambda found: found.row.law),
            ("starts", lambda found: f"{found.row.size}{' equal' if found.row.tied and found.row.size > 1 else ''}"),
            ("risk bound", lambda found: found.row.risk),
            ("window", _of("window")),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("ell", _sum("ell")),
            ("a bound of one start", _sum("each")),
            ("bound on the limit of ell", _sum("upper")),
            *RULED,
            ("converged", _sum("converged")),
            ("mean tests", _mean("tests", 1)),
            ("mean loss of ell", _mean("width", 3)),
        ],
    ),
    "sampling": (
        "Method `sample`: campaigns in which a bound was ever false, or false at its fixed number of samples",
        [
            ("claim", lambda found: found.row.claim),
            ("distribution", lambda found: found.row.law),
            (
                "level",
                lambda found: f"{found.row.level:g}" if found.row.claim.startswith(("qu", "CV", "share")) else "-",
            ),
            ("factor", lambda found: f"{found.row.ratio:g}"),
            ("samples", _of("samples")),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("false", _sum("false")),
            *RULED,
            ("median loss", lambda found: f"{np.median(found.results['width']):.3g}"),
        ],
    ),
    "composition": (
        "Compositions of `rigorous` problems: campaigns in which ell was ever above the true risk",
        [
            *PLACE,
            ("nominal", lambda found: "noisy" if found.row.noisy_nominal else "exact"),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("sum (Popoviciu)", _sum("popoviciu")),
            ("Bhatia-Davis", _sum("extremes")),
            ("pointwise", _sum("pointwise")),
            ("falsely refuted", _sum("refuted")),
            ("any", _sum("failed")),
            *RULED,
            ("mean loss of pointwise ell", _mean("width", 3)),
        ],
    ),
    "regions": (
        "Regions of `rigorous`: campaigns in which a certified box was ever false",
        [
            ("dimension", _of("dimension")),
            ("nu", _of("nu")),
            ("J", lambda found: "0 everywhere" if found.row.flat else "random"),
            ("noise", lambda found: found.row.noise if found.row.noise_scale else "none"),
            ("R", _of("noise_scale")),
            ("t", _of("unsafe_above")),
            ("window", _of("window")),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("false safe box", _sum("safe")),
            ("false unsafe box", _sum("unsafe")),
            ("falsely refuted", _sum("refuted")),
            ("any", _sum("failed")),
            *RULED,
            ("mean tests", _mean("tests", 1)),
            ("mean share of D certified", _share("decided")),
        ],
    ),
    "requirements": (
        "Several requirements from one design: campaigns in which a claim was ever false",
        [
            ("method", lambda found: found.row.method),
            ("distribution or noise", lambda found: found.row.law),
            ("requirements", _of("number")),
            ("scales", lambda found: "equal" if found.row.scale == 1 else f"factor {found.row.scale:g}"),
            ("starts", lambda found: f"{found.row.size}"),
            ("worst starts", lambda found: found.row.worst if found.row.size > 1 else "-"),
            ("rollouts", lambda found: "same randomness" if found.row.shared else "independent"),
            ("window", _of("window")),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("every requirement", _sum("every")),
            ("the first one", _sum("first")),
            ("the last one", _sum("last")),
            *RULED,
            ("converged", _sum("converged")),
            ("mean tests", _mean("tests", 1)),
        ],
    ),
    "kriging": (
        "Method `kriging`: campaigns in which a statement was ever false",
        [
            ("mu", lambda found: "m0 - B everywhere" if found.row.flat else "random"),
            ("rollouts", lambda found: found.row.noise),
            ("starts", lambda found: found.row.order),
            ("tests", lambda found: f"{found.row.tests} of {found.row.replicates}"),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("sum", _sum("sum")),
            ("bound", _sum("bound")),
            ("falsely refuted", _sum("refuted")),
            *RULED,
            ("mean loss of ell", _mean("width", 3)),
        ],
    ),
    "controls": (
        "Bounds with a control of declared disturbances: campaigns in which a statement was ever false",
        [
            ("bounds of", lambda found: found.row.bounds),
            ("disturbances", lambda found: found.row.disturbances),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("bound", _sum("lower")),
            ("other side", _sum("upper")),
            *RULED,
            ("control at the end", _share("used")),
            ("mean loss", _mean("width", 4)),
        ],
    ),
    "audit": (
        "The audit of `rigorous`: false alarms in the rows with B and R right, power in the others",
        [
            ("true R", _of("noise_scale")),
            ("B too small by a factor", _of("small_b")),
            ("R too small by a factor", _of("small_r")),
            CAMPAIGNS,
            ("B refuted", _share("refuted")),
            ("R refuted (replicates)", _share("spread")),
            ("bound wrong", _share("bound")),
            ("bound wrong and nothing refuted", _share("unnoticed")),
            ("mean tests", _mean("tests", 1)),
            ("allowed", lambda found: str(found.allowed) if found.judged else "-"),
            ("verdict", lambda found: _verdict(found) if found.judged else "-"),
        ],
    ),
    "kriging-audit": (
        "The audit of `kriging`: false alarms in the rows with B right, power in the others",
        [
            ("rollouts", lambda found: found.row.noise),
            ("B too small by a factor", _of("small_b")),
            CAMPAIGNS,
            ("B refuted", _share("refuted")),
            ("bound wrong", _share("bound")),
            ("bound wrong and B not refuted", _share("unnoticed")),
            ("mean loss of ell", _mean("width", 3)),
            ("allowed", lambda found: str(found.allowed) if found.judged else "-"),
            ("verdict", lambda found: _verdict(found) if found.judged else "-"),
        ],
    ),
    "law-audit": (
        "The test of a declared law: false alarms in the rows with the right scale, power in the others",
        [
            ("bounds of", lambda found: found.row.bounds),
            ("true scale, of the declared one", _of("law_scale")),
            ("rollouts", _of("rollouts")),
            CAMPAIGNS,
            ("law refuted", _share("law")),
            ("B refuted", _share("norm")),
            ("bound wrong", _share("bound")),
            ("bound wrong and nothing refuted", _share("unnoticed")),
            ("mean loss", _mean("width", 4)),
            ("allowed", lambda found: str(found.allowed) if found.judged else "-"),
            ("verdict", lambda found: _verdict(found) if found.judged else "-"),
        ],
    ),
    "comparison": (
        "`perfbound compare`: comparisons in which an interval was ever false",
        [
            ("pairs with", lambda found: found.row.law),
            ("pairs", _of("pairs")),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("false", _sum("false")),
            *RULED,
            ("means decided", _share("decided")),
            ("mean width of the mean's", _mean("width", 4)),
        ],
    ),
    "t-test": (
        "Contrast, not judged: Welch's t-test of two equal systems",
        [
            ("pairs with", lambda found: found.row.law),
            ("pairs", _of("pairs")),
            ("claimed delta", _claimed),
            CAMPAIGNS,
            ("significant at the end", _share("once")),
            ("significant at some look", _share("peeking")),
        ],
    ),
    "paper": (
        "Contrast, not judged: method `paper`",
        [
            ("claim", lambda found: "rho* >= ell, product" if found.row.composed else "J* <= eps"),
            ("sigma", lambda found: found.row.sigma),
            ("B too small by a factor", _of("small_b")),
            CAMPAIGNS,
            ("claimed to fail at most", lambda found: f"{100 * found.row.claimed:.1f} %"),
            ("false on the lattice", _share("nodes")),
            ("false on the box", _share("bound")),
            ("B refuted", _share("refuted")),
            ("false on the box and B not refuted", _share("unnoticed")),
            ("stopped by F <= alpha", _share("converged")),
            ("mean tests", _mean("tests", 1)),
        ],
    ),
}


def collect(rows: Sequence[Row], campaigns: int, directory: Path = DIRECTORY) -> list[Found]:
    """Return what is there of every row, up to `campaigns` rounded up to chunks; rows without any are left out."""
    count = -(-campaigns // CHUNK)
    found = [Found(row, together(read(row, directory), count)) for row in rows]
    return [each for each in found if each.campaigns]


def tables(found: Sequence[Found]) -> str:
    """Return the tables of every kind with results."""
    return "\n\n".join(text for _, text in _by_kind(found)) + "\n"


def _by_kind(found: Sequence[Found]) -> Iterator[tuple[str, str]]:
    """Yield each kind with results and its tables: its rows, and the sums of those that are judged."""
    for kind, (title, columns) in TABLES.items():
        chosen = [each for each in found if each.row.kind == kind]
        if chosen:
            parts = [f"### {title}", _table(columns, chosen)]
            parts += [_sums(chosen)] if any(each.judged for each in chosen) else []
            yield kind, "\n\n".join(parts)


def write(page: Path, found: Sequence[Found], results: Path = RESULTS) -> None:
    """Write the record of each kind with results, the parts of `page` from all records, and the figure of the audit.

    Kinds without results keep their records.

    Raises:
        PageError: the page cannot be read, or has no marks for a part; or a record is missing.

    """
    text = page_text(page, *map(marks, PARTS))
    record(found, results)
    try:
        for name in PARTS:
            text = with_part(text, *marks(name), part(name, results))
    except RecordError as error:
        raise PageError(str(error)) from error
    page.write_text(text, encoding="utf-8")
    if audits := [(each.row, each.results) for each in found if each.row.kind == "audit"]:
        power_curve(audits, page.parent / FIGURE)


def record(found: Sequence[Found], results: Path) -> None:
    """Write the record of each kind with results, and its origin."""
    results.mkdir(parents=True, exist_ok=True)
    origins = {line["kind"]: line for line in read_record("origins", results)} if (results / ORIGINS).exists() else {}
    for kind, (_, columns) in TABLES.items():
        chosen = [each for each in found if each.row.kind == kind]
        if chosen:
            lines = [{title: cell(each) for title, cell in columns} for each in chosen]
            (results / f"{kind}.csv").write_text(csv_text(lines), encoding="utf-8")
            origins[kind] = _origin(kind)
    ordered = [origins[kind] for kind in TABLES if kind in origins]
    (results / ORIGINS).write_text(csv_text(ordered), encoding="utf-8")


def _sums(found: Sequence[Found]) -> str:
    """Return the failures over all judged rows of one kind with a claim of the same size."""
    lines = [
        "| all rows together | claimed delta | rows | campaigns | statements false | share | 95 % upper limit |",
        "|" + "---|" * 7,
    ]
    judged = [each for each in found if each.judged]
    for kind, claimed in sorted({(each.row.kind, each.row.claimed) for each in judged}):
        rows = [each for each in judged if (each.row.kind, each.row.claimed) == (kind, claimed)]
        campaigns = sum(each.campaigns for each in rows)
        for name in JUDGED[kind]:
            failures = sum(each.count(name) for each in rows)
            limit = at_most(failures, campaigns)
            cells = (f"{kind}: {NAMES[kind, name]}", f"{claimed:g}", len(rows), campaigns, failures)
            shares = (f"{100 * failures / campaigns:.2f} %", f"{100 * limit:.2f} %")
            lines.append("| " + " | ".join(str(cell) for cell in (*cells, *shares)) + " |")
    checks = sum(len(each.judged) for each in judged)
    rule = f"{checks} comparisons at level {LEVEL:g}: with correct bounds one of them fails with probability below "
    return "\n".join([*lines, "", f"{rule}{100 * checks * LEVEL:.2g} %."])


NAMES = {
    ("rigorous", "failed"): "set, band, bound or refutation",
    ("scenario", "ell"): "ell",
    ("scenario", "each"): "a bound of one start",
    ("scenario", "upper"): "bound on the limit of ell",
    ("sampling", "false"): "bound",
    ("comparison", "false"): "interval",
    ("composition", "failed"): "any rule, or refutation",
    ("regions", "failed"): "box or refutation",
    ("requirements", "every"): "every requirement",
    ("requirements", "first"): "the first one",
    ("requirements", "last"): "the last one",
    ("kriging", "sum"): "sum of rollouts",
    ("kriging", "bound"): "bound",
    ("kriging", "refuted"): "false alarm about B",
    ("controls", "lower"): "bound",
    ("controls", "upper"): "bound from the other side",
    ("audit", "refuted"): "false alarm about B",
    ("audit", "spread"): "false alarm about R",
    ("kriging-audit", "bound"): "bound",
    ("kriging-audit", "refuted"): "false alarm about B",
    ("law-audit", "bound"): "bound",
    ("law-audit", "norm"): "false alarm about B",
    ("law-audit", "law"): "false alarm about the law",
}


def _table(columns: Sequence[Column], found: Sequence[Found]) -> str:
    lines = [[title for title, _ in columns], ["---"] * len(columns)]
    lines += [[cell(each) for _, cell in columns] for each in found]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _origin(kind: str) -> dict[str, str]:
    return {
        "kind": kind,
        "written": f"{datetime.datetime.now(datetime.UTC).date()}",
        "command": shlex.join(["python", "-m", "tests.studies.coverage", *sys.argv[1:]]),
        "cores": f"{os.cpu_count()}",
        "load": f"{os.getloadavg()[0]:.1f}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "code": code(kind),
    }
