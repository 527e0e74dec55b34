"""Starts in the sentences on a certificate, with names and units: a certificate has bare numbers of some of them."""

from collections.abc import Mapping, Sequence

from ...schemas.result.certificate import Assumption, Certificate
from ...schemas.system import SystemSpec
from .bound_text import in_unit

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
        return BETWEEN.join(numbers)
    pairs = zip(numbers, units.items(), strict=True)
    each = (in_unit(f"{name} = {number}", unit) for number, (name, unit) in pairs)
    return BETWEEN.join(each)


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
