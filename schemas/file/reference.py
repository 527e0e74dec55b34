"""The reference page of campaign files, generated from the models so that it stays current."""

import json
from collections.abc import Collection, Iterator, Sequence
from itertools import chain
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, TypeAdapter

from .composition import ComposedClaim
from .config import CampaignConfig
from .drawn_claims import ClaimRequest
from .logs import LogMapping
from .method_spaces import SPACES
from .objectives import OBJECTIVES, MethodName, Objective
from .parameters import SIGNAL_KEYS, Range
from .problem_models import (
    OVERRIDES,
    PROBLEM_MODELS,
    WITHOUT_MEANING,
    Falsify,
    Gap,
    KrigingProblem,
    Linearised,
    MaternKernel,
    PaperProblem,
    RigorousProblem,
    SampleProblem,
    ScenarioProblem,
    Weighted,
)
from .requirements import OWN_CONSTANT, Requirement
from .signals import PARTS
from .space import PROGRAM_KEYS, ProgramLimits, Scenarios, SpaceKind, StartTable, SystemChoice

HEAD = """# Reference: campaign files

A campaign file is written in TOML; a file with an unknown key is refused. `make schemas` generates this page from the
classes in `schemas/`, with a [JSON Schema](../schemas/json/v1/campaign.json) for editors.
Robustness has the unit of the predicates. [Theory](theory.md) explains the symbols, [STL](stl.md) the specifications.
"""
PROBLEM_KEYS = """
## Keys of a problem

`[[problems]]` has one table per optimisation problem, each name at most once. Method `paper` has `window = 1`.

| key | methods | allowed | meaning |
|---|---|---|---|
"""
METHODS = """
## Methods

Method `kriging` bounds at most six parameters. It makes all `max_tests` tests, as `sample` draws so many starts.
[Which question do you have?](questions.md) has examples.

| method | meaning | spaces | `method` may be left out |
|---|---|---|---|
"""
PROBLEMS = """
## Problems

The bound of a problem with a quantity is a claim by itself; alone it has `composition = "single"`. The others are terms
of a composition.

| name | bounded | rolled out | methods | quantity |
|---|---|---|---|---|
"""


class Section(NamedTuple):
    """One table of the page."""

    title: str
    model: type[BaseModel] | tuple[type[BaseModel], ...]
    note: str = ""
    keys: Collection[str] = ()
    """The keys that it has; empty for all that no other section has."""


