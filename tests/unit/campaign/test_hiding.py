"""A statement about clipped values that is false of the values themselves names the clip, in every sentence."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from perfbound.orchestrator.campaign.clip import hiding, reach_of
from perfbound.orchestrator.certificate.verdict import claim_in_plain_words
from perfbound.orchestrator.certificate.words.bound_text import clip_words
from perfbound.orchestrator.certificate.words.text import claim_words, margin_at_most_starts
from perfbound.orchestrator.mathematics.stl.reach import ANY
from perfbound.orchestrator.report.collect.wording import claim_sentence
from perfbound.schemas.file.drawn_claims import SAMPLED, ClaimRequest, DrawnClaim
from perfbound.schemas.file.objectives import Quantity, Reading
from perfbound.schemas.result.certificate import CertificateClaim, MostStarts

LAWS = 40
CLIPS = [(-1.0, 1.0), (-0.05, 0.75), (-10.0, 10.0), (-0.5, 20.0), (-50.0, 0.7)]
REACHES = [ANY, (-math.inf, 0.75), (-1.0, math.inf), (-0.05, 0.75)]
WEIGHT = 0.2
Law = tuple[NDArray[np.float64], NDArray[np.float64]]


def laws() -> Iterator[Law]:
    """Yield values with their probabilities: around one value mostly, with rare falls and jumps of every size."""
    rng = np.random.default_rng(2026)
    for _ in range(LAWS):
        values = rng.normal(rng.uniform(-0.5, 1.0), rng.uniform(0.0, 0.3), size=8)
        weights = rng.dirichlet(np.ones(8)) * (1.0 - (rare := 10.0 ** rng.uniform(-4.0, -0.5)))
        outlier = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-0.5, 4.0)
        yield np.append(values, outlier), np.append(weights, rare)


def quantity(law: Law, reading: Reading) -> float:
    values, weights = law
    mean = float(weights @ values)
    if reading == "risk":
        return mean - WEIGHT * math.sqrt(max(float(weights @ values**2) - mean**2, 0.0))
    return mean if reading == "mean" else float(values.min())


def worded(clip: tuple[float, float] | None, reading: Reading, bound: float) -> Iterator[str]:
    """Yield every sentence that states a lower bound."""
    named: dict[Reading, tuple[Quantity, ...]] = {
        "each": ("robustness", "quantile", "next_rollout", "share_of_starts"),
        "mean": ("expected_robustness", "mean", "cvar", "share_of_starts"),
        "risk": ("rho_star", "risk"),
    }
    for name in named[reading]:
        subject = None
        if name in SAMPLED:
            has_level = {quantity for quantity, row in SAMPLED.items() if row.level}
            asked = ClaimRequest.model_validate({"quantity": name, "level": 0.1 if name in has_level else None})
            subject = DrawnClaim(asked, 0.05).words("expected robustness" if reading == "mean" else "robustness", clip)
        claim = CertificateClaim(
            quantity=name, sense=">=", bound=bound, probability=0.95, rule="single", method="kriging",
            assumptions=("kernel/robustness",), refuted=(), clipped=clip, subject=subject,
        )  # fmt: skip
        yield from (claim_words(claim), claim_sentence(claim), claim_in_plain_words(claim, "m", WEIGHT))
        yield from (claim_words(each) for each in [claim.model_copy(update={"starts": 3})] if subject is None)
    if reading != "risk":
        most = "robustness" if reading == "each" else "expected_robustness"
        yield margin_at_most_starts(
            MostStarts(share=0.1, quantity=most, bound=bound, probability=0.95, clipped=clip)  # type: ignore[arg-type]
        )


@pytest.mark.parametrize("clip", CLIPS, ids=str)
def test_every_sentence_that_is_false_of_the_values_names_the_clip(clip: tuple[float, float]) -> None:
    tried = contradicted = unnamed = 0
    readings: tuple[Reading, ...] = ("each", "mean", "risk")
    for values, weights in laws():
        for within in REACHES:
            law = np.clip(values, *within), weights
            clipped = np.clip(law[0], *clip), weights
            for reading in readings:
                for sense, sign in ((">=", 1.0), ("<=", -1.0)):
                    truth, bound = quantity(law, reading), quantity(clipped, reading)
                    found = hiding(clip, within, reading, sense, risk_weight=WEIGHT, bound=bound)
                    tried += 1
                    if sign * (truth - bound) >= -1e-9:
                        unnamed += found is None
                        continue
                    contradicted += 1
                    assert found == clip, (law, within, reading, sense)
                    if sense == ">=":
                        for sentence in worded(found, reading, bound):
                            assert clip_words(clip) in sentence, sentence
    # The sweep is no test where nothing is contradicted, and no relief where every sentence names the clip.
    assert tried == LAWS * len(REACHES) * len(readings) * 2
    assert contradicted >= 20
    assert unnamed >= 100


def test_a_clip_of_all_that_a_formula_can_reach_is_not_named() -> None:
    for reading in ("each", "mean", "risk"):
        for sense in (">=", "<="):
            assert hiding((-1.0, 0.75), (-1.0, 0.75), reading, sense) is None
    assert hiding((-1.0, 1.0), ANY, "risk", ">=", risk_weight=0.0) == (-1.0, 1.0)
    assert hiding((-1.0, 1.0), (-1.0, math.inf), "risk", ">=", risk_weight=0.0) is None


def test_a_rollout_that_ends_early_and_fails_reaches_below_what_its_formula_can() -> None:
    formula = "always (abs(x) >= -0.05)"
    assert reach_of(formula)[0] >= -0.05
    assert reach_of(formula, "hold") == reach_of(formula)
    assert reach_of(formula, "fail")[0] == -1.0
    assert hiding((-0.5, 2.0), reach_of(formula), "mean", ">=") is None
    assert hiding((-0.5, 2.0), reach_of(formula, "fail"), "mean", ">=") == (-0.5, 2.0)
