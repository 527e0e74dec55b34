"""The judgements of a gate for readers: a terminal, JUnit XML, SARIF 2.1.0, and Markdown for a pull request."""

import html
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from rich.console import Console
from rich.text import Text

from ....schemas import __version__
from ....schemas.amounts import counted
from ....schemas.errors import one_line
from ....schemas.file.reader import MAX_CAMPAIGN_FILE
from ....schemas.outside import read_outside
from ...certificate.words.console_lines import hanging, heading, plain_line
from .policy import ALLOWED
from .rules import Finding, Judgement

SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
COUNTEREXAMPLE, UNREADABLE = "counterexample", "unreadable"
OTHER_RULES = {
    COUNTEREXAMPLE: "a rollout of the campaign violates its specification",
    UNREADABLE: "a run directory has no certificate that can be read",
}
"""Of SARIF alone: what no key of a policy asks."""


def passed(judgements: Sequence[Judgement]) -> bool:
    """Whether every rule holds, and everything could be read."""
    return all(each.passed for each in judgements)


def print_judgements(judgements: Sequence[Judgement], console: Console) -> None:
    """Print a line for each rule that holds, three for one that does not, and the result last."""
    for each in judgements:
        plain_line(console, each.name, "bold")
        if each.fault:
            hanging(console, Text("  unreadable  ", "bold red"), each.fault)
        for finding in each.findings:
            style = "green" if finding.passed else "bold red"
            head = Text(f"  {'passed' if finding.passed else 'FAILED'}  {finding.rule:<12}  ", style)
            hanging(console, head, finding.found if finding.passed else f"expected {finding.expected}")
            if not finding.passed:
                hanging(console, Text(" " * 24), f"found {finding.found}")
                hanging(console, Text(" " * 24), f"to do: {finding.remedy}")
        if each.subject is not None and each.subject.campaign is None and not each.fault:
            hanging(console, Text(" " * 24), "No other rule was judged: nothing that is not verified counts.")
    heading(console, conclusion(judgements), "bold green" if passed(judgements) else "bold red")


def conclusion(judgements: Sequence[Judgement]) -> str:
    """Return the result, and how many rules fail where."""
    failed = sum(not finding.passed for each in judgements for finding in each.findings)
    unreadable = sum(bool(each.fault) for each in judgements)
    parts = [counted(failed, "rule") + (" fails" if failed == 1 else " fail")] if failed else []
    parts += [f"{counted(unreadable, 'certificate')} unreadable"] if unreadable else []
    total = sum(len(each.findings) for each in judgements)
    result = "PASSED" if passed(judgements) else "FAILED"
    return f"GATE {result}: {', '.join(parts) or counted(total, 'rule') + (' holds' if total == 1 else ' hold')}"


def to_junit(judgements: Sequence[Judgement]) -> str:
    """Return JUnit XML: a suite for each run directory, a case for each rule."""
    root = ElementTree.Element("testsuites", name="perfbound gate")
    for each in judgements:
        failures, errors = sum(not finding.passed for finding in each.findings), int(bool(each.fault))
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=one_line(each.name),
            tests=str(len(each.findings) + errors),
            failures=str(failures),
            errors=str(errors),
            skipped="0",
            time="0",
        )
        if each.fault:
            case = ElementTree.SubElement(suite, "testcase", classname=one_line(each.name), name=UNREADABLE, time="0")
            ElementTree.SubElement(case, "error", message=one_line(each.fault), type=UNREADABLE)
        for name, finding in _named(each.findings):
            case = ElementTree.SubElement(
                suite, "testcase", classname=one_line(each.name), name=one_line(name), time="0"
            )
            if not finding.passed:
                message = f"expected {finding.expected}; found {finding.found}"
                found = ElementTree.SubElement(case, "failure", message=one_line(message), type=finding.rule)
                found.text = f"{one_line(message)}\nto do: {one_line(finding.remedy)}"
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _named(findings: Sequence[Finding]) -> Iterator[tuple[str, Finding]]:
    """Yield the findings with names of their own: a rule that is asked of several things has one for each."""
    rules = [each.rule for each in findings]
    for each in findings:
        yield (each.rule if rules.count(each.rule) == 1 else f"{each.rule}: {each.expected}"), each


