"""The verdict on whole campaigns: standing, violated, refuted, vacuous, out of budget, and without a requirement."""

import re
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.certificate import counter_evidence, files
from perfbound.orchestrator.certificate.words.known_text import verdict_lines, violation_words
from perfbound.orchestrator.run.extend import extend_campaign
from perfbound.orchestrator.run.known import verdict_of
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.read import stored_header
from perfbound.schemas.result.known import CampaignVerdict
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts, says
from tests.fakes.simulators import Function, noise, robustness, simulate, spec

RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}
SAMPLE = {"method": "sample"}
FEW = {"spot_check": 0, "recheck": 0}


def smooth(request: RolloutRequest) -> float:
    """Between 0.3 and 0.7."""
    return 0.5 - 0.2 * (sum(request.x) - 1.0)


def shifted(by: float, *, noisy: float = 0.0) -> Function:
    return lambda request: smooth(request) + by + noisy * noise(request.seed)


def verdict(
    directory: Path, problem: dict[str, Any], function: Function, *, noisy: bool = False, **changes: Any
) -> CampaignVerdict:
    assert simulate(directory, robustness(problem, **FEW | changes), function, noisy=noisy) is not None
    certificate = files.read(directory)
    assert certificate is not None
    return verdict_of(directory, stored_header(directory), certificate)


def test_a_bound_beyond_what_is_required_is_shown(tmp_path: Path) -> None:
    found = verdict(tmp_path, RIGOROUS, smooth)
    assert (found.verdict, found.advice) == ("SHOWN", ())
    least, at_worst, untested = found.reasons
    assert says(untested, "bound: `spot_check = 0`")
    assert least == "Required at least 0."
    assert says(at_worst, "probability assumptions most 0.")
    assert "assumptions hold" in found.claim
    assert found.claim.startswith(f"Margin at least {found.bound:.1f}")
    assert found.violations.violations == 0
    assert found.repeat == ""


@pytest.mark.rest
def test_a_larger_margin_may_not_be_shown_by_the_same_campaign(tmp_path: Path) -> None:
    first = verdict(tmp_path / "a", RIGOROUS, smooth)
    same = verdict(tmp_path / "b", RIGOROUS, smooth, required_margin=first.bound)
    assert (same.verdict, same.bound) == ("SHOWN", first.bound), "what is required changes no number"
    least = same.violations.least
    assert least is not None
    more = verdict(tmp_path / "c", RIGOROUS, smooth, required_margin=(first.bound + least) / 2)
    assert more.verdict == "NOT SHOWN"
    assert "does not reach the required" in more.reasons[0]
    assert more.advice[0].startswith("A smaller `alpha`, such as 0.0")
    assert "only 0.0" in more.advice[0]
    beyond = verdict(tmp_path / "d", RIGOROUS, smooth, required_margin=least + 1e-6)
    assert beyond.verdict == "VIOLATED", "a start is below the margin"
    assert f", less than the required {least + 1e-6:g}," in beyond.reasons[0]


def test_one_start_without_noise_violates(tmp_path: Path) -> None:
    found = verdict(tmp_path, RIGOROUS, shifted(-0.35))
    assert found.verdict == "VIOLATED"
    least = found.violations.least
    assert least is not None
    (reason,) = found.reasons
    assert says(reason, f"^At z1 = 1 z2 = {least:.4f} nothing random")
    assert 0 < found.violations.violations == found.violations.violating_starts < found.violations.starts
    text = list(verdict_lines(found))
    assert text[:2] == ["VERDICT  VIOLATED", found.reasons[0]], "the answer comes before the bound"
    assert text[-1].startswith(f"{found.violations.violations} of {found.violations.rollouts} rollouts violate")


NOISY = {**RIGOROUS, "noise_scale": 0.3, "replicates": 4, "alpha": 0.05}


