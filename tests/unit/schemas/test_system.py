"""In what two builds of a system differ."""

import pytest

from perfbound.schemas.errors import DefinitionError
from perfbound.schemas.system import Column, Parameter, SystemSpec, differences

COLUMNS = (Column(name="t", unit="s"), Column(name="y", unit="m"))


def spec(**parameters: Parameter) -> SystemSpec:
    named = tuple(each.model_copy(update={"name": name}) for name, each in parameters.items())
    return SystemSpec(name="s", doc="", parameters=named, columns=COLUMNS, max_horizon=1)


def test_a_changed_range_is_named_with_both_values() -> None:
    before = spec(mass=Parameter(0.1, 0.6, unit="kg"), angle=Parameter(-1, 1))
    after = spec(mass=Parameter(0.1, 0.7, unit="kg"), wind=Parameter(0, 3, signal=True))
    assert differences(before, after) == [
        "parameter mass in [0.1, 0.6] kg (here in [0.1, 0.7] kg)",
        "parameter angle in [-1, 1] (here none)",
        "parameter wind none (here in [0, 3], an input over time)",
    ]
    assert differences(before, before) == []


def test_a_column_is_no_word_of_a_specification() -> None:
    with pytest.raises(DefinitionError, match="'always' is a word of specifications; choose another name"):
        Column(name="always", unit="")


def test_another_order_of_the_parameters_is_a_difference() -> None:
    one, other = spec(a=Parameter(0, 1), b=Parameter(0, 2)), spec(b=Parameter(0, 2), a=Parameter(0, 1))
    (found,) = differences(one, other)
    assert found.startswith("parameters ")
