"""How sure a verdict is, in sentences for a reader who knows no kernel."""

from typing import Any

from perfbound.orchestrator.certificate.words.confidence import anyway, confidence_sentences, rests_on
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.result.certificate import (
    Assumption,
    CertificateClaim,
    MostStarts,
    Rollouts,
    Sensitivity,
    SpotCheck,
)
from perfbound.schemas.result.known import ByRollouts, CampaignVerdict, VerdictWord, Violations
from tests.facts import says
from tests.unit.certificate.words.test_text import a_certificate

NONE = Violations(rollouts=3, violations=0, starts=3, violating_starts=0, least=1.0, rollout="a")


def sentences(
    claim: dict[str, Any] | None = None,
    *,
    by_rollouts: ByRollouts | None = None,
    repeated: bool = False,
    verdict: VerdictWord = "SHOWN",
    **changes: Any,
) -> list[str]:
    """Return the sentences on a claim `worst expected robustness >= 1.25 m`."""
    found = CertificateClaim(
        quantity="expected_robustness", sense=">=", bound=1.25, probability=0.9, rule="single", method="rigorous",
        assumptions=("kernel/robustness",), refuted=(), by_clip=-1.0,
    ).model_copy(update=claim or {})  # fmt: skip
    predicate = a_certificate().predicate.model_copy(update={"claims": (found,)} | changes)
    card = CampaignVerdict(
        verdict=verdict, campaign="c", seed=1, claim="", reasons=(), advice=(), bound=1.25, sense=">=", required=0.0,
        probability=0.9, required_probability=0.95, unit="m", bound_unit="m", violations=NONE, by_rollouts=by_rollouts,
        repeat="",
    )  # fmt: skip
    return [*confidence_sentences(card, predicate, repeated=repeated), anyway(card, predicate)]


def rows(*bounds: float | None) -> tuple[Sensitivity, ...]:
    twice, half = bounds
    return (
        Sensitivity(claim=0, constant="rkhs_norm", factor=2.0, bound=twice),
        Sensitivity(claim=0, constant="length_scale", factor=0.5, bound=half),
        Sensitivity(claim=1, constant="rkhs_norm", factor=4.0, bound=0.0),
    )


def test_a_bound_is_wrong_with_the_rest_of_its_probability() -> None:
    chance, nothing = sentences()
    assert nothing == ""
    assert says(chance, "assumptions wrong probability most 0.1000: chance rollouts")
    certain, _ = sentences({"probability": 1.0})
    assert certain.startswith("Certain, if its assumptions hold")


def test_where_a_time_stamp_at_a_border_may_decide_certainty_says_so() -> None:
    borders = Assumption(id="borders", status="assumed", detail="so", values={"number": 1, "rollouts": 3, "first": "a"})
    certain, depends, _ = sentences(by_rollouts="certain", verdict="VIOLATED", assumptions=(borders,))
    assert certain.startswith("Certain of the simulator")
    assert says(depends, "time borders windows read: assumption `borders`")


def test_where_rollouts_do_not_follow_from_their_starts_nothing_holds_anyway() -> None:
    most = SpotCheck(
        starts=59, rollouts=Rollouts(nominal=59, true=0), level=0.05, failures=0, failure_probability=0.05,
        most_starts=MostStarts(share=0.1, quantity="robustness", bound=0.5, probability=0.95), problems=(),
    )  # fmt: skip
    assert sentences(spot_check=most)[-1]
    assert not sentences({"refuted": ("reproducible_rollouts",)}, spot_check=most)[-1]


def test_other_constants_have_the_unit_and_are_those_of_the_first_claim() -> None:
    _, changed, _ = sentences(sensitivity=rows(0.50009, None))
    assert says(changed, "B twice >= 0.5000 m SHOWN half length nothing NOT SHOWN")
    _, changed, _ = sentences(sensitivity=rows(-1.0, 0.2))
    assert says(changed, "nothing NOT SHOWN half length >= 0.2000 m SHOWN")