@pytest.mark.rest
@pytest.mark.parametrize(("by", "expected"), [(-0.5, "VIOLATED"), (-0.305, "NOT SHOWN"), (0.4, "SHOWN")])
def test_an_expectation_below_the_margin(tmp_path: Path, by: float, expected: str) -> None:
    found = verdict(tmp_path, NOISY, shifted(by, noisy=0.2), noisy=True, clip=[-1.0, 2.0], max_tests=60)
    assert found.verdict == expected
    assert found.violations.violations > 0 or expected == "SHOWN"
    if expected == "VIOLATED":
        shown, where = found.reasons
        assert says(shown, "expected [-1 2] below 0 probability")
        assert re.fullmatch(
            r"\d+ of \d+ rollouts at z1 = 1, z2 = \S+ are below 0; the mean there, .*, is -0\.\d{4}\.", where
        )
    if expected == "NOT SHOWN":
        assert " tests is spent." in found.reasons[0]
        assert found.advice[0].startswith("New constants in a new campaign"), "its margin is that of the limit"


OUT_OF_BUDGET = {**NOISY, "rkhs_norm": 4.0, "alpha": 0.01}


@pytest.mark.rest
def test_the_advised_number_of_tests_is_enough(tmp_path: Path) -> None:
    """A campaign that ended too early is extended as its advice says, and shows what is required."""
    changes = {**FEW, "clip": [-1.0, 2.0], "max_tests": 40}
    function = shifted(0.4, noisy=0.2)
    found = verdict(tmp_path, OUT_OF_BUDGET, function, noisy=True, **changes)
    assert (found.verdict, found.bound < 0.0) == ("NOT SHOWN", True)
    advised = re.fullmatch(
        rf"About \d+ more tests? \(\d+ to (\d+)\): `perfbound resume {tmp_path} --max-tests (\d+)` continues this "
        r"campaign, and its bound stays valid\.",
        found.advice[0],
    )
    assert advised is not None
    assert int(advised[2]) == 40 + int(advised[1])
    with closing(Journal.open(tmp_path)) as journal:
        assert extend_campaign(tmp_path, journal, int(advised[2]))
    assert verdict(tmp_path, OUT_OF_BUDGET, function, noisy=True, **changes).verdict == "SHOWN"


def test_few_tests_allow_no_number(tmp_path: Path) -> None:
    few = verdict(tmp_path, OUT_OF_BUDGET, shifted(0.4, noisy=0.2), noisy=True, clip=[-1.0, 2.0], max_tests=8)
    assert few.advice == (
        f"More tests: `perfbound resume {tmp_path} --max-tests 20` continues this campaign; 8 are too few to forecast "
        "how many would do.",
    )


def test_a_norm_that_nothing_can_be_shown_with_is_named(tmp_path: Path) -> None:
    huge = {**OUT_OF_BUDGET, "rkhs_norm": 300.0}
    found = verdict(tmp_path, huge, shifted(0.4, noisy=0.2), noisy=True, clip=[-1.0, 2.0], max_tests=20)
    assert says(found.advice[0], "`rkhs_norm` = 300 100 times clip more tests undo")
    assert "perfbound calibrate" in found.advice[0]


def test_without_noise_every_start_may_have_been_tested(tmp_path: Path) -> None:
    found = verdict(tmp_path, {**RIGOROUS, "rkhs_norm": 60.0, "alpha": 1e-9}, smooth, resolution=3, max_tests=9)
    assert found.verdict == "NOT SHOWN"
    assert says(found.advice[0], "`resolution` new campaign other constants: every start")


def test_drawn_starts_are_forecast_as_a_number_of_samples(tmp_path: Path) -> None:
    claims = [{"quantity": "failure_probability"}]
    found = verdict(tmp_path, SAMPLE, smooth, claims=claims, max_tests=59, required_at_most=0.01)
    assert found.verdict == "NOT SHOWN"
    assert found.advice == (
        "About 300 samples in a new campaign with another seed, if none of them violates the specification.",
    )


