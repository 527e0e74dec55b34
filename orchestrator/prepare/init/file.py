"""The text of a first campaign file: at most fourteen lines of keys, each with its meaning in a comment."""

from collections.abc import Iterable, Iterator

from ....schemas.errors import one_line
from ....schemas.file.signals import SignalShape
from ....schemas.file.toml_text import toml_comment, toml_key, toml_quoted, toml_value
from ....schemas.system import Option, Parameter
from .questions import FirstCampaign

FORMULAS = "docs/stl.md has the grammar: always, eventually, until, and, or, not, implies, abs()."
MOST_KEYS = 14
"""Lines of a file for one simulator that are neither comment nor blank."""


def campaign_text(campaign: FirstCampaign) -> str:
    """Return the file, with system and space on one line each where it would be too long otherwise."""
    forms = ((False, False), (False, True), (True, True))
    texts = ["\n".join(_lines(campaign, system, space)) + "\n" for system, space in forms]
    return next((text for text in texts if key_lines(text) <= MOST_KEYS), texts[-1])


def _lines(campaign: FirstCampaign, inline_system: bool, inline_space: bool) -> Iterator[str]:
    yield from _head(campaign)
    yield from campaign.question.keys(campaign)
    yield ""
    yield from _system(campaign, inline_system)
    yield ""
    yield from _space(campaign, inline_space)
    yield from campaign.question.ending(campaign)


def _head(campaign: FirstCampaign) -> Iterator[str]:
    spec, basis = campaign.spec, campaign.basis
    yield from toml_comment(f"{spec.name}: {spec.doc}" if spec.doc else spec.name)
    yield from toml_comment(f"{campaign.question.words} Written by `perfbound init`. {basis.source}")
    yield ""
    if basis.horizon:
        own = (
            "the default of the system"
            if basis.horizon == spec.default_horizon
            else "choose it as long as your question needs"
        )
        yield f"# Duration of a rollout in s: {own}."
        yield f"horizon = {basis.horizon!r}"
    columns = ", ".join(f"{each.name} ({each.unit})" if each.unit else each.name for each in spec.columns)
    yield from toml_comment(f"Columns of a rollout: {columns}.")
    yield from toml_comment(f"{basis.about} {FORMULAS}".strip())
    if not campaign.question.drawn:
        yield "# The constants fit this formula alone. For another one propose them anew, into another file:"
        yield f'#   {one_line(campaign.command)} --specification "..." --out FILE'
    yield f"specification = {toml_quoted(basis.specification)}"
    if campaign.candidates is not None:
        yield from toml_comment(
            "With so many parameters the claim is about the worst of this many listed starts, spread over the "
            "ranges, and about no start between them:"
        )
        yield f"candidates = {campaign.candidates}"
    yield from toml_comment(
        "For workers on several machines: this share of the rollouts is simulated by two of them, and counts if "
        "both agree, so that a machine that computes wrongly is found. It costs as many rollouts more."
    )
    yield "# second_opinion = 0.02"


def _system(campaign: FirstCampaign, inline: bool) -> Iterator[str]:
    chosen = campaign.system.model_dump(mode="json", exclude_none=True)
    yield from _table_lines("system", chosen.items(), inline)
    yield from (_option_line(option) for option in campaign.spec.options if option.name not in chosen)


def _space(campaign: FirstCampaign, inline: bool) -> Iterator[str]:
    parameters, shapes = campaign.spec.declared.parameters, {each.name: each for each in campaign.spec.signals}
    units = ", ".join(f"{each.name} in {each.unit}" for each in parameters if each.unit)
    where = f": {units}" if units else ""
    yield from toml_comment(f"All starting conditions of the claim, here the whole range of the system{where}.")
    for each in shapes.values():
        through = f" through {each.knots} knots" if each.knots else ""
        yield from toml_comment(f"{each.name} is an input over time{through}.")
    # A system that the file describes has the units that it gives; any other one knows its own.
    entries = {
        each.name: _range_value(each, shapes.get(each.name), unit=campaign.system.is_described) for each in parameters
    }
    yield from _table_lines("space", entries.items(), inline)
    fixed = [each for each in parameters if each.name not in shapes]
    if campaign.question.drawn and fixed:
        yield from _distribution(fixed[-1], inline)


def _distribution(example: Parameter, inline: bool) -> Iterator[str]:
    """Yield one commented range with a distribution."""
    low, high = example.low, example.high
    middle = float(f"{low + (high - low) / 2:.3g}")
    sd = float(f"{(high - low) / 6:.2g}")
    normal = {"low": low, "high": high, "distribution": "normal", "mean": middle, "sd": sd}
    yield from toml_comment(
        "Starts are drawn evenly from these ranges, and the claim is about this distribution. Give every range the "
        "one that operation has, for example:"
    )
    yield f"# {'' if inline else 'space.'}{toml_key(example.name)} = {toml_value(normal)}"


def key_lines(text: str) -> int:
    """Return the number of lines that are neither comment nor blank.

    >>> key_lines("# a comment\\n\\nhorizon = 8.0  # s\\n")
    1
    """
    return sum(not line.startswith("#") for line in map(str.strip, text.splitlines()) if line)


def _range_value(parameter: Parameter, shape: SignalShape | None, *, unit: bool) -> object:
    described = {"unit": parameter.unit} if unit and parameter.unit else {}
    if shape is None and not described:
        return [parameter.low, parameter.high]
    return {**({} if shape is None else shape.keys), "low": parameter.low, "high": parameter.high, **described}


def _table_lines(name: str, entries: Iterable[tuple[str, object]], inline: bool) -> Iterator[str]:
    if inline:
        yield f"{name} = {toml_value(dict(entries))}"
    else:
        yield from (f"{name}.{toml_key(key)} = {toml_value(value)}" for key, value in entries)


def _option_line(option: Option) -> str:
    allowed = " or ".join(map(toml_quoted, option.choices)) or option.allowed_numbers
    doc = f"; {option.doc}" if option.doc else ""
    return one_line(f"# system.{toml_key(option.name)} = {toml_value(option.default)}  # {allowed}{doc}")
