"""The argument of a safety case in the Goal Structuring Notation: its elements, and their file in YAML.

The file has the form that the tools gsn2x and others read: an element by its id, whose first letters are its kind, with
`text`, `supportedBy` and `inContextOf`.

| id | kind          | here                                                               |
|----|---------------|--------------------------------------------------------------------|
| G  | goal          | the verdict; a claim; the status of the assumptions; the evidence  |
| S  | strategy      | how the goals below it add up                                      |
| Sn | solution      | a part of the certificate, of its verification or of its envelope  |
| C  | context       | the system, the domain, the requirements                           |
| A  | assumption    | one that no data of the campaign test, with who can judge it       |
| J  | justification | what follows from the method                                       |
"""

import json
import re
from dataclasses import dataclass
from typing import Literal

from .case import AssumptionText, Named, SafetyCase

Kind = Literal["G", "S", "Sn", "C", "A", "J"]
MOST_CLAIMS = 3
"""Claims with a goal of their own; the certificate has all."""
MOST_LINES = 8
"""Of a table that an element shows."""


@dataclass(frozen=True, slots=True)
class Element:
    """One element of an argument."""

    id: str
    text: str
    supported_by: tuple[str, ...] = ()
    in_context_of: tuple[str, ...] = ()
    undeveloped: bool = False
    """Whether the argument below it is missing."""
    refuted: bool = False
    """Whether it is marked: refuted, or a violation."""

    @property
    def kind(self) -> Kind:
        """Of the id."""
        kinds: tuple[Kind, ...] = ("Sn", "G", "S", "C", "A", "J")
        return next(kind for kind in kinds if self.id.startswith(kind))


def argument(case: SafetyCase) -> tuple[Element, ...]:
    """Return the elements of the argument, the top goal first."""
    shown = _goals(case)
    claims = [f"G{2 + k}" for k in range(len(shown))]
    tested, traced, known = (f"G{2 + len(claims) + k}" for k in range(3))
    assumed = [Element(f"A{k}", _assumed(each)) for k, each in enumerate(case.with_status("assumed"), 1)]
    refuted = case.with_status("refuted")
    return (
        Element("G1", case.answer, ("S1",), ("C1", "C2", "C3"), refuted=case.verdict == "VIOLATED"),
        Element("C1", _table("System", case.system)),
        Element("C2", _table("Operational design domain, as far as simulated", case.domain)),
        Element("C3", _table("Requirements", case.requirements)),
        Element(
            "S1",
            "Argue over the claims of the certificate, the assumptions on which they rest, and its evidence",
            (*claims, tested, traced, known),
            (*(each.id for each in assumed), "J1"),
        ),
        *assumed,
        Element("J1", _derived(case)),
        *(
            Element(name, text, (f"Sn{number}",), refuted=refuted)
            for number, (name, (text, refuted, _)) in enumerate(zip(claims, shown, strict=True), 1)
        ),
        Element(tested, _tested(case), (f"Sn{len(claims) + 1}",), refuted=bool(refuted)),
        Element(traced, "The certificate follows from the recorded rollouts", (f"Sn{len(claims) + 2}",)),
        Element(
            known,
            "The certificate has a valid signature by a named key",
            (f"Sn{len(claims) + 3}",) if case.signed else (),
            undeveloped=not case.signed,
        ),
        *(
            Element(f"Sn{number}", f"certificate.json: {how}, {case.rollouts:,} rollouts")
            for number, (_, _, how) in enumerate(shown, 1)
        ),
        Element(f"Sn{len(claims) + 1}", _tests_made(case)),
        Element(f"Sn{len(claims) + 2}", re.split("[.;] ", case.verification)[0]),
        *([Element(f"Sn{len(claims) + 3}", _signers(case))] if case.signed else []),
    )


def _signers(case: SafetyCase) -> str:
    # The beginning of a key is enough where the document has all of it.
    return re.sub(r"([0-9a-f]{16})[0-9a-f]{48}", r"\1...", " ".join(case.signatures))


def _goals(case: SafetyCase) -> list[tuple[str, bool, str]]:
    """Return the goals about what is shown, whether each is marked, and how it is shown.

    What rollouts alone show comes first.
    """
    claims = [
        (": ".join(filter(None, (each.requirement, each.sentence))), each.refuted, f"method {each.method}")
        for each in case.claims[:MOST_CLAIMS]
    ]
    by_rollouts = [("By the rollouts alone, without a kernel: " + " ".join(case.reasons), True, "counted")]
    return [*(by_rollouts if case.by_rollouts and case.verdict == "VIOLATED" else []), *claims]


def _table(title: str, rows: tuple[Named, ...]) -> str:
    lines = [f"{each.name}: {each.text}" if each.name else each.text for each in rows[:MOST_LINES]]
    more = [f"and {len(rows) - MOST_LINES} more in the document"] if len(rows) > MOST_LINES else []
    return "\n".join([title, *lines, *more])


def _assumed(found: AssumptionText) -> str:
    return f"{found.title} ({found.id}). To be judged by {found.judge}"


def _derived(case: SafetyCase) -> str:
    ids = [each.id for each in case.with_status("derived")]
    return f"Derived from the method, and no matter of data: {', '.join(ids) or 'none'}"


def _tests_made(case: SafetyCase) -> str:
    made = [each for each in case.checks if each.startswith(("Spot check", "Recheck"))]
    return " ".join(["Audit of the observations by the certificate.", *made])


def _tested(case: SafetyCase) -> str:
    ids = ", ".join(each.id for each in case.with_status("not refuted")) or "none"
    if refuted := case.with_status("refuted"):
        return f"REFUTED by the data: {', '.join(each.id for each in refuted)}. Not refuted: {ids}"
    return f"No assumption that data can test is refuted: {ids}"


def to_yaml(elements: tuple[Element, ...]) -> str:
    """Return the file of an argument; its texts are JSON strings, which are YAML, too."""
    blocks = []
    for each in elements:
        lines = [f"{each.id}:", f"  text: {json.dumps(each.text, ensure_ascii=False)}"]
        for key, ids in (("supportedBy", each.supported_by), ("inContextOf", each.in_context_of)):
            if ids:
                lines.append(f"  {key}: [{', '.join(ids)}]")
        if each.undeveloped:
            lines.append("  undeveloped: true")
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks) + "\n"