@pytest.mark.rest
def test_a_false_verdict_is_as_rare_as_its_probability_says(tmp_path: Path) -> None:
    """The least expectation is exactly 0, the hardest case: VIOLATED in at most a fifth of the campaigns."""
    false = sum(
        verdict(
            tmp_path / str(seed),
            {**NOISY, "delta": 0.2},
            shifted(-0.3, noisy=0.2),
            noisy=True,
            clip=[-1.0, 2.0],
            max_tests=10,
            seed=seed,
        ).verdict
        == "VIOLATED"
        for seed in range(24)
    )
    assert false <= 10, "the .99 quantile of 24 campaigns at .2"


def test_a_refuted_claim_shows_nothing(tmp_path: Path) -> None:
    found = verdict(tmp_path, {**RIGOROUS, "rkhs_norm": 0.1, "prior_mean": 0.0}, smooth)
    assert found.verdict == "NOT SHOWN"
    assert says(found.reasons[0], "data norm bound kernel")
    assert says(found.reasons[0], "(rkhs_norm robustness) not rely")
    assert "perfbound calibrate" in found.advice[0]


def test_a_refuted_claim_holds_with_no_probability(tmp_path: Path) -> None:
    refuted = {**RIGOROUS, "rkhs_norm": 0.1, "prior_mean": 0.0, "noise_scale": 0.01}
    found = verdict(
        tmp_path, refuted, shifted(0.0, noisy=0.01), noisy=True, clip=[-1.0, 2.0], required_probability=0.99
    )
    assert "Do not rely on" in found.reasons[0]
    assert says(found.reasons[-1], "probability 0.9500 0.99 required")


def test_a_refuted_claim_does_not_hide_a_violation(tmp_path: Path) -> None:
    found = verdict(tmp_path, {**RIGOROUS, "rkhs_norm": 0.1, "prior_mean": 0.0}, shifted(-0.9))
    assert found.verdict == "VIOLATED"


@pytest.mark.rest
def test_rollouts_come_before_a_claim_that_constants_prove(tmp_path: Path) -> None:
    """A noise scale so large that no audit can refute a norm: every rollout violates what the constants prove."""
    certain = {**NOISY, "noise_scale": 20.0, "rkhs_norm": 0.1, "prior_mean": -0.5}
    found = verdict(tmp_path, certain, shifted(-1.0, noisy=0.1), noisy=True, clip=[-1.0, 2.0], max_tests=60)
    assert found.bound > 0.0
    assert found.verdict == "VIOLATED"
    assert found.by_rollouts == "probable"


def test_a_start_that_looks_bad_is_named_where_its_rollouts_are_too_few(tmp_path: Path) -> None:
    """A refuted norm: other constants would not make the claim true."""

    def hole(request: RolloutRequest) -> float:
        return (-0.7 if request.x == (1.0, 1.0) else 1.8) + 0.1 * noise(request.seed)

    found = verdict(
        tmp_path, {**NOISY, "rkhs_norm": 0.1, "prior_mean": -1.8}, hole, noisy=True, clip=[-4.0, 6.0], max_tests=82
    )
    assert found.verdict == "NOT SHOWN"
    (named,) = (reason for reason in found.reasons if " at z1 = 1, z2 = 1 " in reason)
    assert re.fullmatch(
        r"(\d+) of \1 rollouts at z1 = 1, z2 = 1 are below 0; the mean there, .*, is -0\.\d{4}\.", named
    )
    assert says(found.advice[0], "start alone campaign method `scenario`")


def test_rollouts_that_do_not_follow_from_their_seeds_show_nothing_of_a_start(tmp_path: Path) -> None:
    """Each rollout has one of two values by chance, be it a repetition."""
    drawn = np.random.default_rng(1)
    found = verdict(tmp_path, RIGOROUS, lambda _: float(drawn.choice((-0.4, 0.6))), recheck=20)
    assert found.verdict == "NOT SHOWN"
    assert says(found.reasons[0], "rollout seed (reproducible_rollouts)")
    assert "rkhs_norm" in found.reasons[0]
    assert found.advice == ("Find the cause of what is refuted first: more rollouts do not help.",)
    assert found.violations.violations > 0


