"""The certificate document: its arithmetic, its form, and its independence of timing."""

import hashlib
import json
from pathlib import Path

import pytest

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.campaign.plan import plan
from perfbound.orchestrator.campaign.series import Account, Rows
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.issue import issue, manifest
from perfbound.orchestrator.certificate.verify.rerun import MemoryFactStore
from perfbound.schemas.errors import EvidenceError
from perfbound.schemas.file.problem_models import PaperProblem
from perfbound.schemas.result.certificate import PREDICATE_TYPE, STATEMENT_TYPE, Certificate
from perfbound.schemas.result.facts import BoundFact, Header
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.values import Bound, Proposal
from tests.campaigns import config

SPEC = SystemSpec(
    name="segway",
    doc="",
    parameters=(Parameter(name="x", unit="m", low=0, high=5), Parameter(name="y", unit="m", low=0, high=5)),
    columns=(Column(name="t", unit="s"), Column(name="phi", unit="rad")),
    max_horizon=60,
)
FILES = [("ab" * 32, "trajectories/a.mcap"), ("cd" * 32, "trajectories/b.mcap")]


def account(problem_index: int, y: float, campaign: str = "segway-paper", **changes: object) -> Account:
    """Return a problem that stopped after two tests, the last one with observation y of J."""
    chosen = config(campaign, **changes)
    problem = chosen.problems[problem_index]
    assert isinstance(problem, PaperProblem)
    return Account(
        "0" * 64,
        plan=plan(chosen, SPEC, problem),
        observations=[y, y],
        each=Rows([(y,), (y,)]),
        nodes=[0, 3],
        proposed=[Proposal(0, (0.0, 0.0), 0.0, 1.0, None, None), Proposal(3, (5.0, 0.0), 0.1, 0.01, 0.4, 0.0099)],
        robustness=[0.71, 0.75],
        counts={"nominal": 2, "true": 2 * (problem_index == 1)},
        last_proposal=Proposal(3, (5.0, 0.0), 0.1, 0.01, 0.4, 0.0099),
        last_bound=BoundFact(problem.name, 1, Bound(y + problem.alpha + problem.c, None, "converged")),
    )


def issued(header: Header, accounts: dict[str, Account]) -> Certificate:
    ledger = Ledger(Path(), MemoryFactStore(header))
    ledger.accounts = accounts
    ledger.series = {**accounts}
    return issue(ledger, manifest(FILES))


def certificate(**changes: object) -> Certificate:
    """Return the certificate of the paper's Table I: last observations .71 and .27."""
    header = Header.new(config("segway-paper", **changes), SPEC, {"perfbound": "0"}, run="0" * 16)
    accounts = {"nominal_robustness": account(0, -0.71), "sim_gap": account(1, 0.27)}
    return issued(header, accounts)


def test_the_papers_table_gives_the_papers_claim() -> None:
    predicate = certificate().predicate
    claim, composition = predicate.claims[0], predicate.composition
    assert composition is not None
    terms = (composition.nominal_bound, composition.gap_bound, composition.risk_term)
    assert terms == pytest.approx((0.46, 0.38, 0.08), abs=2e-9)
    assert (claim.quantity, claim.sense) == ("rho_star", ">=")
    assert claim.bound == composition.bound == pytest.approx(0.0, abs=4e-9)
    assert claim.probability == pytest.approx(0.854430, abs=1e-6)
    assert [problem.probability for problem in predicate.problems] == pytest.approx([0.924354] * 2, abs=1e-6)


def test_the_sum_rule_claims_less() -> None:
    claim = certificate(composition="sum").predicate.claims[0]
    assert claim.rule == "sum"
    assert claim.probability == pytest.approx(1 - 2 * (1 - 0.924354), abs=2e-6)


def test_the_papers_norm_bound_is_refuted_and_the_claim_rests_on_it() -> None:
    predicate = certificate().predicate
    status = {each.id: each.status for each in predicate.assumptions}
    assert status["rkhs_norm/nominal_robustness"] == "refuted"
    assert "rkhs_norm/nominal_robustness" in predicate.claims[0].assumptions
    assert set(predicate.claims[0].assumptions) == set(status) - {"accounting"}
    assert predicate.claims[1].rule == "sum"
    assert set(predicate.claims[1].assumptions) == set(status) - {"independence"}
    assert "rkhs_norm/nominal_robustness" in predicate.claims[0].refuted


def test_bounds_are_rounded_to_the_safe_side() -> None:
    header = Header.new(config("segway-paper"), SPEC, {}, run="0" * 16)
    accounts = {"nominal_robustness": account(0, -0.7099999999), "sim_gap": account(1, 0.2700000004)}
    nominal, gap = issued(header, accounts).predicate.problems
    assert (nominal.bound, gap.bound) == (0.459999999, 0.380000001)


def test_text_is_an_in_toto_statement_with_sorted_keys() -> None:
    text = certificate().to_json()
    value = json.loads(text)
    assert (value["_type"], value["predicateType"]) == (STATEMENT_TYPE, PREDICATE_TYPE)
    assert value["subject"][0]["digest"]["sha256"] == hashlib.sha256(manifest(FILES).text.encode()).hexdigest()
    assert text == json.dumps(value, sort_keys=True, indent=1) + "\n"
    assert Certificate.model_validate_json(text) == certificate()


def test_the_run_id_is_not_in_it() -> None:
    header = Header.new(config("segway-paper"), SPEC, {"perfbound": "0"}, run="feedfacefeedface")
    accounts = {"nominal_robustness": account(0, -0.71), "sim_gap": account(1, 0.27)}
    assert issued(header, accounts).to_json() == certificate().to_json()


def test_a_damaged_certificate_is_an_error_not_a_missing_one(tmp_path) -> None:  # type: ignore[no-untyped-def]
    assert files.read(tmp_path) is None
    files.write(tmp_path, certificate(), manifest(FILES).text)
    assert files.read(tmp_path) == certificate()
    path = tmp_path / files.CERTIFICATE
    path.write_text(path.read_text()[:-20])
    with pytest.raises(EvidenceError, match=r"certificate\.json"):
        files.read(tmp_path)