PROGRAM = "of a program: "
"""How the meaning of a key begins that only a program has; its section leaves this out."""
SECTIONS: tuple[Section, ...] = (
    Section("Top level", CampaignConfig),
    Section("[system]", SystemChoice, "The options of the system are keys, too; `perfbound systems` lists them."),
    Section("[system] of a program", SystemChoice, keys=PROGRAM_KEYS),
    Section("limits", ProgramLimits),
    Section("[system.logs]", LogMapping, "Of a rig: [Logs and rigs](logs.md) has examples."),
    Section(
        "[space]",
        Range,
        'One entry per parameter of the system: `x = [0, 5]`, or a table, `x = { low = 0.0, high = 5.0, unit = "m" }`. '
        "[Starting conditions](own-system.md#starting-conditions) shows each form. The keys of a distribution describe "
        "it before it is "
        "truncated to the range, in the unit of the parameter.",
    ),
    Section(
        "[space] of an input over time",
        Range,
        "[Inputs over time](own-system.md#inputs-over-time) has examples.",
        keys=SIGNAL_KEYS,
    ),
    Section(
        "[space] without ranges",
        (Scenarios, StartTable),
        '`scenarios = [[0.5, 0.5], [1.5, 0.5]]`, or `table = "starts.csv"`.',
    ),
    Section("[[claims]]", ClaimRequest, "Claims of method `sample`."),
    Section(
        "[[claims]] by a rule",
        ComposedClaim,
        "Claims of the other methods, from the bounds of problems. Each problem is used at least once.",
    ),
    Section(
        "[specifications]",
        Requirement,
        'Instead of `specification`: `gap = "always (distance >= 2)"`, or a table each, '
        '`gap = { formula = "always (distance >= 2)", id = "REQ-7" }`.',
    ),
    Section("[falsify]", Falsify, "`falsify = {}` takes every default."),
    Section("kernel", MaternKernel),
    Section("gap", Gap),
    Section("linearised", Linearised),
    Section("regulariser, entries of a mixture", Weighted),
)
ALLOWED: dict[tuple[type[BaseModel], str], str] = {
    (CampaignConfig, "space"): "ranges, scenarios, or a table of starts",
    (CampaignConfig, "composition"): "a [rule](#claims-by-a-rule)",
    (CampaignConfig, "problems"): "[tables](#keys-of-a-problem)",
    (PaperProblem, "noise_scale"): "number > 0",
    (RigorousProblem, "regulariser"): "number >= 1e-09 or [tables](#regulariser-entries-of-a-mixture)",
    (Range, "choices"): "list of numbers",
    (Range, "times"): "list of numbers",
    (Range, "profile"): "text, or lists of two numbers",
    (CampaignConfig, "claims"): "tables, of [drawn starts](#claims) or [by a rule](#claims-by-a-rule)",
    (ComposedClaim, "problems"): "list of names",
    (CampaignConfig, "specifications"): "[one entry](#specifications) per requirement",
    (Scenarios, "scenarios"): "lists of numbers, or text",
    (Scenarios, "header"): "list of texts",
    (StartTable, "table"): "text, or lists of numbers",
    (StartTable, "header"): "list of texts",
    (CampaignConfig, "recorded"): "tables",
    (LogMapping, "offset"): '`"first"`, or a number',
    (LogMapping, "columns"): "table of texts",
    (LogMapping, "limits"): "table of lists of two numbers",
    (SystemChoice, "program"): "list of texts",
    (SystemChoice, "files"): "list of texts",
    (SystemChoice, "columns"): "table of texts",
    (SystemChoice, "noisy"): "true or false, or list of `nominal`, `true`",
    (SystemChoice, "variants"): "list of `nominal`, `true`",
    (SystemChoice, "environment"): "list of texts",
}
ALLOWED |= {(Range, key): "number, or a range" for parts in PARTS.values() for key in parts}
ALLOWED |= {(model, "name"): "a [problem](#problems)" for model in PROBLEM_MODELS.values()}
ALLOWED |= {(model, "sense"): "`min`, `max`" for model in PROBLEM_MODELS.values()}
"""Values that the type of a key does not show: the file's reader or a validator decides them."""
DEFAULTS = {
    (CampaignConfig, "name"): "by default that of the file",
    (CampaignConfig, "problems"): "by default one, `robustness`",
    (Range, "low"): "required but with `choices`, a sine, a step or a profile",
    (Range, "high"): "required but with `choices`, a sine, a step or a profile",
    (MaternKernel, "length_scale"): "required by `paper` and on scenarios",
    (ClaimRequest, "delta"): "by default that of the problem",
    (CampaignConfig, "claims"): "by default `failure_probability` with method `sample`",
    (CampaignConfig, "specifications"): "",
}
DEFAULTS |= {(model, "kernel"): "required by `paper` and on scenarios" for model in PROBLEM_MODELS.values()}
"""Defaults that follow from the rest of the file."""
WORDS = {"box": "ranges"}
LEFT_OUT: dict[str, str] = {"rigorous": "on a box", "scenario": "on scenarios", "sample": "where starts are drawn"}
"""Where the file need not name its method."""
OMITTED = (
    {(ScenarioProblem, name) for name in ("column", "resolution", "gap")}
    | {(KrigingProblem, name) for name in ("column", "window")}
    | {(Requirement, "name")}
    | {(SampleProblem, name) for name in ("column", *WITHOUT_MEANING)}
    | {(model, "method") for model in PROBLEM_MODELS.values()}
)
"""Keys that a method inherits and refuses or ignores, or that have a table of their own."""
LINKS = {
    "ProgramLimits": "limits",
    "LogMapping": "systemlogs",
    "MaternKernel": "kernel",
    "Gap": "gap",
    "Linearised": "linearised",
    "Falsify": "falsify",
    "SystemChoice": "system",
    "ClaimRequest": "claims",
    "Requirement": "specifications",
}
"""The section of this page that describes a table, by the name of its model."""


def page() -> str:
    """Return the page as Markdown."""
    first = [_section(each) for each in SECTIONS[:8]]
    methods = "".join(_method_row(*row) for row in SPACES.items())
    problems = "".join(_problem_row(*row) for row in OBJECTIVES.items())
    rest = [_section(each) for each in SECTIONS[8:]]
    return "".join((HEAD, *first, METHODS, methods, PROBLEMS, problems, PROBLEM_KEYS, *_problem_keys(), *rest))


def _section(section: Section) -> str:
    models = section.model if isinstance(section.model, tuple) else (section.model,)
    elsewhere = {key for each in SECTIONS if each.model is section.model for key in each.keys} - set(section.keys)
    rows = [
        (name, *cells)
        for name, *cells in dict.fromkeys(chain.from_iterable(map(_rows, models)))
        if name not in elsewhere and (name in section.keys or not section.keys)
    ]
    if section.keys:
        rows = [(*cells, meaning.removeprefix(PROGRAM).removeprefix("of a program, ")) for *cells, meaning in rows]
    note = f"{section.note}\n\n" if section.note else ""
    head = "| key | allowed | meaning |\n|---|---|---|\n"
    return f"\n## {section.title}\n\n{note}{head}{''.join(map(_line, _merged(rows)))}"


