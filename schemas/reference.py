"""The reference page of campaign files, generated from the models so that it stays current."""

import json
from collections.abc import Collection, Iterator
from typing import Any, get_args

from pydantic import BaseModel, TypeAdapter

from .campaign import CampaignConfig
from .claims import ClaimRequest
from .composition import ComposedClaim
from .falsify import Falsify
from .kernel import MaternKernel, Weighted
from .method_spaces import SPACES
from .problem_models import (
    WITHOUT_MEANING,
    Gap,
    KrigingProblem,
    Linearised,
    PaperProblem,
    RigorousProblem,
    SampleProblem,
    ScenarioProblem,
)
from .problems import OBJECTIVES, Objective
from .requirements import Requirement
from .space import ProgramLimits, Range, Scenarios, SpaceKind, StartTable, SystemChoice

HEAD = """# Reference: campaign files

This page is generated from `schemas/campaign.py` and `schemas/problems.py` by `make schemas`; a
[JSON Schema](../schemas/json/v1/campaign.json) has the same keys. A campaign file is written in TOML; a file with an
unknown key is refused. Robustness has the unit of the predicates. [Theory](theory.md) explains the symbols,
[STL](stl.md) the specifications.
"""
METHODS = """
## Methods and spaces

What each method takes under `[space]`. A distribution or a table needs a method that draws its starts.

| method | ranges | distributions | scenarios | table |
|---|---|---|---|---|
"""
PROBLEMS = """
## Problems

The names of `[[problems]]`. The bound of a problem with a quantity is a claim by itself; alone it has
`composition = "single"`. The others are terms of a composition.

| name | bounded | rolled out | methods | quantity |
|---|---|---|---|---|
"""
TABLES: tuple[tuple[str, str, type[BaseModel]], ...] = (
    ("Top level", "", CampaignConfig),
    ("[system]", "The table also takes the options of the system; `perfbound systems` lists them.", SystemChoice),
    ("[system] of a program, limits", "", ProgramLimits),
    (
        "[space]",
        'One entry per parameter of the system: `x = [0, 5]`, in full `x = { low = 0.0, high = 5.0, unit = "m" }`, or '
        'with a distribution `x = { low = 0, high = 5, distribution = "normal", mean = 2, sd = 1 }`, or as an input '
        'over time `u = { signal = "pchip", knots = 5, low = 0, high = 1 }`. Beside them `where = "x^2 + y^2 <= 25"`. '
        "[Starting conditions](own-system.md#starting-conditions) shows each form.",
        Range,
    ),
    ("[space], scenarios", "Instead of ranges: `scenarios = [[0.5, 0.5], [1.5, 0.5]]`.", Scenarios),
    ("[space], table", 'Instead of ranges: `table = "starts.csv"`.', StartTable),
    ("[[problems]], method paper", "One table per optimisation problem; each name at most once.", PaperProblem),
    ("[[problems]], method rigorous", "", RigorousProblem),
    (
        "[[problems]], method kriging",
        "At most three parameters. All `max_tests` tests are made. [Noisy rollouts]"
        "(questions.md#noisy-rollouts-method-kriging) has an example.",
        KrigingProblem,
    ),
    ("[[problems]], method scenario", "`resolution` and `gap` have no effect with this method.", ScenarioProblem),
    (
        "[[problems]], method sample",
        "Starts that are drawn from the distribution under `[space]`; `max_tests` is the number of samples. "
        "[How often it fails](questions.md#how-often-does-it-fail-and-how-bad-is-the-worst-hundredth) has an example.",
        SampleProblem,
    ),
    ("[[claims]]", "What method `sample` claims, the answer to the question of the file first.", ClaimRequest),
    (
        "[[claims]] by a rule",
        "With the other methods, the claims that are made from the bounds of the problems, the answer to the question "
        "of the file first. Each problem is used by one of them or more.",
        ComposedClaim,
    ),
    (
        "[specifications]",
        'Instead of `specification`: `gap = "always (distance >= 2)"`, or a table each, '
        '`gap = { formula = "always (distance >= 2)", id = "REQ-7" }`.',
        Requirement,
    ),
    (
        "[falsify]",
        "`falsify = {}` takes the default. [Counterexamples](questions.md#is-there-a-start-that-fails) shows it.",
        Falsify,
    ),
    ("kernel", "", MaternKernel),
    ("gap", "", Gap),
    ("linearised", "", Linearised),
    ("regulariser, entries of a mixture", "", Weighted),
)
ALLOWED = {
    (CampaignConfig, "space"): "ranges, a list of scenarios, or a table of starts",
    (PaperProblem, "window"): "`1`",
    (PaperProblem, "max_tests"): "whole number >= 2 <= 1e+06",
    (PaperProblem, "noise_scale"): "number > 0",
    (ScenarioProblem, "name"): ", ".join(
        f"`{name}`" for name, each in OBJECTIVES.items() if "scenario" in each.methods
    ),
    (ScenarioProblem, "sense"): "`min`",
    (KrigingProblem, "name"): ", ".join(f"`{name}`" for name, each in OBJECTIVES.items() if "kriging" in each.methods),
    (SampleProblem, "name"): ", ".join(f"`{name}`" for name, each in OBJECTIVES.items() if "sample" in each.methods),
    (Range, "choices"): "list of numbers",
    (CampaignConfig, "claims"): "tables, of [drawn starts](#claims) or [by a rule](#claims-by-a-rule)",
    (ComposedClaim, "problems"): "list of names of problems",
    (CampaignConfig, "specifications"): "one entry per requirement, a formula or a [table](#specifications)",
    (Scenarios, "scenarios"): "lists of numbers, or text",
    (Scenarios, "header"): "list of texts",
    (StartTable, "table"): "text, or lists of numbers",
    (StartTable, "header"): "list of texts",
    (SystemChoice, "program"): "list of texts",
    (SystemChoice, "files"): "list of texts",
    (SystemChoice, "columns"): "table of texts",
    (SystemChoice, "noisy"): "true or false, or list of `nominal`, `true`",
    (SystemChoice, "variants"): "list of `nominal`, `true`",
    (SystemChoice, "environment"): "list of texts",
}
"""Values that the type of a key does not show: the file's reader or a validator decides them."""
DEFAULTS = {
    (CampaignConfig, "name"): "that of the file",
    (CampaignConfig, "problems"): "one, `robustness`",
    (Range, "low"): "required, but for `choices`",
    (Range, "high"): "required, but for `choices`",
    (RigorousProblem, "method"): "on a box",
    (ScenarioProblem, "method"): "on scenarios",
    (SampleProblem, "method"): "where starts are drawn",
    (ClaimRequest, "delta"): "that of the problem",
    (CampaignConfig, "specifications"): "none",
    (CampaignConfig, "claims"): "`failure_probability` with method `sample`",
}
"""Defaults that follow from the rest of the file."""
OMITTED = (
    {(ScenarioProblem, name) for name in ("column", "resolution", "gap")}
    | {(KrigingProblem, name) for name in ("column", "window")}
    | {(Requirement, "name")}
    | {(SampleProblem, name) for name in ("column", *WITHOUT_MEANING)}
)
"""Keys that a method inherits and refuses or ignores."""
SECTIONS = {
    "SystemChoice": "system",
    "ProgramLimits": "system-of-a-program-limits",
    "MaternKernel": "kernel",
    "Gap": "gap",
    "Linearised": "linearised",
    "Falsify": "falsify",
    "ClaimRequest": "claims",
    "Requirement": "specifications",
}
"""The section of this page that describes a table, by the name of its model."""


