"""Claims by a rule: those that the file asks for, in its order, from the bounds of the problems that it names."""

import json
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.schemas.file.composition import composed_claims
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.result.certificate import Certificate
from tests.facts import facts
from tests.fakes.finished import KERNEL, a_pair, finish, play

PAIR = ["nominal_robustness", "sim_gap"]
RISK = {
    "name": "true_risk",
    "method": "rigorous",
    "alpha": 0.1,
    "rkhs_norm": 0.3,
    "noise_scale": "derived",
    "kernel": KERNEL,
    "linearised": {"centre": 0.05, "spread": 0.03},
}


def asked(*claims: tuple[str, list[str]], **changes: Any) -> CampaignConfig:
    """Return the pair by method `paper` and the risk by method `rigorous`, with these claims."""
    found = a_pair("paper").model_dump(mode="json", exclude_unset=True)
    del found["composition"]
    rules = [{"rule": rule, "problems": problems} for rule, problems in claims]
    problems = [*found["problems"], RISK]
    return CampaignConfig.model_validate_json(json.dumps(found | {"claims": rules, "problems": problems} | changes))


def certificate(directory: Path) -> Certificate:
    found = files.read(directory)
    assert found is not None
    return found


def test_one_campaign_claims_by_two_methods_in_the_order_of_the_file(tmp_path: Path) -> None:
    stage = play(tmp_path / "run", asked(("single", ["true_risk"]), ("product", PAIR), ("sum", PAIR)))
    finish(stage, tmp_path / "run")
    found = certificate(tmp_path / "run").predicate
    assert [(claim.rule, claim.quantity) for claim in found.claims] == [
        (rule, "rho_star") for rule in ("single", "product", "sum")
    ]
    assert [claim.method for claim in found.claims] == ["rigorous", "paper", "paper"]
    assert found.composition is None, "the first claim is none"
    assert "kernel/true_risk" in found.claims[0].assumptions
    assert not any("true_risk" in each for each in found.claims[1].assumptions)
    assert "independence" in found.claims[1].assumptions
    assert "independence" not in found.claims[2].assumptions
    checks = verify_certificate(tmp_path / "run", key=None, again=0, report=lambda *_: None).checks
    assert not [line.name for line in checks.lines() if line.status == "failed"]


def test_only_what_is_asked_for_is_claimed() -> None:
    short, one = a_pair("paper"), a_pair("paper").model_dump(mode="json", exclude_unset=True)
    del one["composition"]
    one["claims"] = [{"rule": "sum", "problems": PAIR}]
    config = CampaignConfig.model_validate_json(json.dumps(one))
    assert [each.rule for each in composed_claims(config.claims)] == ["sum"]
    assert config.digest != short.digest


@pytest.mark.parametrize(
    ("claims", "changes", "reason"),
    [
        ([("single", ["sim_gap"])], {}, "claims.0.rule: 'single'"),
        ([("single", PAIR)], {}, "claims.0.problems: 'single'"),
        ([("sum", PAIR[::-1])], {}, "claims.0.problems: 'sum'"),
        ([("pointwise", PAIR)], {}, "claims.0.rule: 'pointwise' 'rigorous'"),
        ([("single", ["maximum"])], {}, "claims.0.problems: 'maximum' nominal_robustness"),
        ([("sum", PAIR)], {}, "claims: 'true_risk'"),
        ([("sum", PAIR), ("sum", PAIR)], {}, "claims.1: twice"),
        ([("sum", PAIR)], {"composition": "sum"}, "composition: one claims"),
        ([("all", PAIR)], {}, "'product'"),
    ],
)
def test_claims_that_cannot_be(claims: list[tuple[str, list[str]]], changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=facts(reason)):
        asked(*claims, **changes)


def test_a_rule_and_drawn_starts_are_not_mixed() -> None:
    mixed = [{"rule": "sum", "problems": PAIR}, {"quantity": "mean"}]
    with pytest.raises(ValueError, match="claims: of drawn starts, or by a rule"):
        asked(claims=mixed)


def test_claims_by_a_rule_do_not_choose_the_method() -> None:
    text = """horizon = 5
clip = [-5, 60]
specification = "always (distance > 0)"
system.name = "cars"
alpha = 1
rkhs_norm = 40
noise_scale = 0
[space]
gap = [5, 60]
speed = [5, 35]
[[claims]]
rule = "single"
problems = ["robustness"]
"""
    assert parse_campaign(text.encode(), "cars.toml").problems[0].method == "rigorous"