def test_what_is_refuted_is_not_sure_at_all_and_needs_no_constants() -> None:
    found = sentences({"refuted": ("kernel/robustness",)}, sensitivity=rows(0.5, 0.5))
    assert found == ["Not at all: the campaign refutes 1 of its 1 assumption.", ""]


def test_every_refuted_assumption_is_counted() -> None:
    names = ("kernel/robustness", "rkhs_norm/robustness", "workers_honest")
    assert says(sentences({"assumptions": names, "refuted": names[:2]})[0], "^Not refutes 2 of 3 assumptions")


def test_fresh_starts_need_no_kernel() -> None:
    most = MostStarts(share=0.1, quantity="expected_robustness", bound=0.75, probability=0.95)
    spot = SpotCheck(
        starts=9, rollouts=Rollouts(nominal=9, true=0), level=0.05, failures=0, failure_probability=0.3,
        most_starts=most, problems=(),
    )  # fmt: skip
    for claim in ({}, {"vacuous": True}, {"refuted": ("kernel/robustness",)}):
        last = sentences(claim, spot_check=spot)[-1]
        assert says(last, "Without B kernel fresh robustness least 0.7500 m")
    assert sentences({"vacuous": True}, spot_check=spot)[0].startswith("Nothing is claimed")
    of_clipped = most.model_copy(update={"clipped": (-0.2, 1.0)})
    clipped = sentences(spot_check=spot.model_copy(update={"most_starts": of_clipped}))[-1]
    assert says(clipped, "fresh expected robustness clipped [-0.2, 1] least 0.7500 m")


def test_a_violation_by_rollouts_uses_no_kernel() -> None:
    noisy, _ = sentences(by_rollouts="probable", sensitivity=rows(0.5, 0.5))
    assert says(noisy, "^Wrong probability most 0.0500 chance rollouts Kernel norm not")
    exact, _ = sentences(by_rollouts="certain", repeated=True)
    assert says(exact, "^Certain simulator rollout repetition same")
    once, _ = sentences(by_rollouts="certain")
    assert says(once, "^Certain simulator rollout not repeated")


def test_a_violation_by_the_other_bound_has_the_chance_of_the_claim() -> None:
    """Its own bound may hold without any rollout."""
    likely, _ = sentences({"vacuous": True}, verdict="VIOLATED")
    assert says(likely, "assumptions wrong probability most 0.1000")


def test_a_verdict_rests_on_the_constants_of_which_a_mistake_would_change_it() -> None:
    claim = CertificateClaim(
        quantity="expected_robustness", sense=">=", bound=1.25, probability=0.9, rule="single", method="rigorous",
        assumptions=(), refuted=(), by_clip=-1.0,
    )  # fmt: skip
    one, two = campaign(40.0), campaign(40.0, 30.0)
    for bounds, single, several in (
        ((0.1, 0.1), "", ""),
        ((-0.1, 0.1), "B = 40", "the norm bounds B"),
        ((0.1, None), "the length scale", "the length scale"),
        ((-1.0, -0.5), "B = 40 and the length scale", "the norm bounds B and the length scale"),
    ):
        predicate = a_certificate().predicate.model_copy(update={"claims": (claim,), "sensitivity": rows(*bounds)})
        assert rests_on(predicate, one, 0.0) == single
        assert rests_on(predicate, two, 0.0) == several
    without = a_certificate().predicate.model_copy(update={"claims": (claim,), "sensitivity": None})
    assert rests_on(without, one, 0.0) == "", "of a claim that needs no kernel"


def campaign(*norms: float) -> CampaignConfig:
    names = ("nominal_robustness", "sim_gap") if len(norms) == 2 else ("robustness",)
    problems = "".join(
        f'[[problems]]\nname = "{name}"\nalpha = 1\nrkhs_norm = {norm}\nnoise_scale = 0.1\n'
        for name, norm in zip(names, norms, strict=True)
    )
    text = 'horizon = 1\nspecification = "always (y >= 0)"\nclip = [-1, 2]\ngap.kind = "robustness"\n'
    text += 'composition = "sum"\n' if len(norms) == 2 else ""
    return parse_campaign(f'{text}system.name = "s"\nspace.a = [0, 1]\n{problems}'.encode(), "c.toml")