def _merged(rows: Sequence[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """Yield the rows, the keys of a requirement that a problem has as well in one."""
    own = [name for name, *_, meaning in rows if meaning == OWN_CONSTANT]
    for name, *cells, meaning in rows:
        if name not in own:
            yield name, *cells, meaning
        elif name == own[0]:
            yield "`, `".join(own), "as in [a problem](#keys-of-a-problem)", meaning


def _problem_keys() -> Iterator[str]:
    """Yield one line for each key of a problem, or several where methods differ in it."""
    methods: dict[tuple[str, str, str], list[str]] = {}
    for method, model in PROBLEM_MODELS.items():
        for row in _rows(model):
            methods.setdefault(row, []).append(method)
    names = list(dict.fromkeys(name for name, _, _ in methods))
    sizes = dict.fromkeys(name for name, _, meaning in methods if meaning == OVERRIDES)
    yield _line(("`, `".join(sizes), "all that use them", "as at the [top level](#top-level)", OVERRIDES))
    for row in sorted(methods, key=lambda row: names.index(row[0])):
        if row[0] not in sizes:
            users = "all" if len(methods[row]) == len(PROBLEM_MODELS) else ", ".join(methods[row])
            yield _line((row[0], users, *row[1:]))


def _line(cells: Sequence[str]) -> str:
    return f"| `{cells[0]}` | {' | '.join(cells[1:])} |\n".replace("|  |", "| |")


def _method_row(name: MethodName, taken: Collection[SpaceKind]) -> str:
    meaning = PROBLEM_MODELS[name].model_fields["method"].description
    spaces = ", ".join(WORDS.get(each, each) for each in get_args(SpaceKind) if each in taken)
    return _line((name, str(meaning), spaces, LEFT_OUT.get(name, "")))


def _problem_row(name: str, objective: Objective) -> str:
    variants = " and ".join(f"`{each}`" for each in objective.variants) or "`true`, or the only variant"
    methods = ", ".join(f"`{each}`" for each in objective.methods)
    words = objective.statement.words.format(gap="gap")
    quantity = f"`{objective.statement.quantity}`" if objective.statement.quantity else ""
    if objective.exact:
        words += f"; with `noise_scale = 0`, and then without need of a clip, {objective.exact.words}"
        quantity += f" or `{objective.exact.quantity}`"
    return f"| `{name}` | {words} | {variants} | {methods} | {quantity} |\n"


def _rows(model: type[BaseModel]) -> Iterator[tuple[str, str, str]]:
    """Yield name, allowed values with the default, and meaning of each key of a model."""
    schema = TypeAdapter(model).json_schema()
    if "$ref" in schema:  # a table that may contain others of its kind
        schema = schema["$defs"][model.__name__]
    required = schema.get("required", ())
    for name, part in schema["properties"].items():
        if (model, name) not in OMITTED:
            allowed = ALLOWED.get((model, name)) or " or ".join(dict.fromkeys(_allowed_values(part)))
            default = DEFAULTS.get((model, name), _default(part, name in required))
            yield name, f"{allowed}, {default}" if default else allowed, part.get("description", "")


def _default(part: dict[str, Any], required: bool) -> str:
    value = part.get("default")
    return "required" if required else "" if value in (None, "", {}) else f"default `{json.dumps(value)}`"


def _allowed_values(part: dict[str, Any]) -> Iterator[str]:
    for each in part.get("anyOf", ()):
        if each.get("type") != "null":
            yield from _allowed_values(each)
    if "const" in part or "enum" in part:
        yield ", ".join(f"`{value}`" for value in part.get("enum", [part.get("const")]))
    elif "$ref" in part:
        section = LINKS[part["$ref"].rsplit("/", 1)[1]]
        yield f"[table](#{section})"
    elif part.get("type") == "array":
        yield "[low, high]" if "prefixItems" in part else "tables"
    elif part.get("type") == "object":
        values = part.get("additionalProperties", {})
        yield "table of numbers" if isinstance(values, dict) and values.get("type") == "number" else "tables"
    elif "type" in part:
        yield f"{_KINDS[part['type']]}{_range_text(part)}"


_KINDS = {"string": "text", "number": "number", "integer": "integer", "boolean": "true or false"}
_LIMITS = (("minimum", ">="), ("exclusiveMinimum", ">"), ("maximum", "<="), ("exclusiveMaximum", "<"))


def _range_text(part: dict[str, Any]) -> str:
    """Return the limits of a number.

    >>> _range_text({"minimum": 1, "maximum": 10_000}), _range_text({"exclusiveMinimum": 0, "exclusiveMaximum": 1})
    (', 1 to 10,000', ' in (0, 1)')
    """
    least, above, most, below = (part.get(key) for key, _ in _LIMITS)
    if least is not None and most is not None:
        return f", {_number(least)} to {_number(most)}"
    if (least, most) == (None, None) and above is not None and below is not None:
        return f" in ({_number(above)}, {_number(below)})"
    limits = [f"{sign} {_number(part[key])}" for key, sign in _LIMITS if key in part]
    return f" {' and '.join(limits)}" if limits else ""


def _number(value: float) -> str:
    return "2^53" if value == 2**53 else f"{value:,g}" if value < 1e5 else f"{value:,.0f}"
