"""Constants that contradict each other or the data are named in one line, and nothing else is."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.campaign import consistency
from perfbound.orchestrator.campaign.plan import ProblemPlan, plan
from perfbound.orchestrator.run.display.so_far import Contradictions
from perfbound.orchestrator.run.service import RunStatus
from perfbound.schemas.system import SystemSpec
from perfbound.workers.systems import load_system
from tests.campaigns import config, table
from tests.facts import says
from tests.fakes.finished import a_pair, play


def a_plan(campaign: str = "segway-pair", number: int = 1, **problem: Any) -> ProblemPlan:
    found = table(campaign)
    found["problems"][number] |= problem
    changed = config(campaign, problems=found["problems"])
    return plan(changed, spec(), changed.problems[number])


def spec(*units: str) -> SystemSpec:
    found = load_system("segway").spec
    pairs = zip(found.parameters, units or ("m", "m"), strict=True)
    return found.model_copy(update={"parameters": tuple(p.model_copy(update={"unit": unit}) for p, unit in pairs)})


@pytest.mark.parametrize("campaign", ["segway-pair", "segway-scenario"])
def test_a_good_campaign_has_no_line(campaign: str) -> None:
    found = config(campaign)
    assert consistency.before({p.name: plan(found, spec(), p) for p in found.problems}, spec()) == []


def test_a_length_scale_below_the_spacing() -> None:
    short = a_plan(kernel={"nu": 2.5, "length_scale": 0.1})
    (line,) = consistency.of_plan(short, spec())
    assert says(line, "sim_gap: kernel.length_scale = 0.1 below 0.2 x 0.2 y")
    assert not list(consistency.of_plan(a_plan(kernel={"nu": 2.5, "length_scale": 0.2}), spec()))


def test_one_length_for_two_units() -> None:
    (line,) = consistency.of_plan(a_plan(), spec("m", "rad"))
    assert 'is one length for parameters in "m" and "rad"' in line


def test_a_noise_scale_without_replicates() -> None:
    (line,) = consistency.of_plan(a_plan(noise_scale=0.1, replicates=1), spec())
    assert says(line, "noise_scale = 0.1")
    assert not list(consistency.of_plan(a_plan(noise_scale=0.1, replicates=2), spec()))
    assert not list(consistency.of_plan(a_plan(replicates=1), spec())), "derived"
    assert not list(consistency.of_plan(a_plan(number=0, noise_scale=0.1, replicates=1), spec())), "deterministic"


def keys(plan: ProblemPlan, y: list[float], each: Sequence[tuple[float, ...]], robustness: list[float]) -> set[str]:
    return set(consistency.of_tests(plan, y, each, robustness))


def test_a_norm_below_the_data() -> None:
    wide = a_plan(number=0)  # m0 = -.73, B = .15
    assert keys(wide, [-0.7, -0.6], [], []) == set()
    assert keys(wide, [-0.7, -0.5], [], []) == {"rkhs_norm"}
    assert keys(a_plan(number=0, misspecification=0.1), [-0.7, -0.5], [], []) == set()
    line = consistency.of_tests(wide, [-0.5], [], [])["rkhs_norm"]
    assert says(line, "rkhs_norm = 0.15 below prior_mean| = 0.23")


def test_a_clip_that_hides_everything() -> None:
    found = a_plan()
    assert keys(found, [], [], [0.75] * 10) == keys(found, [], [], [-0.05] * 10) == {"clip"}
    assert keys(found, [], [], [0.75] * 9) == keys(found, [], [], [*[0.75] * 10, 0.7]) == set()
    assert "upper clip 0.75" in consistency.of_tests(found, [], [], [0.75] * 10)["clip"]


@pytest.mark.parametrize(("spread", "wanted"), [(0.1, set()), (0.0012, {"noise_scale"}), (0.0, {"noise_scale"})])
def test_a_noise_scale_far_above_the_spread(spread: float, wanted: set[str]) -> None:
    """R = .4 by Hoeffding's lemma."""
    each = [(0.05 - spread, 0.05 + spread)] * 10
    assert keys(a_plan(), [0.05] * 10, each, []) == wanted
    assert keys(a_plan(), [0.05] * 4, each[:4], []) == set(), "too few"


def test_every_line_is_printed_once_in_a_run(tmp_path: Path) -> None:
    lines: list[str] = []
    campaign = a_pair("rigorous").model_copy(update={"clip": (0.4, 0.5)})
    stage = play(tmp_path / "run", campaign)
    stage.journal.close()
    accounts = stage.ledger.accounts
    listener = Contradictions(accounts, stage.ledger.methods, lines.append)
    progress = {name: account.progress for name, account in accounts.items()}
    for _ in range(3):
        listener.show(RunStatus(campaign, progress, {}, {}, {}, 0, 0, 0.0))
    clipped = [line for line in lines if "at the lower clip 0.4" in line]
    assert len(clipped) == 1, "of sim_gap: the other problem has eight rollouts"
    assert len(lines) == len(set(lines))


def test_a_length_per_parameter_has_its_own_unit_and_spacing() -> None:
    fits = a_plan(kernel={"nu": 2.5, "length_scale": {"x": 3.0, "y": 0.5}})
    assert not list(consistency.of_plan(fits, spec("m", "rad")))
    (line,) = consistency.of_plan(a_plan(kernel={"nu": 2.5, "length_scale": {"x": 3.0, "y": 0.1}}), spec("m", "rad"))
    assert says(line, "length_scale = 3 (x) 0.1 (y) below 0.2 y")


def test_the_robustness_of_the_replicates() -> None:
    values = np.array([0.1, 0.2, 0.3])
    for campaign, number, wanted in [
        ("segway-pair", 0, [-0.1, -0.2, -0.3]),  # of J = -rho
        ("segway-pair", 1, []),  # a gap
        ("segway-scenario", 0, [0.1, 0.2, 0.3]),
        ("segway-direct", 0, [0.1, 0.2, 0.3]),
        ("test-function", 0, []),  # a column
    ]:
        assert consistency.robustness_of(config(campaign).problems[number], values).tolist() == wanted
