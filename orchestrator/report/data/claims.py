"""The part of the report data about the claims: what they say, what they rest on, and the verdict."""

from collections.abc import Mapping
from dataclasses import dataclass

from ....schemas.file.objectives import Quantity
from ....schemas.result.certificate import Assumption, Status
from ....schemas.result.known import ByRollouts, VerdictWord
from ...certificate.assumptions.statements import title
from ...certificate.words.bound_text import with_named_start

NUMBERS = {
    "kernel": {"rkhs_norm": "B", "length_scale": "length scale"},
    "noise_scale": {"noise_scale": "R"},
}
"""Values of assumptions that the campaign file sets, and their symbols."""


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim of the certificate; the first one is fixed before the campaign."""

    quantity: Quantity
    sense: str
    """">=" or "<="."""
    bound: float
    probability: float
    rule: str
    method: str
    sentence: str
    """The claim in words, bound and probability rounded to the safe side."""
    assumptions: tuple[str, ...]
    refuted: tuple[str, ...]
    vacuous: bool | None = None
    """Whether the clip alone proves it."""
    notes: tuple[str, ...] = ()
    """What it owes to its constants, in sentences."""
    starts: int | None = None
    """Number of listed starts; None on a box."""
    level: float | None = None
    factor: float | None = None
    requirement: str | None = None
    """The one that it is about; None for the whole specification."""
    clipped: tuple[float, float] | None = None
    """The clip that its formula has to name."""


@dataclass(frozen=True, slots=True)
class VerdictCard:
    """The verdict on a finished campaign, in sentences."""

    word: VerdictWord
    rests_on: str
    """The constants without whose exact size the verdict would be another one; may be empty."""
    claim: str
    reasons: tuple[str, ...]
    sure: tuple[str, ...]
    """How sure it is."""
    anyway: str
    """What holds whatever the verdict is; may be empty."""
    by_rollouts: ByRollouts | None
    """How the rollouts alone show it, without kernel and norm bound; None where they do not."""
    advice: tuple[str, ...]
    count: str
    """How many rollouts violate the specification; empty where none has a robustness."""
    command: str
    """Simulates the worst rollout again; empty where none violates it."""


@dataclass(frozen=True, slots=True)
class AssumptionRow:
    """One assumption of the claims."""

    id: str
    title: str
    """What it says, in plain words."""
    status: Status
    detail: str
    """The finding behind the status, a sentence."""
    numbers: str = ""
    """The constants of the campaign file that it is about."""


def assumption_row(found: Assumption, units: Mapping[str, str] | None = None) -> AssumptionRow:
    """Return an assumption of a certificate with its title; `units` are those of the parameters, in their order."""
    sentence = with_named_start(found, units or {}).detail
    detail = sentence[:1].upper() + sentence[1:]
    return AssumptionRow(found.id, title(found.id, found.form), found.status, detail, _constants_of(found))


def _constant_text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _constants_of(found: Assumption) -> str:
    """Return the constants of an assumption that a reader has to judge; empty where it has none."""
    values = found.values or {}
    shown = NUMBERS.get(found.id.partition("/")[0], {})
    return ", ".join(f"{name} = {_constant_text(values[key])}" for key, name in shown.items() if key in values)
