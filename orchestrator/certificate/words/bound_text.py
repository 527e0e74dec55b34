"""Bounds and their probabilities as text, rounded to the safe side."""

import math
from collections.abc import Mapping, Sequence, Sized
from decimal import Decimal

from ....schemas.amounts import some_of
from ....schemas.errors import one_line
from ....schemas.file.drawn_claims import PROBABILITIES
from ....schemas.result.certificate import Assumption, Certificate, CertificateClaim
from ....schemas.system import SystemSpec

DIGITS = 4
"""After the point, of every printed number but a small one."""
SIGNIFICANT = 3
"""Of a bound, or of its distance from 1, that four digits after the point would leave with fewer than two."""
SMALLEST = 1e-10
"""What is closer to 0 or 1 is taken for it: the last bits of a float."""


def outward(bound: float, sense: str) -> str:
    """Return a bound that is no stronger than `bound`: with four digits after the point, with more next to 0 or 1.

    >>> outward(0.12341, ">="), outward(-0.12341, ">="), outward(0.12341, "<="), outward(1e305, ">=")
    ('0.1234', '-0.1235', '0.1235', '1e+305')
    >>> outward(1e-5, "<="), outward(1.2345e-5, "<="), outward(0.9999912, ">="), outward(1.0, ">=")
    ('0.00001', '0.0000124', '0.9999912', '1.0000')
    """
    digits = _digits(bound)
    scaled = bound * 10**digits
    if not math.isfinite(scaled):  # a number of a file that nobody has checked yet
        return f"{bound:g}"
    nearest = round(scaled)
    # A bound that has so many digits, but for the last bits of a float, keeps them.
    if not math.isclose(scaled, nearest, rel_tol=0, abs_tol=max(1e-6, 2 * math.ulp(scaled))):
        nearest = math.floor(scaled) if sense == ">=" else math.ceil(scaled)
    whole, _, after = f"{nearest / 10**digits:.{digits}f}".partition(".")
    return f"{whole}.{after.rstrip('0').ljust(DIGITS, '0')}"


def _digits(bound: float) -> int:
    """Return the digits after the point of a bound: a claim of 0.0001 would hide one of 0.00001."""
    distance = min(abs(bound), abs(1.0 - bound))
    return SIGNIFICANT - 1 - math.floor(math.log10(distance)) if SMALLEST < distance < 10 / 10**DIGITS else DIGITS


def as_required(number: float) -> str:
    """Return a number of the campaign file that a bound is compared with, in digits like those of the bound.

    >>> as_required(1e-5), as_required(0.25), as_required(0.0), as_required(1e20)
    ('0.00001', '0.25', '0', '1e+20')
    """
    text = f"{number:.12g}"
    return f"{Decimal(text):f}" if SMALLEST < abs(number) < 1 else text


def in_unit(text: str, unit: str) -> str:
    """Return a number with its unit, if it has one.

    >>> in_unit("0.5", "m"), in_unit("0.5", "1"), in_unit("0.5", "")
    ('0.5 m', '0.5', '0.5')
    """
    return text if unit in ("", "1") else f"{text} {one_line(unit)}"


def margin_text(text: str, claim: CertificateClaim, unit: str) -> str:
    """Return a number of a claim with the unit of the robustness, where it is one."""
    return in_unit(text, claim_unit(claim, unit))


def claim_unit(claim: CertificateClaim, unit: str) -> str:
    """Return the unit of a claim's bound, by that of the robustness; empty where it has none, as a probability.

    >>> made = {"sense": "<=", "bound": 0.01, "probability": 0.95, "rule": "single", "method": "sample",
    ...         "assumptions": (), "refuted": ()}
    >>> [claim_unit(CertificateClaim(quantity=each, **made), "m") for each in ("failure_probability", "quantile")]
    ['', 'm']
    """
    return "" if unit == "1" or claim.quantity in {"J_star", "safe_share", *PROBABILITIES} else one_line(unit)


def chance(probability: float, assumptions: Sized | None = None) -> str:
    """Return the probability of a bound; `assumptions` are those that it rests on, None where they are not listed.

    Certainty is that of a system without noise, and it rests on assumptions all the same.

    >>> chance(0.95), chance(1.0), chance(1.0, ("kernel/robustness",)), chance(1.0, ())
    ('with probability at least 0.9500', 'certain, if its assumptions hold', 'certain, if its 1 assumption holds', \
'certain')
    """
    if probability < 1.0:
        return f"with probability at least {outward(probability, '>=')}"
    if assumptions is None:
        return "certain, if its assumptions hold"
    return f"certain, {if_they_hold(assumptions)}" if assumptions else "certain"


def if_they_hold(assumptions: Sized) -> str:
    """Return the condition of a claim that rests on assumptions.

    >>> if_they_hold(("kernel/robustness",)), if_they_hold("ab")
    ('if its 1 assumption holds', 'if its 2 assumptions hold')
    """
    number = len(assumptions)
    return f"if its {number} assumption{' holds' if number == 1 else 's hold'}"


def clip_words(clip: Sequence[float]) -> str:
    """Return the words that a margin is clipped.

    >>> clip_words((-0.2, 1.0))
    'clipped to [-0.2, 1]'
    """
    return f"clipped to [{', '.join(f'{end:g}' for end in clip)}]"


def short_chance(probability: float, assumptions: Sized | None = None) -> str:
    """Return the same for a line of a list.

    >>> short_chance(0.95), short_chance(1.0, ("kernel/robustness",))
    ('probability 0.9500', 'certain, if its 1 assumption holds')
    """
    return f"probability {outward(probability, '>=')}" if probability < 1.0 else chance(probability, assumptions)


# Starts, with names and units: a certificate has bare numbers of some of them

BETWEEN = ", "
"""Joins the numbers of a start, which is the value `start` of an assumption."""


def parameter_units(spec: SystemSpec) -> dict[str, str]:
    """Return the units of the parameters by their names, in the order of a start."""
    return {parameter.name: parameter.unit for parameter in spec.parameters}


def start_words(numbers: Sequence[str], units: Mapping[str, str]) -> str:
    """Return the numbers of a start with the names and units of its parameters; alone where these do not fit.

    >>> start_words(("55.265", "3.4"), {"gap": "m", "mass": "1"}), start_words(("1", "2"), {})
    ('gap = 55.265 m, mass = 3.4', '1, 2')
    """
    if len(numbers) != len(units):
        return some_of(numbers)
    pairs = zip(numbers, units.items(), strict=True)
    return some_of([in_unit(f"{name} = {number}", unit) for number, (name, unit) in pairs])


def with_named_start(found: Assumption, units: Mapping[str, str]) -> Assumption:
    """Return an assumption with names and units in its sentence, to be shown."""
    start = found.values.get("start")
    if not isinstance(start, str) or not all(map(_is_number, start.split(BETWEEN))):
        return found
    # Every sentence has it at the end of a parenthesis; a bound may have the same digits.
    words = start_words(start.split(BETWEEN), units)
    return found.model_copy(update={"detail": found.detail.replace(f"{start})", f"{words})")})


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def with_named_starts(certificate: Certificate, units: Mapping[str, str]) -> Certificate:
    """Return a certificate with names and units in its sentences, to be printed."""
    predicate = certificate.predicate
    named = tuple(with_named_start(each, units) for each in predicate.assumptions)
    return certificate.model_copy(update={"predicate": predicate.model_copy(update={"assumptions": named})})