@pytest.mark.rest
def test_a_bound_that_no_fresh_start_tested_is_not_shown(tmp_path: Path) -> None:
    """A violation ended the campaign: of a noisy system it says nothing of the mean."""

    def hole(request: RolloutRequest) -> float:
        return (-0.3 if 0.4 < request.x[0] < 0.47 else 0.5) + 0.4 * noise(request.seed)

    certain = {**NOISY, "noise_scale": 0.6, "rkhs_norm": 0.1, "prior_mean": -0.5}
    changes: dict[str, Any] = {"clip": [-1.0, 2.0], "max_tests": 60, "spot_check": 100}
    ended = verdict(tmp_path / "a", certain, hole, noisy=True, until_counterexample=True, **changes)
    assert (ended.verdict, ended.bound > 0.0) == ("NOT SHOWN", True)
    assert says(ended.reasons[0], "violation ended campaign fresh start bound")
    assert "fresh starts test the bound" in ended.advice[0]
    assert verdict(tmp_path / "b", certain, hole, noisy=True, **changes).verdict != "SHOWN"
    none = verdict(tmp_path / "c", certain, shifted(0.2, noisy=0.1), noisy=True, **changes | {"spot_check": 0})
    assert (none.verdict, none.reasons[-1]) == ("SHOWN", "No fresh start tested this bound: `spot_check = 0`.")


def test_the_opposite_needs_the_required_probability_too(tmp_path: Path) -> None:
    verdict(tmp_path, {**NOISY, "delta": 0.4}, shifted(0.0, noisy=0.2), noisy=True, clip=[-1.0, 2.0], max_tests=20)
    certificate = files.read(tmp_path)
    assert certificate is not None
    predicate, header = certificate.predicate, stored_header(tmp_path)
    partner = predicate.problems[0].partner
    assert partner is not None
    (reason,) = _reasons(
        counter_evidence._by_partner(header, predicate, counter_evidence.Required(partner + 1e-6, 0.5, ""))
    )
    assert says(reason, f"least 0.6000 {len(predicate.claims[0].assumptions)} assumptions")
    assert counter_evidence._by_partner(header, predicate, counter_evidence.Required(partner + 1e-6, 0.99, "")) is None
    assert counter_evidence._by_partner(header, predicate, counter_evidence.Required(partner, 0.5, "")) is None


def _reasons(found: counter_evidence.VerdictFinding | None) -> tuple[str, ...]:
    assert found is not None
    return found.reasons


@pytest.mark.rest
def test_a_margin_of_clipped_values_says_so(tmp_path: Path) -> None:
    """The mean itself may be lower by any amount, also where no rollout was at the clip."""

    def rare(request: RolloutRequest) -> float:
        return -1000.0 if request.x == (1.0, 1.0) else 1.5 + 0.2 * noise(request.seed)

    certain = {**NOISY, "rkhs_norm": 2.0, "prior_mean": -2.0}
    unseen = verdict(tmp_path / "a", certain, shifted(1.0), noisy=True, clip=[-0.2, 4.0])
    found = verdict(tmp_path / "b", certain, rare, noisy=True, clip=[-0.2, 4.0], max_tests=82)
    assert (unseen.clipped, found.clipped) == (False, True)
    for each in (unseen, found):
        assert says(each.claim, "expected robustness: mean noise [-0.2 4]")
        assert each.clip == (-0.2, 4.0)


