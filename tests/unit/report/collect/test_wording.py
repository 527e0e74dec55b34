"""The question of a campaign, where its evidence comes from, and the constants beside what is assumed."""

from perfbound.orchestrator.report.collect.cards import MOST_NAMED, provenance
from perfbound.orchestrator.report.collect.wording import question_words
from perfbound.orchestrator.report.data.claims import assumption_row
from perfbound.orchestrator.store.changes import Session
from perfbound.schemas.file.config import campaign_text
from perfbound.schemas.result.certificate import Assumption
from perfbound.schemas.result.facts import Header
from perfbound.workers.systems import load_system
from tests.campaigns import config

CAMPAIGN = config("segway-scenario", required_margin=0.25)
HEADER = Header("c0ffee", CAMPAIGN, load_system("segway").spec, {}, "12ab", "34cd")


def test_the_question_names_what_must_be_at_least_what() -> None:
    of_risk = question_words(HEADER, "rho_star")
    assert of_risk.startswith(
        "From every start, the mean margin less 0.2 standard deviations, clipped to [-0.05, 0.75], must be at least "
        "0.25 rad."
    )
    assert question_words(HEADER, None) == of_risk, "terms of a composition bound the risk"
    assert "the margin of every rollout must be at least" in question_words(HEADER, "robustness")
    # Values above the clip may only make a mean larger; what the clip hides below, the question has to name.
    clipped = "the mean margin over the noise, clipped to [-0.05, 0.75], must"
    assert clipped in question_words(HEADER, "expected_robustness")
    assert question_words(HEADER, "robustness", 25).startswith("From each of the 25 listed starts, the margin")
    drawn = question_words(HEADER, "failure_probability")
    assert drawn.startswith(
        "At starts that are drawn as declared, how probable it is that a rollout violates the specification; "
    )
    search = Header.new(config("segway-scenario", falsify={}), HEADER.spec, {})
    assert question_words(search, "failure_probability").startswith("Whether some rollout violates the specification")
    assert question_words(HEADER, "J_star") == ""


def test_the_evidence_comes_from_all_sessions() -> None:
    old = Session("first", 10.0, "cars.py:cars", "abc", "x86", None, None)
    new = Session("second", 20.0, "cars.py:cars", "def", "x86", "ada", None)
    found = provenance(HEADER, (old, new, new), 35.5)
    assert (found.accounts, found.hosts, found.platforms) == (("ada",), ("first", "second"), ("x86",))
    assert (found.started, found.ended, found.commit) == (10.0, 35.5, "def")
    assert (found.digest, found.file) == (HEADER.config_sha256, campaign_text(CAMPAIGN))
    many = provenance(HEADER, [Session(f"h{k}", 1.0, None, None, "x86", None, None) for k in range(50)], None)
    assert len(many.hosts) == MOST_NAMED


def test_constants_stand_beside_what_is_assumed_of_them() -> None:
    kernel: dict[str, int | float | str] = {"rkhs_norm": 40.0, "length_scale": "30 (gap)", "nu": 2.5}
    rows = [
        assumption_row(Assumption(id=name, status="assumed", detail="so.", values=values))
        for name, values in (("kernel/a", kernel), ("noise_scale/a", kernel | {"noise_scale": 3.5}), ("clip/a", kernel))
    ]
    assert [each.numbers for each in rows] == ["B = 40, length scale = 30 (gap)", "R = 3.5", ""]
    assert rows[0].detail == "So."