def page() -> str:
    """Return the page as Markdown."""
    sections = [
        f"\n## {title}\n\n{note + chr(10) * 2 if note else ''}{_key_table(model)}" for title, note, model in TABLES
    ]
    methods = "".join(_method_row(*row) for row in SPACES.items())
    problems = "".join(_problem_row(*row) for row in OBJECTIVES.items())
    return HEAD + "".join(sections) + METHODS + methods + PROBLEMS + problems


def _method_row(name: str, taken: Collection[SpaceKind]) -> str:
    return f"| `{name}` | {' | '.join('yes' if each in taken else '-' for each in get_args(SpaceKind))} |\n"


def _problem_row(name: str, objective: Objective) -> str:
    variants = " and ".join(f"`{each}`" for each in objective.variants) or "`true`, or the only variant"
    methods = ", ".join(f"`{each}`" for each in objective.methods)
    words = objective.statement.words.format(gap="gap")
    quantity = f"`{objective.statement.quantity}`" if objective.statement.quantity else "-"
    if objective.exact:
        words += f"; with `noise_scale = 0`, and then without need of a clip, {objective.exact.words}"
        quantity += f" or `{objective.exact.quantity}`"
    return f"| `{name}` | {words} | {variants} | {methods} | {quantity} |\n"


def _key_table(model: type[BaseModel]) -> str:
    schema = TypeAdapter(model).json_schema()
    shown = ((name, part) for name, part in schema["properties"].items() if (model, name) not in OMITTED)
    required = schema.get("required", ())
    rows = [
        _row(name, part, DEFAULTS.get((model, name)) or _default(part, name in required), ALLOWED.get((model, name)))
        for name, part in shown
    ]
    return "| key | allowed | default | meaning |\n|---|---|---|---|\n" + "".join(rows)


def _default(part: dict[str, Any], required: bool) -> str:
    return "required" if required else "-" if part.get("default") is None else f"`{json.dumps(part['default'])}`"


def _row(name: str, part: dict[str, Any], default: str, stated: str | None) -> str:
    allowed = stated or " or ".join(dict.fromkeys(_allowed_values(part)))
    return f"| `{name}` | {allowed} | {default} | {part.get('description', '')} |\n"


def _allowed_values(part: dict[str, Any]) -> Iterator[str]:
    for each in part.get("anyOf", ()):
        if each.get("type") != "null":
            yield from _allowed_values(each)
    if "const" in part or "enum" in part:
        yield ", ".join(f"`{value}`" for value in part.get("enum", [part.get("const")]))
    elif "$ref" in part:
        section = SECTIONS[part["$ref"].rsplit("/", 1)[1]]
        yield f"table, see [{section}](#{section})"
    elif part.get("type") == "array":
        yield "[low, high]" if "prefixItems" in part else "tables"
    elif part.get("type") == "object":
        yield f"table of {_KINDS['number']}s" if part.get("additionalProperties", {}) == NUMBERS else "tables"
    elif "type" in part:
        yield f"{_KINDS[part['type']]}{_range_text(part)}"


NUMBERS = {"type": "number", "exclusiveMinimum": 0}
_KINDS = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false"}
_LIMITS = (("minimum", ">="), ("exclusiveMinimum", ">"), ("maximum", "<="), ("exclusiveMaximum", "<"))


def _range_text(part: dict[str, Any]) -> str:
    return "".join(
        f" {sign} {part[key]:g}" if part[key] != 2**53 else f" {sign} 2^53" for key, sign in _LIMITS if key in part
    )