@pytest.mark.rest
def test_a_verdict_says_how_many_values_the_clip_hides(tmp_path: Path) -> None:
    """A mean of clipped values is shown; one rollout was far below the clip."""

    def rare(request: RolloutRequest) -> float:
        return -1000.0 if request.x == (1.0, 1.0) and request.seed % 7 == 0 else 1.5 + 0.2 * noise(request.seed)

    known = {**NOISY, "rkhs_norm": 2.0, "prior_mean": -1.5}
    found = verdict(tmp_path, known, rare, noisy=True, clip=[-0.2, 4.0], max_tests=82)
    assert found.verdict == "SHOWN"
    (hidden,) = [each for each in found.reasons if each.startswith("The claim is about the clipped robustness: ")]
    assert says(hidden, "of 328 values robustness lower clip -0.2 may be lower")
    assert ": 0 of" not in hidden


RISK = {"name": "true_risk", "method": "scenario", "alpha": 0.01, "replicates": 20, "delta": 0.05}


@pytest.mark.rest
@pytest.mark.parametrize(
    ("linearised", "word", "two_sided"),
    [(None, "NOT SHOWN", False), ({"centre": 0.3, "spread": 0.2}, "SHOWN", False), ("past", "SHOWN", True)],
)
def test_a_risk_has_a_bound_from_above_by_its_mean_alone(
    tmp_path: Path, linearised: Any, word: str, *, two_sided: bool
) -> None:
    """The limit of a bound through [BD] or fixed constants is below the risk, here by up to .9: it violates nothing."""
    problem = RISK | ({} if linearised is None else {"linearised": linearised})
    box = {"scenarios": [[0.1, 0.1], [0.9, 0.9]]}
    changes: dict[str, Any] = {"space": box, "clip": [-1.0, 1.0], "risk_weight": 1.0, "max_tests": 40, "horizon": 1.0}
    system = spec(noisy=True).model_copy(update={"variants": ("true",), "noisy": ("true",)})
    config = robustness(problem, **FEW | changes, required_margin=0.1)
    assert simulate(tmp_path, config, lambda request: 0.3 + 0.001 * noise(request.seed), noisy=True, system=system)
    certificate = files.read(tmp_path)
    assert certificate is not None
    found = verdict_of(tmp_path, stored_header(tmp_path), certificate)
    assert found.verdict == word, found.reasons
    assert any("it is at most 0.3" in reason for reason in found.reasons) == two_sided


def test_a_vacuous_claim_shows_nothing(tmp_path: Path) -> None:
    few = {**NOISY, "noise_scale": "derived", "rkhs_norm": 50.0}
    found = verdict(tmp_path, few, shifted(0.1, noisy=0.1), noisy=True, clip=[-0.5, 2.0], max_tests=3)
    assert found.verdict == "NOT SHOWN"
    assert says(found.reasons[0], "bound nothing: clip without rollout")


@pytest.mark.rest
@pytest.mark.parametrize(
    ("required", "by", "expected"),
    [(None, 0.0, "NOT SHOWN"), (None, -0.35, "VIOLATED"), (0.05, 0.0, "SHOWN"), (0.05, -0.45, "VIOLATED")],
)
def test_a_failure_probability_needs_a_limit(tmp_path: Path, required: float | None, by: float, expected: str) -> None:
    limit: dict[str, Any] = {} if required is None else {"required_at_most": required}
    found = verdict(tmp_path, SAMPLE, shifted(by), max_tests=200, **limit)
    assert found.verdict == expected
    if expected == "NOT SHOWN":
        assert found.reasons == ("The campaign file does not say the largest acceptable probability.",)
        assert "required_at_most" in found.advice[0]


@pytest.mark.rest
def test_the_advice_counts_samples_and_not_their_replicates(tmp_path: Path) -> None:
    """One rollout of 50 violates: about 4 of 200 samples, which have 16 violations with their replicates."""

    def rare(request: RolloutRequest) -> float:
        return 0.5 - 0.1 * noise(request.seed) - (1.0 if noise(request.seed) > 2.05 else 0.0)

    changes: dict[str, Any] = {"max_tests": 200, "replicates": 4, "required_at_most": 0.025, "clip": [-2.0, 2.0]}
    found = verdict(tmp_path, SAMPLE, rare, noisy=True, **changes)
    assert found.verdict == "NOT SHOWN"
    assert found.violations.violations > 0.025 * 200, "of all 800 rollouts"
    (advice,) = found.advice
    assert advice.startswith("About ")
    assert says(advice, "samples new campaign another seed")


