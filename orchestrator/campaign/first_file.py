"""The text of a first campaign file: every key that a new user needs, with its meaning in a comment."""

import json
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass

from ...schemas.errors import one_line
from ...schemas.problems import ProblemName
from ...schemas.space import SystemChoice
from ...schemas.system import Option, SystemSpec
from ...schemas.toml_text import toml_key, toml_quoted, toml_value
from .first_size import EXACT, NOISY, FirstSize
from .pilot import Constants

WIDTH = 100
"""Characters of a comment line."""
FORMULAS = "docs/stl.md has the grammar: always, eventually, until, and, or, not, implies, abs()."
ABOUT: dict[str, tuple[str, str]] = {
    "robustness": (
        "The worst robustness over all starts, of noisy rollouts their worst mean: a bound that is valid at any time.",
        "-robustness",
    ),
    "nominal_robustness": ("Lower bound of the worst mean robustness of the variant nominal.", "-robustness"),
    "sim_gap": ("Upper bound of how much less robust the variant true is than nominal, as a mean.", "the difference"),
}
"""What a problem bounds, and its objective J in words."""


@dataclass(frozen=True, slots=True)
class FirstValues:
    """What a first campaign assumes, from a pilot or guessed."""

    source: str
    """Of the constants, in a sentence."""
    horizon: float
    """In s; 0 for rollouts of one sample."""
    specification: str
    about: str
    """Of the specification, in a sentence."""
    clip: tuple[float, float] | None
    constants: dict[ProblemName, Constants]
    """Of each problem, in the order of the file."""
    guess: str = ""
    """Ends the meaning of clip and constants that no pilot shows."""


@dataclass(frozen=True, slots=True)
class FirstCampaign:
    """The content of a first campaign file."""

    spec: SystemSpec
    system: SystemChoice
    command: str
    """`perfbound init` with the system."""
    basis: FirstValues
    lengths: dict[str, float]
    """Length scale of each parameter."""
    candidates: int | None
    """Fixed starts, where no lattice covers the box."""
    size: FirstSize
    noisy: frozenset[ProblemName]
    """Problems whose rollouts depend on the seed."""
    cost: float | None = None
    """Seconds of a rollout, if known."""

    def text(self) -> str:
        """Return the file."""
        return "\n".join([*self._head(), *self._system(), *self._space(), *self._problems()]) + "\n"

    def _head(self) -> Iterator[str]:
        spec, basis = self.spec, self.basis
        yield from _comment(f"{spec.name}: {spec.doc}" if spec.doc else spec.name)
        yield from _comment(f"Written by `perfbound init`. {basis.source}")
        yield ""
        yield f"name = {json.dumps(spec.name[:64])}"
        yield "# Every random choice follows from this number: the same seed gives the same certificate."
        yield "seed = 1"
        if basis.horizon:
            own = (
                "the default of the system"
                if basis.horizon == spec.default_horizon
                else "choose it as long as your question needs"
            )
            yield f"# Duration of a rollout in s: {own}."
            yield f"horizon = {basis.horizon!r}"
        columns = ", ".join(f"{each.name} ({each.unit})" if each.unit else each.name for each in spec.columns)
        yield from _comment(f"Columns of a rollout: {columns}.")
        yield from _comment(f"{basis.about} {FORMULAS}")
        yield "# For another formula, propose the constants anew and write them to another file:"
        yield f'#   {one_line(self.command)} --specification "..." --out FILE'
        yield f"specification = {toml_quoted(basis.specification)}"
        if basis.clip is not None:
            yield from _comment(
                "Range to which the robustness, the margin to a violation, is clipped; the claim is about the clipped "
                f"one. Choose it so that it contains nearly all values.{basis.guess}"
            )
            yield f"clip = [{basis.clip[0]!r}, {basis.clip[1]!r}]"
        if len(basis.constants) == 2:
            yield "# How the rollouts of the two variants are compared, and the two bounds become one claim."
            yield 'gap = { kind = "robustness" }'
            yield 'composition = "pointwise"'
        if self.candidates is not None:
            yield from _comment(
                "With so many parameters the claim is about the worst of this many fixed starts, spread over the "
                "ranges, and about no start between them."
            )
            yield f"candidates = {self.candidates}"
        yield "# Tests of a problem at most; the bound is valid whenever they end."
        yield f"max_tests = {self.size.max_tests}"
        yield from self._checks()
        yield from _comment(
            "For workers on several machines: this share of the rollouts is simulated by two of them, and counts if "
            "both agree, so that a machine that computes wrongly is found. It costs as many rollouts more."
        )
        yield "# second_opinion = 0.02"

    def _checks(self) -> Iterator[str]:
        """Yield the sizes of the closing checks, where the defaults would take long."""
        size, full = self.size, NOISY if self.noisy else EXACT
        if size == full:
            return
        replicates = f"replicates = {full.replicates}, " if self.noisy else ""
        yield from _comment(
            f"A rollout takes about {self.cost:.2g} s, and this file has a size for a first result. One that counts "
            f"has max_tests = {full.max_tests}, {replicates}and without the "
            "following keys its checks at the end are larger, too."
        )
        yield f"spot_check = {size.spot_check}"
        if self.noisy:
            yield f"spot_check_followups = {size.spot_check}"
        yield f"recheck = {size.recheck}"

    def _system(self) -> Iterator[str]:
        yield ""
        yield "[system]"
        chosen = self.system.model_dump(mode="json", exclude_none=True)
        yield from (f"{toml_key(name)} = {toml_value(value)}" for name, value in chosen.items())
        yield from (_option_line(option) for option in self.spec.options if option.name not in chosen)

    def _space(self) -> Iterator[str]:
        yield ""
        yield "# All starting conditions of the claim: here the whole range of the system."
        yield "[space]"
        shapes = {each.name: each for each in self.spec.signals}
        for each in self.spec.declared.parameters:
            shape, unit = shapes.get(each.name), f", unit = {toml_quoted(each.unit)}" if each.unit else ""
            if shape is not None:
                yield from _comment(f"{each.name} is an input over time through this many knots over the horizon.")
            knots = "" if shape is None else f"signal = {toml_quoted(shape.kind)}, knots = {shape.knots}, "
            yield f"{each.name} = {{ {knots}low = {each.low!r}, high = {each.high!r}{unit} }}"

    def _problems(self) -> Iterator[str]:
        for name, constants in self.basis.constants.items():
            about, objective = ABOUT[name]
            yield ""
            yield from _comment(about)
            yield "[[problems]]"
            yield f'name = "{name}"'
            yield from _constant_lines(constants, objective, self.basis.guess)
            if name in self.noisy and self.size.replicates > 1:
                yield "# Rollouts of a test, with different seeds."
                yield f"replicates = {self.size.replicates}"
            lengths = ", ".join(f"{each} = {length!r}" for each, length in self.lengths.items())
            yield "# Distances in each parameter over which the robustness changes its course: assumptions."
            yield f"kernel = {{ length_scale = {{ {lengths} }} }}"


