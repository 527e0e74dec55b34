"""Formulas whose parts have several units."""

import pytest

from perfbound.orchestrator.mathematics.stl.units import mixed_units

UNITS = {"t": "s", "angle": "rad", "x": "m", "y": "m", "count": "", "v": "m/s"}


def lines(formula: str) -> list[str]:
    return list(mixed_units({"specification": formula}, UNITS))


@pytest.mark.parametrize(
    ("formula", "units", "scaled"),
    [
        (
            "always (abs(angle) <= 0.2 and abs(x) <= 2.4)",
            "in rad and m,",
            "in shares of each limit: always (abs(angle) / 0.2 <= 1 and abs(x) / 2.4 <= 1)",
        ),
        (
            "eventually[0,1] (x >= -3) and always (count < 5)",
            "in m and numbers,",
            "in shares of each limit: eventually[0,1] x / 3 >= -1 and always count / 5 < 1",
        ),
        ("always (angle <= 0.2 and v >= 0)", "in rad and m/s,", "divide each by a scale of its own"),
        (
            "always (angle <= 0.2) or x + y <= 1 and v >= 2",
            "in rad, m and m/s,",
            "shares of each limit: always angle / 0.2 <= 1 or",
        ),
    ],
)
def test_several_units_are_named_with_the_formula_in_shares(formula: str, units: str, scaled: str) -> None:
    (line,) = lines(formula)
    assert line.startswith(f"specification: its parts are {units} ")
    assert scaled in line


@pytest.mark.parametrize(
    "formula",
    [
        "always (x <= 1 and abs(y) <= 2)",
        "always (x / 3 <= 1 and angle / 0.2 <= 1)",
        "always (count <= 1)",
        "x + angle <= 1",
    ],
)
def test_one_unit_or_none_that_is_known_needs_no_line(formula: str) -> None:
    assert lines(formula) == []


def test_a_scaled_formula_is_one_unit() -> None:
    (line,) = lines("always (abs(angle) <= 0.2 and abs(x) <= 2.4)")
    assert lines(line.rpartition("limit: ")[2]) == []
