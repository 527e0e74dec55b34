"""The gate: each policy fails for its own reason, and its outputs say which."""

import hashlib
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.signing import keys, sign
from perfbound.orchestrator.certificate.verify.run import Verification, verify_certificate
from perfbound.orchestrator.release.gate import subject
from perfbound.orchestrator.release.gate.attestation import PREDICATE_TYPE, to_attestation
from perfbound.orchestrator.release.gate.outputs import conclusion, to_junit, to_markdown, to_sarif
from perfbound.orchestrator.release.gate.policy import Policy, load_policy
from perfbound.orchestrator.release.gate.rules import Finding, Judgement, judged
from perfbound.orchestrator.release.gate.subject import read_subject
from perfbound.orchestrator.run.known import Finished
from perfbound.orchestrator.store.read import last_outcome
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.result.certificate import STATEMENT_TYPE
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts, says
from tests.fakes.simulators import robustness, simulate
from tests.tampering import editing

PAGE = Path(__file__).parents[4] / "docs" / "release.md"
SAMPLE = Path(__file__).parents[3] / "fixtures" / "finished" / "sample"
RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}
DAY = 86_400.0
PASSES = """
verdict = "SHOWN"
at_most = 0.45
probability = 0.95
constants = "none"
signed_by = "alice.pub"
max_age = "30d"
software = { perfbound = ">=0.1", numpy = ">=1" }
[assumptions]
drawn_starts = "derived"
only_campaign = ["assumed", "not refuted"]
"*" = ["derived", "assumed", "not refuted"]
"""


def slope(request: RolloutRequest) -> float:
    return 0.5 - 0.2 * (sum(request.x) - 1.0)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A signed campaign by method `sample`, two by `rigorous`, one of which is violated, and one with requirements."""
    found = tmp_path_factory.mktemp("gate")
    shutil.copytree(SAMPLE, found / "sample")
    for name in ("alice", "bob"):
        keys.new_pair(found, name)
    sign.sign_certificate(found / "sample", keys.load_private(found / "alice.key"))
    config = robustness(RIGOROUS, spot_check=20, recheck=3)
    assert simulate(found / "good", config, slope, noisy=False)
    bare = robustness(RIGOROUS, spot_check=0, recheck=0, name="bad")
    assert simulate(found / "bad", bare, lambda request: slope(request) - 0.5, noisy=False)
    several = robustness(
        {"method": "sample"},
        name="several",
        specification=None,
        specifications=[
            {"name": "low", "formula": "value >= 0", "id": "R-1"},
            {"name": "high", "formula": "value >= 0.45", "id": "R-2"},
        ],
        claims=[{"quantity": "failure_probability"}],
        max_tests=60,
        spot_check=0,
        recheck=0,
    )
    assert simulate(found / "several", several, slope, noisy=True)
    return found


@pytest.fixture(autouse=True)
def a_day_later(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the fixture's last rollout be a day old."""
    ended = last_outcome(runs / "sample")
    assert ended is not None
    monkeypatch.setattr("perfbound.orchestrator.run.known.time.time", lambda: ended + DAY)


def judge(runs: Path, policy: str, *names: str) -> list[Judgement]:
    (runs / "policy.toml").write_text(policy)
    rules = load_policy(runs / "policy.toml")
    return judged(rules, [read_subject(runs / name, rules, None, lambda *_: None) for name in names])


def failed(found: Sequence[Judgement]) -> list[Finding]:
    return [finding for each in found for finding in each.findings if not finding.passed]


def test_a_policy_of_every_rule_passes(runs: Path) -> None:
    found = judge(runs, PASSES, "sample")
    assert not failed(found)
    assert all(each.passed for each in found)
    assert {each.rule for each in found[0].findings} == {
        "verified", "verdict", "at_most", "probability", "constants", "signed_by", "max_age", "software", "assumptions",
    }  # fmt: skip
    assert says(conclusion(found), "GATE PASSED")


def test_an_empty_policy_asks_for_a_verified_certificate_that_shows_what_is_required(runs: Path) -> None:
    assert [each.rule for each in judge(runs, "", "good")[0].findings] == ["verified", "verdict"]
    assert [each.rule for each in failed(judge(runs, "", "bad"))] == ["verdict"]