def _constant_lines(found: Constants, objective: str, guess: str) -> Iterator[str]:
    yield "# The problem stops when its bounds are so near, or after max_tests: both give valid bounds."
    yield f"alpha = {found.alpha!r}"
    yield f"# About the mean of {objective} over all starts.{guess}"
    yield f"prior_mean = {found.prior_mean!r}"
    yield from _comment(
        f"B, the norm of {objective} minus prior_mean for the kernel: the main assumption. It is above every distance "
        f"from prior_mean; a larger one is safer and proves less.{guess}"
    )
    yield f"rkhs_norm = {found.rkhs_norm!r}"
    yield from _comment(_NOISE.get(found.noise_scale, _NOISE_NUMBER))
    yield f"noise_scale = {json.dumps(found.noise_scale)}"


_NOISE = {
    0.0: "The rollouts do not depend on the seed.",
    "derived": "R, the noise of one rollout: derived from the clip, no assumption. The standard deviation at the "
    "noisiest start, as a number, is an assumption and proves more.",
}
_NOISE_NUMBER = (
    "R, the noise of one rollout: 1.5 times the largest standard deviation of two rollouts at a start, an assumption. "
    "It is often three times the typical one, because it has to hold at the noisiest start; one from many rollouts "
    'there proves more. "derived" follows from the clip, assumes nothing and proves less.'
)


def _option_line(option: Option) -> str:
    allowed = " or ".join(map(toml_quoted, option.choices)) or option.allowed_numbers
    doc = f"; {option.doc}" if option.doc else ""
    return one_line(f"# {option.name} = {toml_value(option.default)}  # {allowed}{doc}")


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(one_line(text), WIDTH - 2, break_on_hyphens=False)]
