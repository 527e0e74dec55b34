"""Access rules: names that are apart."""

import pytest

from perfbound.schemas.errors import LinkError
from perfbound.schemas.link.access import access_rules


def test_each_name_has_rules_of_its_own() -> None:
    rules = access_rules(["a", "b", "a"], "orchestrator.example")
    assert [each["subjects"] for each in rules["policies"]] == [["orchestrator.example"], ["a"], ["b"]]
    known = {each["id"]: each for each in rules["rules"]}
    assert len(known) == len(rules["rules"])
    for policy, prefix in zip(rules["policies"], ("local", "a", "b"), strict=True):
        expressions = [key for rule in policy["rules"] for key in known[rule]["key_exprs"]]
        assert f"perfbound/*/request/{prefix}-$*" in expressions
        assert f"perfbound/*/up/{prefix}-$*/state" in expressions
        assert not [key for key in expressions if "-$*" in key and f"/{prefix}-$*" not in key]


def test_an_orchestrator_without_a_name_has_no_local_workers() -> None:
    assert [each["id"] for each in access_rules(["a"], "")["subjects"]] == ["a"]


@pytest.mark.parametrize(
    ("allowed", "reason"),
    [
        (["a b"], "no name of a worker"),
        (["a/*"], "no name of a worker"),
        (["$*"], "no name of a worker"),
        ([""], "no name of a worker"),
        (["w", "w-2"], "not apart from those of 'w-2'"),
        (["w-2", "w"], "not apart from those of 'w'"),
        (["local"], "of its local workers"),
        (["local-1"], "not apart from those of 'local'"),
        (["server"], "of the orchestrator"),
    ],
)
def test_names_that_are_not_apart_are_refused(allowed: list[str], reason: str) -> None:
    with pytest.raises(LinkError, match=reason) as refused:
        access_rules(allowed, "server")
    assert str(refused.value).startswith("--allow ")
    assert "\n" not in str(refused.value)