@pytest.mark.parametrize(
    ("policy", "name", "rule", "listed"),
    [
        ("", "bad", "verdict", "VIOLATED"),
        ('verdict = "not VIOLATED"', "bad", "verdict", "VIOLATED"),
        ("margin = 5", "good", "margin", "robustness >="),
        ("at_most = 0.4", "sample", "at_most", "failure_probability <= 0.4382"),
        ("margin = 0.1", "sample", "margin", "failure_probability <= 0.4382"),
        ("at_most = 0.1", "good", "at_most", "robustness >="),
        ("probability = 0.99", "sample", "probability", "at least 0.9500"),
        ('constants = "none"', "good", "constants", "rkhs_norm/robustness"),
        ('constants = "doubled"\nverdict = "any"', "bad", "constants", "VIOLATED"),
        ('assumptions = { only_campaign = "not refuted" }', "sample", "assumptions", "assumed"),
        ('assumptions = { declared_distribution = "derived" }', "sample", "assumptions", "assumed"),
        ('verdict = "any"\nspot_check = true', "bad", "spot_check", "none"),
        ('verdict = "any"\nrecheck = true', "bad", "recheck", "none"),
        ('requirements = ["R-7"]\nverdict = "any"', "several", "requirements", "no campaign has it"),
        ('requirements = ["R-2"]\nverdict = "any"', "several", "requirements", "failure_probability <= at_most"),
        ('signed_by = "alice.pub"', "good", "signed_by", "not signed"),
        ('signed_by = ["alice.pub", "bob.pub"]', "sample", "signed_by", "no signature by key"),
        ('max_age = "23h"', "sample", "max_age", "24 h 0 min since the last rollout"),
        ('software = { numpy = ">=99" }', "sample", "software", "2."),
        ('software = { jax = ">=0" }', "sample", "software", "not recorded"),
    ],
)
def test_a_policy_fails_for_its_own_reason(runs: Path, policy: str, name: str, rule: str, listed: str) -> None:
    (found,) = failed(judge(runs, policy, name))
    assert found.rule == rule
    assert says(found.found, listed)
    assert found.remedy
    assert found.expected


def changed(runs: Path, name: str, policy: str, **changes: Any) -> list[Finding]:
    """Return what fails of a campaign whose claim, certificate, verdict or age is another one."""
    (runs / "policy.toml").write_text(f'verdict = "any"\nverified = false\n{policy}')
    rules = load_policy(runs / "policy.toml")
    found = read_subject(runs / name, rules, None, lambda *_: None)
    assert found.campaign is not None
    assert not failed(judged(rules, [found])), "it passes unchanged"
    predicate, verdict = found.campaign.predicate, found.campaign.verdict
    claims = tuple(each.model_copy(update=changes.get("claim", {})) for each in predicate.claims)
    predicate = predicate.model_copy(update={"claims": claims, **changes.get("predicate", {})})
    verdict = verdict.model_copy(update=changes.get("verdict", {}))
    age = changes.get("age", found.campaign.age)
    campaign = replace(found.campaign, predicate=predicate, verdict=verdict, age=age)
    return failed(judged(rules, [replace(found, campaign=campaign)]))


def test_a_bound_on_a_refuted_assumption_reaches_no_limit(runs: Path) -> None:
    (found,) = changed(runs, "sample", "at_most = 0.45", claim={"refuted": ("drawn_starts/robustness",)})
    assert found.rule == "at_most"
    assert says(found.found, "drawn_starts/robustness")


@pytest.mark.parametrize("claim", [{"vacuous": True}, {"refuted": ("clip",)}])
def test_an_empty_or_refuted_claim_shows_no_requirement(runs: Path, claim: dict[str, Any]) -> None:
    (found,) = changed(runs, "several", 'requirements = "R-1"\nat_most = 0.9', claim=claim)[-1:]
    assert found.rule == "requirements"


def test_a_verdict_that_rests_on_constants_is_not_the_same_with_others(runs: Path) -> None:
    (found,) = changed(runs, "sample", 'constants = "doubled"', verdict={"rests_on": "B = 2"})
    assert says(found.found, "B = 2")