def to_markdown(judgements: Sequence[Judgement]) -> str:
    """Return a summary for a pull request: the result, and a table of the rules that fail."""
    lines = [f"### {conclusion(judgements)}", ""]
    rows = [(each, finding) for each in judgements for finding in each.findings if not finding.passed]
    if rows or any(each.fault for each in judgements):
        lines += ["| run | rule | expected | found | to do |", "|---|---|---|---|---|"]
        lines += [_row(each.name, UNREADABLE, "a certificate", each.fault, "") for each in judgements if each.fault]
        lines += [_row(each.name, of.rule, of.expected, of.found, of.remedy) for each, of in rows]
        lines += [""]
    for each in judgements:
        if each.subject is not None and (campaign := each.subject.campaign) is not None:
            lines.append(f"- {_cell(each.name)}: **{campaign.verdict.verdict}**, {_cell(campaign.verdict.claim)}")
    return "\n".join(lines) + "\n"


def _row(*cells: str) -> str:
    return f"| {' | '.join(map(_cell, cells))} |"


def _cell(text: str) -> str:
    """Return a text that neither ends a cell nor is a tag; what is between two backticks stays code.

    >>> print(_cell("a_b < 1: `at_most` | x"))
    a\\_b &lt; 1: `at_most` \\| x
    """
    parts = one_line(text).split("`")
    if len(parts) % 2 == 0:  # a backtick without its twin begins no code
        return "\\`".join(map(_marked, parts))
    return "`".join(part.replace("|", "\\|") if place % 2 else _marked(part) for place, part in enumerate(parts))


def _marked(text: str) -> str:
    escaped = html.escape(text, quote=False)
    return "".join(f"\\{each}" if each in "|*_[]\\" else each for each in escaped)


def to_sarif(judgements: Sequence[Judgement], campaigns: Sequence[Path]) -> str:
    """Return SARIF 2.1.0: each rule that fails, and each counterexample, with the line of its campaign file.

    `campaigns` are campaign files: that of a run is found by its name. Without one, a result is at the certificate.
    """
    places = {each.stem: each for each in campaigns}
    results = [result for each in judgements for result in _results(each, places)]
    descriptions = {**ALLOWED, **OTHER_RULES}
    used = sorted({str(each["ruleId"]) for each in results})
    driver = {
        "name": "perfbound gate",
        "version": __version__,
        "rules": [{"id": name, "shortDescription": {"text": descriptions[name]}} for name in used],
    }
    log = {"$schema": SARIF_SCHEMA, "version": "2.1.0", "runs": [{"tool": {"driver": driver}, "results": results}]}
    return json.dumps(log, indent=1, allow_nan=False) + "\n"


def _results(each: Judgement, places: dict[str, Path]) -> Iterator[dict[str, Any]]:
    if each.fault:
        yield _result(UNREADABLE, each.fault, each, places, "")
    for finding in each.findings:
        if not finding.passed:
            text = f"expected {finding.expected}; found {finding.found}; to do: {finding.remedy}"
            yield _result(finding.rule, text, each, places, "")
    campaign = None if each.subject is None else each.subject.campaign
    found = None if campaign is None else campaign.predicate.counterexample
    if campaign is not None and found is not None:
        start = ", ".join(f"{name} = {value:.6g}" for name, value in found.start.items())
        text = f"{found.rollout} violates the specification: robustness {found.robustness:.6g} at {start}"
        yield _result(COUNTEREXAMPLE, text, each, places, "specification")
    elif campaign is not None and campaign.verdict.violations.violations:
        seen = campaign.verdict.violations
        text = f"{seen.rollout} violates the specification: robustness {seen.least or 0.0:.6g}"
        yield _result(COUNTEREXAMPLE, text, each, places, "specification")


def _result(rule: str, text: str, each: Judgement, places: dict[str, Path], key: str) -> dict[str, Any]:
    campaign = None if each.subject is None else each.subject.campaign
    file = None if campaign is None else places.get(campaign.header.config.name)
    at, line = (file, _line_of(file, key)) if file is not None else (_certificate(each), 1)
    place = {"artifactLocation": {"uri": quote(at.as_posix())}, "region": {"startLine": line}}
    return {
        "ruleId": rule,
        "level": "error",
        "message": {"text": f"{each.name}: {text}"},
        "locations": [{"physicalLocation": place}],
    }


def _certificate(each: Judgement) -> Path:
    return each.subject.directory / "certificate.json" if each.subject is not None else Path("policy.toml")


def _line_of(file: Path, key: str) -> int:
    """Return the number of the line that begins with a key, or with a table of it; 1 where none does."""
    try:
        lines = read_outside(file, MAX_CAMPAIGN_FILE).decode(errors="replace").splitlines()
    except OSError:
        return 1
    return next((number for number, line in enumerate(lines, 1) if key and line.lstrip(" [").startswith(key)), 1)
