"""The horizon of a formula, and trajectories that are too short for it."""

import math

import pytest

from perfbound.orchestrator.mathematics.stl.horizon import check_horizon, horizon
from perfbound.orchestrator.mathematics.stl.parser import FormulaError, parse_formula


class TestHorizon:
    @pytest.mark.parametrize(
        ("text", "seconds"),
        [
            ("x <= 1", 0),
            ("always[0,10] (x <= 1 or not eventually[2,5] y <= 1)", 15),
            ("x <= 1 until[1,2] (y <= 1 until_from[3,4] always[0,0.5] x <= 1)", 6.5),
            ("(always[0,3] x <= 1) and eventually[0,7] x <= 1 implies x > 0", 7),
            ("always x <= 1", math.inf),
            ("always[0,5] eventually[1,inf) x <= 1", math.inf),
            ("always[0,5] once[2,9] eventually[0,3] x <= 1", 6),
            ("once[2,3] eventually[0,1] x <= 1", 0),
            ("eventually[0,3] x <= 1 since[1,2] always[0,6] y <= 1", 5),
            ("always[0,5) rise(x <= 1) or next y <= 1", 5),
        ],
    )
    def test_horizon(self, text: str, seconds: float) -> None:
        assert horizon(parse_formula(text)) == seconds

    @pytest.mark.parametrize(
        ("text", "enough"),
        [
            ("x <= 1", 0),
            ("always x <= 1", 0),
            ("always eventually[0,0] x <= 1", 0),
            ("always[0,10] eventually[2,5] y <= 1", 15),
            ("always[0,0.1] eventually[0.2,0.2] y <= 1", 0.3),  # .1 + .2 > .3 in floating point
            ("always[0,5] eventually[1,inf) x <= 1", 6),
            ("(always[0,3] x <= 1) until[1,2] x <= 1", 5),
            ("always[0,4] historically[1,2] eventually[0,3] x <= 1", 6),
            ("always[0,4] (eventually[0,1] x <= 1 since[2,3] always[0,2] x <= 1)", 5),
            ("always once eventually[0,0] x <= 1", 0),
        ],
    )
    def test_a_long_enough_trajectory(self, text: str, enough: float) -> None:
        tree = parse_formula(text)
        check_horizon(tree, enough)
        check_horizon(tree, enough + 1)
        if enough:
            with pytest.raises(FormulaError, match="reaches to"):
                check_horizon(tree, enough - 1e-6)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (
                "x <= 1 or always[0,20] x <= 1",
                "`always[0,20] x <= 1` reaches to 20 s, but the trajectory ends at 15 s: shorten the interval, or "
                "lengthen the horizon of the campaign",
            ),
            (
                "always[0,10] (x <= 1 or eventually[1,6] y <= 1)",
                "`eventually[1,6]` inside `always[0,10]` reaches to 10 + 6 = 16 s, but the trajectory ends at 15 s: "
                "shorten one of the intervals, or lengthen the horizon of the campaign",
            ),
            (
                "always (x <= 1 implies eventually[0,2] y <= 1)",
                "`eventually[0,2] y <= 1` reaches to 17 s, but the trajectory ends at 15 s, to which the operator "
                "around it is read (`always (x <= 1 implies eventually[0,2] y <= 1)`): give that one an interval that "
                "ends by 13, e.g. always[0,13]",
            ),
            (
                "x <= 1 until (y <= 1 until[0,2] x <= 2)",
                "`y <= 1 until[0,2] x <= 2` reaches to 17 s, but the trajectory ends at 15 s, to which the operator "
                "around it is read (`x <= 1 until (y <= 1 until[0,2] x <= 2)`): give that one an interval that ends "
                "by 13, e.g. until[0,13]",
            ),
        ],
    )
    def test_the_message(self, text: str, message: str) -> None:
        with pytest.raises(FormulaError) as caught:
            check_horizon(parse_formula(text), 15.0)
        assert str(caught.value) == caught.value.reason == message
        assert caught.value.position is None

    def test_the_remedy_works(self) -> None:
        check_horizon(parse_formula("always[0,13] (x <= 1 implies eventually[0,2] y <= 1)"), 15.0)

    @pytest.mark.parametrize("duration", [-1.0, math.nan, math.inf])
    def test_durations_are_checked(self, duration: float) -> None:
        with pytest.raises(ValueError, match="lasts 0 s or longer"):
            check_horizon(parse_formula("x <= 1"), duration)