def test_a_counterexample_that_ended_a_campaign_leaves_no_bound_to_improve(tmp_path: Path) -> None:
    """Method `sample` has no alpha."""
    changes: dict[str, Any] = {"max_tests": 200, "required_at_most": 0.05, "until_counterexample": True}
    found = verdict(tmp_path, SAMPLE, shifted(-0.35), **changes)
    assert found.verdict == "NOT SHOWN"
    assert says(found.advice[0], "new campaign without `falsify` `until_counterexample`")


@pytest.mark.rest
def test_who_accepts_no_violation_gets_none(tmp_path: Path) -> None:
    """A noisy system, of which one rollout is enough."""
    found = verdict(tmp_path, SAMPLE, shifted(-0.2, noisy=0.1), noisy=True, max_tests=200)
    assert 0 < found.violations.violations < 100
    assert found.verdict == "VIOLATED"
    assert says(found.reasons[0], "rollout violates campaign file")
    assert "required_at_most" in found.advice[0]


@pytest.mark.rest
@pytest.mark.parametrize(
    ("claim", "by", "expected"),
    [
        ({"quantity": "quantile", "level": 0.1}, 0.0, "SHOWN"),
        ({"quantity": "quantile", "level": 0.1}, -0.5, "VIOLATED"),
        ({"quantity": "cvar", "level": 0.2}, -0.5, "VIOLATED"),
        ({"quantity": "mean"}, -0.7, "VIOLATED"),
        ({"quantity": "mean"}, -0.49, "NOT SHOWN"),
        ({"quantity": "next_rollout", "level": 0.05}, -0.7, "NOT SHOWN"),
    ],
)
def test_claims_about_drawn_starts(tmp_path: Path, claim: dict[str, Any], by: float, expected: str) -> None:
    found = verdict(tmp_path, SAMPLE, shifted(by), max_tests=200, clip=[-2.0, 2.0], claims=[claim])
    assert found.verdict == expected


@pytest.mark.rest
def test_a_claim_about_the_next_rollout_says_that_it_is_about_one(tmp_path: Path) -> None:
    claim = {"quantity": "next_rollout", "level": 0.1}
    found = verdict(tmp_path, SAMPLE, shifted(-0.31), max_tests=200, clip=[-2.0, 2.0], claims=[claim])
    assert (found.verdict, found.violations.violations > 0) == ("SHOWN", True)
    assert found.reasons[-1].startswith("This is about one next rollout alone")


def test_one_violation_has_a_verb_and_a_unit_of_one_is_no_number(tmp_path: Path) -> None:
    found = verdict(tmp_path, RIGOROUS, smooth)
    one = found.violations.model_copy(update={"violations": 1, "violating_starts": 1, "rollouts": 320, "starts": 9})
    words = violation_words(found.model_copy(update={"unit": "1", "violations": one}))
    assert re.fullmatch(r"1 of 320 rollouts violates the specification, at 1 of 9 starts, the worst 0\.\d{4}\.", words)


@pytest.mark.rest
def test_a_smaller_probability_than_required_is_said(tmp_path: Path) -> None:
    changes: dict[str, Any] = {"clip": [-1.0, 2.0], "max_tests": 60}
    found = verdict(tmp_path, NOISY, shifted(0.4, noisy=0.2), noisy=True, required_probability=0.99, **changes)
    assert (found.verdict, found.required_probability) == ("NOT SHOWN", 0.99)
    assert found.reasons == ("It holds with probability 0.9500, and 0.99 is required.",)
    assert found.advice == ("A smaller `delta`; or a smaller `required_probability`, if that is enough.",)


