"""Tables on a console: long names and numbers stay apart and whole."""

import io
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from perfbound.orchestrator.certificate.assumptions.statements import title
from perfbound.orchestrator.certificate.verify.checks import CHECKS, Checks
from perfbound.orchestrator.certificate.verify.run import Verification
from perfbound.orchestrator.certificate.verify.table import print_verification
from perfbound.orchestrator.certificate.words.text import print_list
from perfbound.orchestrator.fleet.children.simulate import column_lines
from perfbound.orchestrator.prepare.check_system.check import SystemCheck, print_findings
from perfbound.orchestrator.prepare.check_system.findings import SYSTEM_CHECKS, SystemFinding
from perfbound.orchestrator.report.rollout.comparison import Deviation, Difference, lines
from perfbound.orchestrator.run.display.progress_table import progress_table
from perfbound.schemas.result.certificate import Assumption
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.schemas.values import Bound, ProblemProgress
from tests.campaigns import config

NAMES = st.from_regex(r"[a-z][a-z_]{0,59}", fullmatch=True)
WORDS = st.text(st.characters(categories=["L"]), min_size=1, max_size=300)
STATUSES = st.sampled_from(["derived", "assumed", "not refuted", "refuted"])
LARGE = st.floats(min_value=-1e15, max_value=1e15)
PROGRESS = st.builds(
    ProblemProgress,
    tests=st.integers(0, 10**9),
    rollouts=st.integers(0, 10**12),
    F=LARGE,
    bound=st.builds(Bound, LARGE, LARGE, st.none()),
    stopped_by=st.sampled_from([None, "budget"]),
)


COLUMNS = (Column(name="t", unit="s"), Column(name="v", unit="m"))
CAMPAIGN = config("segway-paper")


def spec(columns: tuple[Column, ...]) -> SystemSpec:
    parameters = (Parameter(name="x", unit="m", low=0.0, high=1.0),)
    return SystemSpec(name="any", doc="", parameters=parameters, columns=columns, max_horizon=1.0)


def row_of(name: str, out: str) -> list[str]:
    """Return the words after `name` and a blank in its row."""
    return next(line for line in out.splitlines() if line.startswith(f"{name} ")).removeprefix(name).split()


def console(width: int = 100) -> tuple[Console, io.StringIO]:
    out = io.StringIO()
    return Console(file=out, width=width, soft_wrap=True), out


@given(name=NAMES, status=STATUSES)
def test_assumptions(name: str, status: Any) -> None:
    printer, out = console()
    print_list([Assumption(id=f"{name}/sim_gap", status=status, detail="Detail of it.")], printer)
    problem, head, detail = out.getvalue().splitlines()
    assert problem == "  sim_gap"
    assert head.split() == [*status.split(), *title(name).split(), f"({name})"]
    assert detail.split() == ["Detail", "of", "it."]


@given(progress=PROGRESS, left=st.sampled_from(["-", "about 999 h 59 min"]), width=st.integers(60, 200))
def test_progress(progress: ProblemProgress, left: str, width: int) -> None:
    printer, out = console(width)
    printer.print(progress_table(CAMPAIGN, [(progress, left)] * 2))
    rows = [line.ljust(width) for line in out.getvalue().splitlines()]
    borders = [k for k in range(width) if all(row[k] == " " for row in rows)]
    # The text of a column is that of its lines, one below the other.
    cells = ["".join(row[start + 1 : end] for row in rows) for start, end in pairwise([-1, *borders, width])]
    whole = ["".join(cell.split()) for cell in cells if cell.strip()]
    assert len(whole) >= 7, "a blank between each two of them"
    joined = " ".join(whole)
    for number in (f"{progress.F:.4f}", f"{progress.rollouts:,}", f"{progress.tests:,}"):
        assert number in joined, "whole, and not cut"


@given(
    names=st.lists(NAMES.filter(lambda name: name != "t"), min_size=2, max_size=4, unique=True),
    unit=NAMES,
    value=st.floats(-1e100, 1e100),
)
def test_columns(names: list[str], unit: str, value: float) -> None:
    names = ["t", *names]
    columns = tuple(Column(name=name, unit="s" if name == "t" else unit) for name in names)
    units = {each.name: each.unit for each in columns}
    trajectory = cast(Trajectory, SimpleNamespace(column=lambda _: np.full(2, value)))
    for line, name in zip(list(column_lines(spec(columns), trajectory))[1:], names, strict=True):
        assert line.split() == [name, units[name], *[f"{value:.6g}"] * 4]
    found = Deviation(bitwise=False, differences=tuple(Difference(name, value, value) for name in names))
    for line, name in zip(list(lines(found, units))[1:], names, strict=True):
        assert line.split() == [name, units[name], f"{value:.3g}", f"{value:.3f}"]


@given(name=st.sampled_from(sorted(CHECKS)), detail=WORDS)
def test_checks(name: str, detail: str) -> None:
    checks = Checks()
    checks.failed(name, detail)
    printer, out = console()
    print_verification(Verification(checks, None, None), printer)
    assert row_of(name, out.getvalue())[0] == "failed"


@given(check=st.sampled_from(sorted(SYSTEM_CHECKS)), detail=WORDS)
def test_findings(check: str, detail: str) -> None:
    finding = SystemFinding(check=check, status="failed", detail=detail)
    printer, out = console()
    print_findings(SystemCheck(spec(COLUMNS), 1.0, (finding,)), printer)
    assert row_of(check, out.getvalue())[0] == "failed"