def test_a_refuting_spot_check_and_a_differing_recheck_fail(runs: Path) -> None:
    predicate = subject_of(runs, "good").predicate
    assert predicate.spot_check is not None
    assert predicate.recheck is not None
    problems = tuple(each.model_copy(update={"status": "refuted"}) for each in predicate.spot_check.problems)
    spot = predicate.spot_check.model_copy(update={"problems": problems})
    again = predicate.recheck.model_copy(update={"agreed": predicate.recheck.rollouts - 1})
    found = changed(runs, "good", "spot_check = true\nrecheck = true", predicate={"spot_check": spot, "recheck": again})
    assert [each.rule for each in found] == ["spot_check", "recheck"]
    assert says(found[0].found, "20 refuted: robustness")
    assert says(found[1].found, "2 of 3")


def test_evidence_from_the_future_has_no_age(runs: Path) -> None:
    assert not changed(runs, "sample", 'max_age = "30d"', age=-DAY / 2)
    (found,) = changed(runs, "sample", 'max_age = "30d"', age=-2 * DAY)
    assert found.rule == "max_age"


def test_only_the_assumptions_of_the_first_claim_count(runs: Path) -> None:
    policy = 'assumptions = { "*" = ["derived", "assumed", "not refuted"] }'
    refuted = tuple(
        each.model_copy(update={"status": "refuted"}) for each in subject_of(runs, "sample").predicate.assumptions
    )
    first, *_ = refuted
    assert len(changed(runs, "sample", policy, predicate={"assumptions": refuted})) == len(refuted)
    (found,) = changed(runs, "sample", policy, predicate={"assumptions": refuted}, claim={"assumptions": (first.id,)})
    assert says(found.expected, first.id)


def subject_of(runs: Path, name: str) -> Finished:
    (runs / "policy.toml").write_text("verified = false")
    found = read_subject(runs / name, load_policy(runs / "policy.toml"), None, lambda *_: None).campaign
    assert found is not None
    return found


def test_a_certificate_that_was_edited_after_its_signature_is_not_signed(runs: Path, tmp_path: Path) -> None:
    edited = Path(shutil.copytree(runs / "sample", tmp_path / "edited"))
    path = edited / files.CERTIFICATE
    path.write_bytes(path.read_bytes() + b" ")
    (found,) = failed(judge(runs, 'verified = false\nsigned_by = "alice.pub"', str(edited)))
    assert found.rule == "signed_by"
    assert says(found.found, "certificate.json not signed")


def test_a_requirement_is_shown_by_any_of_the_campaigns(runs: Path) -> None:
    policy = 'requirements = ["R-1", "high"]\nverdict = "any"\nat_most = 0.2'
    *_, found = judge(runs, policy, "sample", "several")
    assert [each.passed for each in found.findings] == [True, False]
    assert found.name == "requirements"


def test_the_whole_specification_shows_each_of_its_requirements(runs: Path) -> None:
    parts = [{"name": "low", "formula": "value >= 0", "id": "R-1"}, {"name": "lower", "formula": "value >= -0.1"}]
    whole = robustness(RIGOROUS, name="whole", specification=None, specifications=parts, composition="single")
    assert simulate(runs / "whole", whole, slope, noisy=False)
    assert not failed(judge(runs, 'requirements = ["R-1", "lower"]', "whole"))
    claims = subject_of(runs, "whole").predicate.claims
    whole_alone = tuple(each for each in claims if each.requirement is None)
    assert whole_alone
    assert not changed(runs, "whole", 'requirements = ["R-1", "lower"]', predicate={"claims": whole_alone})


def test_nothing_of_a_campaign_counts_that_is_not_verified(runs: Path, tmp_path: Path) -> None:
    changed = Path(shutil.copytree(runs / "sample", tmp_path / "changed"))
    file = next(changed.rglob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-1])
    (found,) = judge(runs, 'margin = 1\nmax_age = "1h"', str(changed))
    assert [each.rule for each in found.findings] == ["verified"]
    assert says(found.findings[0].found, "files:")
    trusted = judge(runs, "verified = false", str(changed))
    assert not failed(trusted), "only `verified = false` takes a directory at its word"


def test_emptied_tables_hide_no_violations(runs: Path, tmp_path: Path) -> None:
    # For a certificate its evidence is enough; the verdict counts the violations of the database.
    emptied = Path(shutil.copytree(runs / "bad", tmp_path / "emptied"))
    with editing(emptied) as database:
        for table in ("bounds", "observations", "rollouts", "tests"):
            database.execute(f"DELETE FROM {table}")
    (found,) = failed(judge(runs, 'verdict = "not VIOLATED"', str(emptied)))
    assert found.rule == "verified"
    assert says(found.found, "database: violations")