@pytest.mark.rest
def test_a_smaller_delta_alone_does_not_help_where_its_complement_is_required(tmp_path: Path) -> None:
    """Method `paper` has less than 1 - delta, whatever delta is."""
    paper = {
        "method": "paper",
        "alpha": 0.1,
        "c": 0.4,
        "rkhs_norm": 2.0,
        "noise_scale": 0.2,
        "kernel": {"length_scale": 0.7},
    }
    changes: dict[str, Any] = {"noisy": True, "clip": [-1.0, 2.0], "max_tests": 30}
    found = verdict(tmp_path / "a", paper, shifted(1.2, noisy=0.2), **changes)
    assert found.probability < found.required_probability == 0.95
    (advice,) = found.advice
    enough = re.match(
        r"`required_probability = (0\.9\d)`, if that is enough; or `required_probability = 0\.95` and", advice
    )
    assert enough is not None
    follows = verdict(tmp_path / "b", paper, shifted(1.2, noisy=0.2), required_probability=float(enough[1]), **changes)
    assert follows.verdict == "SHOWN"
    smaller = {**paper, "delta": 0.01, "c": 0.6}
    assert (
        verdict(tmp_path / "c", smaller, shifted(1.2, noisy=0.2), required_probability=0.95, **changes).verdict
        == "SHOWN"
    )


@pytest.mark.parametrize(
    ("problem", "key"),
    [(RIGOROUS, "required_margin"), (SAMPLE, "required_at_most"), (RIGOROUS, "required_probability")],
)
def test_what_is_required_is_no_part_of_the_identity(problem: dict[str, Any], key: str) -> None:
    assert robustness(problem, **{key: 0.5}).digest == robustness(problem).digest


FAILURES, MEAN = {"quantity": "failure_probability"}, {"quantity": "mean"}


@pytest.mark.parametrize(
    ("problem", "changes", "line"),
    [
        (RIGOROUS, {"required_at_most": 0.0}, "required_at_most: first claim below; remove required_margin"),
        (SAMPLE, {"claims": [MEAN, FAILURES], "required_at_most": 0.1}, "required_at_most: below; required_margin"),
        (SAMPLE, {"claims": [FAILURES, MEAN], "required_margin": 0.1}, "required_margin: above; required_at_most"),
    ],
)
def test_a_requirement_of_a_bound_from_the_other_side_is_refused(
    problem: dict[str, Any], changes: dict[str, Any], line: str
) -> None:
    with pytest.raises(ValueError, match=facts(line)):
        robustness(problem, clip=[-1.0, 2.0], **changes)


def test_a_margin_that_no_clipped_value_can_have_is_refused() -> None:
    with pytest.raises(ValueError, match=facts("required_margin: 0.5 below 0.5")):
        robustness(RIGOROUS, clip=[-1.0, 0.5], required_margin=0.5)


def test_a_clip_below_the_margin_violates_nothing(tmp_path: Path) -> None:
    """A file from before there was a margin: every clipped value is below 0, and no robustness is."""
    found = verdict(tmp_path, {**RIGOROUS, "prior_mean": 1.0}, smooth, clip=[-2.0, -0.5])
    assert found.verdict == "NOT SHOWN"


@pytest.mark.rest
def test_the_mean_of_the_least_of_several_requirements_shows_nothing_of_each(tmp_path: Path) -> None:
    """Each has a mean well above 0, and nearly every rollout violates one of them."""
    two = {
        "up": {"formula": "value >= -0.05"},
        "down": {"formula": "value <= 0.25"},
    }
    entries = [{"name": name, **each} for name, each in two.items()]
    function: Function = lambda request: 0.1 + 0.6 * noise(request.seed)  # noqa: E731
    found = verdict(
        tmp_path,
        {**NOISY, "rkhs_norm": 0.5, "noise_scale": 0.7, "alpha": 0.3},
        function,
        noisy=True,
        clip=[-2.0, 2.0],
        max_tests=40,
        specification=None,
        specifications=entries,
    )
    assert found.violations.violations > found.violations.rollouts / 3
    assert found.verdict != "VIOLATED"
