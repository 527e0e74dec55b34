"""The arms of a search: what leads downwards has most tests, what finds nothing falls back, and none is left out."""

import pytest

from perfbound.orchestrator.mathematics.search.portfolio import Arm, Portfolio, gain

ARMS = [arm for arm in Arm if arm is not Arm.WHOLE]


def shares(*observed: tuple[Arm, float]) -> dict[Arm, float]:
    arms = Portfolio([0], parts=1)
    for arm, gained in observed:
        arms.observe(arm, gained)
    return {arm: arms.share(arm) for arm in ARMS}


def test_models_have_most_tests_at_first() -> None:
    assert shares()[Arm.LIKELY] + shares()[Arm.LOWER] > 0.85


def test_only_a_goal_with_several_parts_has_an_arm_of_the_whole() -> None:
    several = Portfolio([0], parts=2)
    assert sum(map(several.share, Arm)) == pytest.approx(1.0)
    assert several.share(Arm.WHOLE) == several.share(Arm.LIKELY)
    assert sum(shares().values()) == pytest.approx(1.0)


def test_an_arm_that_gains_has_more_tests() -> None:
    assert shares((Arm.LOWER, 0.5))[Arm.LOWER] > 1.5 * shares()[Arm.LOWER]
    assert shares((Arm.SHAPED, 1.0))[Arm.SHAPED] > 0.5


def test_models_that_find_nothing_fall_back_and_keep_some() -> None:
    stuck = shares(*[(arm, 0.0) for _ in range(200) for arm in (Arm.LIKELY, Arm.LOWER)])
    assert 0.3 < stuck[Arm.SHAPED] + stuck[Arm.ANYWHERE] < 0.5


def test_what_was_gained_long_ago_is_forgotten() -> None:
    past = [(Arm.SHAPED, 1.0), *[(Arm.LIKELY, 0.1)] * 200]
    assert shares(*past)[Arm.SHAPED] < 0.1 < shares(*past[:1])[Arm.SHAPED]


def test_the_arm_of_a_test_depends_on_seed_and_number() -> None:
    drawn = [Portfolio([0], parts=1).arm(test) for test in range(2000)]
    assert drawn == [Portfolio([0], parts=1).arm(test) for test in range(2000)]
    assert drawn != [Portfolio([1], parts=1).arm(test) for test in range(2000)]
    for arm in ARMS:
        assert drawn.count(arm) / 2000 == pytest.approx(shares()[arm], abs=0.03)


@pytest.mark.parametrize(("lowest", "value", "expected"), [(4.0, 3.0, 0.25), (4.0, 4.0, 0.0), (4.0, 0.0, 1.0)])
def test_the_gain_is_a_share_of_the_way_to_a_failure(lowest: float, value: float, expected: float) -> None:
    assert gain(lowest, value) == expected