def test_an_age_without_a_record_of_attempts_is_none(runs: Path, tmp_path: Path) -> None:
    without = Path(shutil.copytree(runs / "sample", tmp_path / "without"))
    (without / files.ATTEMPTS).unlink()
    (without / files.ATTEMPTS_ENVELOPE).unlink()
    (found,) = failed(judge(runs, 'max_age = "30d"', str(without)))
    assert says(found.found, "attempts: age")


def test_a_campaign_that_is_not_finished_is_unreadable(runs: Path, tmp_path: Path) -> None:
    unfinished = Path(shutil.copytree(runs / "sample", tmp_path / "unfinished"))
    (unfinished / files.CERTIFICATE).unlink()
    found = judge(runs, "", "sample", str(unfinished))
    assert [bool(each.fault) for each in found] == [False, True]
    assert says(conclusion(found), "GATE FAILED: 1 unreadable")
    suite = ElementTree.fromstring(to_junit(found)).findall("testsuite")[1]
    assert suite.attrib["errors"] == "1"
    assert suite.find("testcase/error") is not None


@pytest.mark.parametrize(
    ("text", "listed"),
    [
        ("margn = 1", "margn: no such key; 'margin'"),
        ("margin = true", "margin: True"),
        ("probability = 1.5", "probability: 1.5"),
        ('max_age = "30"', "max_age: '30' 30d"),
        ("max_age = 30", "max_age: 30 30d"),
        ('software = { numpy = "2.x" }', "software: 2.x"),
        ('assumptions = { clip = "fine" }', "assumptions.clip"),
        ('verdict = "shown"', "verdict: 'shown'"),
        ("verdict =", "not TOML"),
        ("resimulated = -1", "resimulated: -1"),
    ],
)
def test_a_wrong_policy_is_one_line_with_its_key(tmp_path: Path, text: str, listed: str) -> None:
    path = tmp_path / "policy.toml"
    path.write_text(text)
    with pytest.raises(PerfboundError, match=facts(listed)) as caught:
        load_policy(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_junit_has_a_case_for_each_rule(runs: Path) -> None:
    found = judge(runs, 'assumptions = { "*" = "derived" }', "sample", "bad")
    root = ElementTree.fromstring(to_junit(found))
    for each, suite in zip(found, root.findall("testsuite"), strict=True):
        cases = suite.findall("testcase")
        names = [case.attrib["name"] for case in cases]
        assert len(set(names)) == len(names) == len(each.findings) == int(suite.attrib["tests"])
        assert sum(case.find("failure") is not None for case in cases) == int(suite.attrib["failures"])
        assert int(suite.attrib["failures"]) == sum(not finding.passed for finding in each.findings)


def test_junit_and_markdown_survive_any_text(runs: Path) -> None:
    hostile = Finding("verdict", "a|b <b>", "\x00\x1b[31m & \ufffe \ud800", "`x`", passed=False)
    found = [Judgement("runs/<a>&\x01", (hostile,))]
    assert ElementTree.fromstring(to_junit(found)).find(".//failure") is not None
    row = to_markdown(found).splitlines()[4]
    assert "<b>" not in row
    assert row.replace("\\|", "").count("|") == 6


def test_code_in_markdown_stays_as_it_is_written() -> None:
    row = to_markdown([Judgement("a_b", (Finding("verdict", "`at_most`", "`<b>", "`x|y`", passed=False),))])
    assert row.splitlines()[4] == "| a\\_b | verdict | `at_most` | \\`&lt;b&gt; | `x\\|y` |"


def test_sarif_names_the_line_of_the_campaign_file(runs: Path, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text('name = "bad"\n\nspecification = "value >= 0"\n')
    log = json.loads(to_sarif(judge(runs, "", "good", "bad"), [file]))
    results = {each["ruleId"]: each for each in log["runs"][0]["results"]}
    assert (
        set(results)
        == {"verdict", "counterexample"}
        == {each["id"] for each in log["runs"][0]["tool"]["driver"]["rules"]}
    )
    place = results["counterexample"]["locations"][0]["physicalLocation"]
    assert place["artifactLocation"]["uri"].endswith("bad.toml")
    assert place["region"]["startLine"] == 3
    file.rename(tmp_path / "good.toml")
    without = json.loads(to_sarif(judge(runs, "", "bad"), [tmp_path / "good.toml"]))["runs"][0]["results"][0]
    assert without["locations"][0]["physicalLocation"]["artifactLocation"]["uri"].endswith("bad/certificate.json")


def test_markdown_has_a_row_for_each_failing_rule_and_every_verdict(runs: Path) -> None:
    lines = to_markdown(judge(runs, "margin = 5", "good", "bad")).splitlines()
    assert says(lines[0], "GATE FAILED: 3 rules fail")
    assert sum(line.startswith("| ") for line in lines) == 1 + 3
    assert sum(line.startswith("- ") for line in lines) == 2


def test_the_page_has_every_key_with_its_default() -> None:
    table = PAGE.read_text().partition("| key | by default |")[2].partition("\n\n")[0]
    rows = dict(re.findall(r"^\| `(\w+)` \|\s*`?([^|`]*?)`?\s*\|", table, re.MULTILINE))
    assert list(rows) == list(Policy.model_fields)
    defaults = {name: json.loads(written) for name, written in rows.items() if written.strip()}
    assert Policy() == Policy(**defaults)
    given = {"margin", "at_most", "probability", "constants", "max_age", "assumptions", "requirements", "signed_by"}
    assert rows.keys() - defaults == given | {"software"}, "without them nothing is asked"


# The attestation


def test_the_attestation_says_which_rules_held_of_which_certificates(runs: Path) -> None:
    policy = b"margin = 0.1\n"
    found = json.loads(to_attestation(judge(runs, policy.decode(), "good", "bad"), Path("p.toml"), policy))
    assert (found["_type"], found["predicateType"]) == (STATEMENT_TYPE, PREDICATE_TYPE)
    digests = {each["name"]: each["digest"]["sha256"] for each in found["subject"]}
    assert digests == {
        f"{runs / name}/certificate.json": hashlib.sha256((runs / name / "certificate.json").read_bytes()).hexdigest()
        for name in ("good", "bad")
    }
    predicate = found["predicate"]
    assert predicate["result"] == "FAILED"
    assert predicate["configuration"] == [{"name": "p.toml", "digest": {"sha256": hashlib.sha256(policy).hexdigest()}}]
    assert predicate["passedTests"] == [
        *(f"{runs / 'good'}: {rule}" for rule in ("verified", "verdict", "margin")),
        f"{runs / 'bad'}: verified",
    ]
    assert predicate["failedTests"] == [f"{runs / 'bad'}: {rule}" for rule in ("verdict", "margin")]
    good = json.loads(to_attestation(judge(runs, "", "good"), Path("p.toml"), b""))
    assert (good["predicate"]["result"], good["predicate"]["failedTests"]) == ("PASSED", [])


def test_what_cannot_be_read_is_no_subject_and_fails(runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs / "good", tmp_path / "run")
    (tmp_path / "run" / files.CERTIFICATE).write_text("{")
    found = [read_subject(tmp_path / "run", Policy(), None, lambda *_: None)]
    statement = json.loads(to_attestation(judged(Policy(), found), Path("p.toml"), b""))
    assert statement["subject"] == []
    assert statement["predicate"]["failedTests"] == [f"{tmp_path / 'run'}: unreadable"]


def test_a_certificate_that_changes_meanwhile_is_not_judged(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(runs / "good", tmp_path / "run")
    path = tmp_path / "run" / files.CERTIFICATE

    own = verify_certificate

    def verify(directory: Path, **options: Any) -> Verification:
        found = own(directory, **options)
        path.write_text(path.read_text() + "\n")
        return found

    monkeypatch.setattr(subject, "verify_certificate", verify)
    (found,) = judged(Policy(), [read_subject(tmp_path / "run", Policy(), None, lambda *_: None)])
    assert "changed while it was judged" in found.fault


def test_the_conclusion_counts_one_rule_as_one() -> None:
    finding = Finding("verdict", "SHOWN", "SHOWN", "", passed=True)
    assert conclusion([Judgement("a", (finding,))]) == "GATE PASSED: 1 rule holds"
    assert conclusion([Judgement("a", (finding, finding))]) == "GATE PASSED: 2 rules hold"
