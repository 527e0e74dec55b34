"""Attacks on the claims of a campaign: each is refuted by its certificate, or listed there as an assumption."""

import json
import math
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import print_certificate
from perfbound.orchestrator.report.collect.wording import worded
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import SimulationError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import Crashed, Function, Stop, noise, predicate, robustness, simulate, statuses, verified

KERNEL = {"nu": 2.5, "length_scale": 1.0}
EXACT = {
    "method": "rigorous",
    "delta": 0.05,
    "alpha": 0.05,
    "rkhs_norm": 0.2,
    "noise_scale": 0.0,
    "prior_mean": -0.7,
    "kernel": KERNEL,
}
"""Right for a function that is about .7 everywhere, and false by 1.2 for one with a hole down to -.71."""
NOISY = EXACT | {"noise_scale": 0.1, "replicates": 2, "max_tests": 12}
SD = 0.1
LIST = {"scenarios": [[0.2, 0.2], [0.5, 0.8], [0.9, 0.4]]}
SCENARIO = {"method": "scenario", "delta": 0.05, "alpha": 1e-6, "replicates": 8}
CHECKS: dict[str, Any] = {"spot_check": 100, "spot_check_followups": 40}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def exact(**changes: Any) -> CampaignConfig:
    return robustness(EXACT, **(CHECKS | changes))


def noisy(**changes: Any) -> CampaignConfig:
    return robustness(NOISY, **({"clip": [0.0, 1.4]} | CHECKS | changes))


def listed(**changes: Any) -> CampaignConfig:
    return robustness(SCENARIO, **({"clip": [0.0, 1.4], "space": LIST, "max_tests": 20} | changes))


def flat(request: RolloutRequest) -> float:
    return 0.7


def honest(request: RolloutRequest) -> float:
    return 0.7 + SD * noise(request.seed)


def sentence(text: str | None, name: str) -> str:
    """Return the sentence of an assumption that every claim lists."""
    found = predicate(text)
    assert all(name in claim["assumptions"] for claim in found["claims"])
    return str({each["id"]: each["detail"] for each in found["assumptions"]}[name])


def refuted(text: str | None) -> list[str]:
    """Return the refuted assumptions; the first claim lists each of them."""
    found = predicate(text)
    broken = [each["id"] for each in found["assumptions"] if each["status"] == "refuted"]
    assert found["claims"][0]["refuted"] == broken
    return broken


@pytest.mark.rest
def test_honest_simulators_are_not_refuted(tmp_path: Path) -> None:
    assert refuted(simulate(tmp_path / "exact", exact(), flat, noisy=False)) == []
    assert refuted(simulate(tmp_path / "noisy", noisy(), honest, noisy=True)) == []
    assert refuted(simulate(tmp_path / "listed", listed(), honest, noisy=True)) == []


# Failures that depend on hidden state


def failing_once(function: Function, how: Callable[[], float]) -> Function:
    """Let every fifth rollout fail in its first attempt; its second one is as if nothing had happened."""
    tried: set[str] = set()

    def found(request: RolloutRequest) -> float | tuple[float, ...]:
        first = request.rollout not in tried
        tried.add(request.rollout)
        return how() if first and request.seed % 5 == 0 else function(request)

    return found


def _raise() -> float:
    raise SimulationError("the solver did not converge")


@pytest.mark.rest
@pytest.mark.parametrize("how", [_raise, lambda: math.nan], ids=["raise", "nan"])
@pytest.mark.parametrize("config", [noisy(), listed()], ids=["box", "list"])
def test_a_failure_that_does_not_repeat_refutes_and_changes_no_number(
    tmp_path: Path, config: CampaignConfig, how: Callable[[], float]
) -> None:
    calm = predicate(simulate(tmp_path / "calm", config, honest, noisy=True))
    text = simulate(tmp_path / "run", config, failing_once(honest, how), noisy=True)
    assert refuted(text) == ["reproducible_rollouts"]
    assert says(sentence(text, "reproducible_rollouts"), "failed another trajectory")
    assert without(predicate(text), "reproducible_rollouts") == without(calm, "reproducible_rollouts")
    assert verified(tmp_path / "run") == []


def without(found: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a predicate without one assumption, and without the refuted ones of the claims."""
    rows = [each for each in found["assumptions"] if each["id"] != name]
    return found | {"assumptions": rows, "claims": [claim | {"refuted": []} for claim in found["claims"]]}


@pytest.mark.rest
def test_outcomes_that_a_hidden_state_selects_are_refuted(tmp_path: Path) -> None:
    """Bad outcomes fail, and a retry draws another one: the mean of what is recorded is too high by .8 sd."""
    hidden = np.random.default_rng(0)

    def selecting(request: RolloutRequest) -> float:
        value = 0.7 + SD * hidden.standard_normal()
        if value < 0.7:
            raise SimulationError(f"fell by {value}")  # another reason each time
        return float(value)

    text = simulate(tmp_path / "run", listed(max_attempts=100, max_tests=40), selecting, noisy=True)
    assert predicate(text)["claims"][0]["bound"] > 0.7, "the claim is false"
    assert refuted(text) == ["reproducible_rollouts"]


@pytest.mark.rest
def test_outcomes_that_crashes_select_are_listed(tmp_path: Path) -> None:
    """Above or below the mean by chance, and a crash below it: what is recorded repeats with its seed."""
    hidden = np.random.default_rng(0)

    def crashing(request: RolloutRequest) -> float:
        if hidden.random() < 0.5:
            raise Crashed("exit code 139")
        return 0.7 + SD * abs(noise(request.seed))

    text = simulate(tmp_path / "run", listed(max_attempts=100, max_tests=40), crashing, noisy=True)
    assert predicate(text)["claims"][0]["bound"] > 0.7, "the claim is false"
    assert refuted(text) == []
    assert statuses(text)["unrelated_crashes"] == "assumed"
    assert says(sentence(text, "unrelated_crashes"), "nothing outcome assumed")


# Replicates that are copies, and results that do not repeat


def copied(request: RolloutRequest) -> float:
    return 0.7 + SD * noise(request.test)


@pytest.mark.rest
@pytest.mark.parametrize("config", [noisy(max_tests=40, recheck=0), listed()], ids=["box", "list"])
def test_replicates_that_are_copies_are_refuted(tmp_path: Path, config: CampaignConfig) -> None:
    text = simulate(tmp_path / "run", config, copied, noisy=True)
    assert "independent_rollouts/robustness" in refuted(text)
    assert "replicates are copies of each other" in sentence(text, "independent_rollouts/robustness")


@pytest.mark.rest
def test_copies_at_starts_with_one_test_each_are_listed(tmp_path: Path) -> None:
    """As if the noise had not shown there; only the recheck finds that this function counts its tests."""
    rows = [[x / 4, y / 4] for x in range(5) for y in range(4)]
    text = simulate(tmp_path / "run", listed(space={"scenarios": rows}, recheck=0), copied, noisy=True)
    assert "independent_rollouts/robustness" not in refuted(text)
    assert "no two rollouts of a test differ" in sentence(text, "independent_rollouts/robustness")


@pytest.mark.rest
@pytest.mark.parametrize("config", [noisy(max_tests=40), listed(max_tests=40)], ids=["box", "list"])
@pytest.mark.parametrize("share", [0.02, 0.5], ids=["rare failure", "pass or fail"])
@pytest.mark.parametrize("spread", [0.0, SD / 10], ids=["else exact", "else noisy"])
def test_results_that_repeat_are_no_copies(tmp_path: Path, config: CampaignConfig, share: float, spread: float) -> None:
    """A simulator whose failures all have one value; every rollout follows from its own seed alone."""

    def failing(request: RolloutRequest) -> float:
        drawn = np.random.default_rng(request.seed)
        return 0.2 if drawn.random() < share else 0.9 + spread * float(drawn.standard_normal())

    text = simulate(tmp_path / "run", config, failing, noisy=True)
    name = "independent_rollouts/robustness"
    assert name not in refuted(text)
    found = {each["id"]: each for each in predicate(text)["assumptions"]}[name]
    assert (found["values"]["copies"] > 0) == (
        "agree bit by bit" in found["detail"] or "differ although" in found["detail"]
    )
    assert verified(tmp_path / "run") == []


@pytest.mark.rest
def test_repeated_results_of_tests_with_one_rollout_are_listed(tmp_path: Path) -> None:
    single = robustness(NOISY | {"replicates": 1, "max_tests": 40}, clip=[0.0, 1.4], **CHECKS)
    text = simulate(tmp_path / "run", single, lambda r: min(honest(r), 0.7), noisy=True)
    assert refuted(text) == []
    assert says(sentence(text, "independent_rollouts/robustness"), "one rollout")


@pytest.mark.rest
def test_noise_that_rollouts_share_without_a_copy_is_listed(tmp_path: Path) -> None:
    """One large error for the whole campaign, and a digit of each rollout's own: nothing shows that they depend."""

    def shared(request: RolloutRequest) -> float:
        return 0.7 + 3 * SD + 1e-9 * noise(request.seed)

    text = simulate(tmp_path / "run", listed(), shared, noisy=True)
    assert refuted(text) == []
    assert statuses(text)["independent_rollouts/robustness"] == "assumed"
    words = "that the simulator draws its noise from the seed alone is assumed"
    assert words in sentence(text, "independent_rollouts/robustness")


@pytest.mark.rest
def test_results_that_do_not_repeat_are_refuted_by_the_recheck(tmp_path: Path) -> None:
    calls = iter(range(10**6))
    text = simulate(tmp_path / "run", exact(), lambda _: 0.7 + 1e-15 * next(calls), noisy=False)
    found = predicate(text)
    assert found["recheck"]["rollouts"] == 20
    assert found["recheck"]["agreed"] < 20
    assert refuted(text) == ["reproducible_rollouts"]
    assert f"only {found['recheck']['agreed']} gave the same" in sentence(text, "reproducible_rollouts")


@pytest.mark.rest
def test_a_sign_of_zero_is_a_difference(tmp_path: Path) -> None:
    again = {"recheck": -0.0}
    text = simulate(tmp_path / "run", exact(), lambda request: again.get(request.problem, 0.0), noisy=False)
    assert predicate(text)["recheck"]["agreed"] == 0


# Several campaigns, and a simulator that drifts


@pytest.mark.rest
def test_the_best_of_several_campaigns_is_listed(tmp_path: Path) -> None:
    text = simulate(tmp_path / "run", listed(), honest, noisy=True)
    assert statuses(text)["only_campaign"] == "assumed"
    assert says(sentence(text, "only_campaign"), "best several certificates")


@pytest.mark.rest
def test_campaigns_with_one_seed_share_no_rollout(tmp_path: Path) -> None:
    configs = listed(), listed(clip=[0.0, 1.5]), listed(max_tests=21), listed(seed=2)
    seeds: list[int] = []

    def listening(request: RolloutRequest) -> float:
        seeds.append(request.seed)
        return honest(request)

    for number, config in enumerate(configs):
        simulate(tmp_path / str(number), config, listening, noisy=True)
    rechecked = 20 * len(configs)
    found = [doubted(tmp_path / str(number)) for number in range(len(configs))]
    assert sum(found) > 0, "the first results of a session"
    assert len(set(seeds)) == len(seeds) - rechecked - sum(found), "a recheck and a doubt repeat a seed, nothing else"


def doubted(directory: Path) -> int:
    """Return the number of attempts that were doubted, and repeated."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        query = "SELECT count(*) FROM attempts GROUP BY rollout"
        return sum(count - 1 for (count,) in connection.execute(query))


@pytest.mark.rest
@pytest.mark.parametrize("drift", [3.0, -3.0])
def test_a_simulator_that_drifts_is_refuted(tmp_path: Path, drift: float) -> None:
    config = listed(max_tests=150)
    calls = iter(range(10**6))

    def drifting(request: RolloutRequest) -> float:
        return honest(request) + drift * SD * min(next(calls) / 1200, 1.0)

    text = simulate(tmp_path / "run", config, drifting, noisy=True, workers=1)
    assert "one_law_per_start/robustness" in refuted(text)
    assert "the simulator drifts" in sentence(text, "one_law_per_start/robustness")


# Starts that the claim does not cover


@pytest.mark.rest
def test_a_claim_over_a_list_says_so(tmp_path: Path) -> None:
    words = "the worst of the 3 listed starts"
    for number, found in enumerate((listed(), robustness(EXACT, space=LIST))):
        text = simulate(tmp_path / str(number), found, flat if number else honest, noisy=not number)
        assert text is not None
        certificate = Certificate.model_validate_json(text)
        console = Console(record=True, width=200)
        print_certificate(certificate, console)
        assert words in next(line for line in console.export_text().splitlines() if line.startswith("CLAIM"))
        assert words in worded(certificate.predicate)[0].sentence
        assert certificate.predicate.claims[0].starts == 3
        assert certificate.predicate.problems[0].objective.startswith("min over the 3 listed starts of ")
        assert verified(tmp_path / str(number)) == []


@pytest.mark.rest
def test_an_edited_number_of_listed_starts_is_caught(tmp_path: Path) -> None:
    simulate(tmp_path / "run", listed(), honest, noisy=True)
    edit(tmp_path / "run", lambda found: found["claims"][0].pop("starts"))
    assert verified(tmp_path / "run") == ["claims"]


# Functions that are not smooth


def hole(x: float, y: float) -> float:
    """5 % of the box: a disc."""
    return -0.71 if (x - 0.31) ** 2 + (y - 0.44) ** 2 < 0.05 / math.pi else 0.7


def jump(x: float, y: float) -> float:
    """5 % of the box, along an edge."""
    return -0.71 if x > 0.93 and 0.1 < y < 0.82 else 0.7


def unnoticed(folder: Path, function: Callable[[float, float], float]) -> tuple[Path, str]:
    """Return the first campaign in which the method tests no start with the low value; in others it refutes B."""
    for seed in range(1, 12):
        directory = folder / str(seed)
        config = exact(spot_check=299, seed=seed)
        text = simulate(directory, config, lambda request: function(*request.x), noisy=False)
        if text is not None and predicate(text)["problems"][0]["stopped_by"] == "converged":
            return directory, text
    raise AssertionError("the method noticed it with every seed")


@pytest.mark.rest
@pytest.mark.parametrize("function", [hole, jump])
def test_a_hole_is_refuted_with_its_start(tmp_path: Path, function: Callable[[float, float], float]) -> None:
    directory, text = unnoticed(tmp_path, function)
    found = predicate(text)
    (problem,), (spot,) = found["problems"], found["spot_check"]["problems"]
    assert found["claims"][0]["bound"] > 0.6
    assert problem["stopped_by"] == "converged"
    assert refuted(text) == ["rkhs_norm/robustness"]
    assert spot["violated_share"] > 0.05
    assert found["spot_check"]["failures"] == spot["violations"] > 0
    assert function(*spot["start"]) == -0.71
    for coordinate in spot["start"]:
        assert f"{coordinate:.6g}" in sentence(text, "rkhs_norm/robustness")
    # What needs no kernel is true: the function is low in a twentieth of the box, and .7 elsewhere.
    most = found["spot_check"]["most_starts"]
    assert (most["share"], most["quantity"], most["probability"]) == (0.1, "robustness", 0.95)
    assert most["bound"] == pytest.approx(0.7, abs=2e-9)
    (claim,) = worded(Certificate.model_validate_json(text).predicate)
    assert says(claim.notes[-1], "kernel: 10 % least 0.7000")
    assert verified(directory) == []


def noisy_hole(request: RolloutRequest) -> float:
    return max(0.0, hole(*request.x)) + SD * abs(noise(request.seed))


@pytest.mark.rest
def test_a_hole_of_a_noisy_function_is_refuted(tmp_path: Path) -> None:
    text = simulate(tmp_path / "run", noisy(), noisy_hole, noisy=True)
    (spot,) = predicate(text)["spot_check"]["problems"]
    assert spot["noisy"]
    assert spot["wealth"] >= 20
    assert "rkhs_norm/robustness" in refuted(text)


@pytest.mark.rest
def test_a_spot_check_tests_the_bound_that_is_claimed(tmp_path: Path) -> None:
    """The last digits of a bound before rounding differ between CPUs, and the certificate may not."""
    found = predicate(simulate(tmp_path, noisy(), honest, noisy=True))
    (problem,), (tested,) = found["problems"], found["spot_check"]["problems"]
    assert tested["limit"] == problem["bound"]


@pytest.mark.rest
def test_replicates_of_a_spot_check_prove_more_of_most_starts(tmp_path: Path) -> None:
    bounds = []
    for replicates in (1, 4):
        directory = tmp_path / str(replicates)
        config = noisy(spot_check=299, spot_check_followups=0, spot_replicates=replicates)
        spot = predicate(simulate(directory, config, two_levels, noisy=True))["spot_check"]
        assert spot["rollouts"]["nominal"] == spot["problems"][0]["rollouts"] == 299 * replicates
        assert spot["most_starts"]["quantity"] == "expected_robustness"
        bounds.append(spot["most_starts"]["bound"])
        assert verified(directory) == []
    # Four fifths have the mean .7, and more than a tenth has .4.
    assert 0.0 < bounds[0] < bounds[1] <= 0.4


def two_levels(request: RolloutRequest) -> float:
    return (0.4 if request.x[0] < 0.2 else 0.7) + 2 * SD * noise(request.seed)


@pytest.mark.rest
def test_where_no_more_than_the_clip_is_proven_nothing_is_said_of_most_starts(tmp_path: Path) -> None:
    text = simulate(tmp_path / "run", noisy(), lambda _: 0.0, noisy=True)
    assert predicate(text)["spot_check"]["most_starts"] is None


# Verification, resumes and workers


def edit(directory: Path, change: Callable[[Any], object]) -> None:
    path = directory / files.CERTIFICATE
    value = json.loads(path.read_text())
    change(value["predicate"])
    path.write_text(Certificate.model_validate_json(json.dumps(value)).to_json())


def _raise_by(step: float, found: dict[str, Any]) -> None:
    found["bound"] += step


def _of(found: dict[str, Any], name: str) -> dict[str, Any]:
    return next(each for each in found["assumptions"] if each["id"] == name)


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign that its spot check, its recheck and a failed attempt refute."""
    directory = tmp_path_factory.mktemp("broken") / "run"
    calls = iter(range(10**6))

    def function(request: RolloutRequest) -> float:
        return hole(*request.x) + 1e-15 * next(calls)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)
        patch.setattr(service, "TICK", 0.01)
        simulate(directory, exact(), failing_once(function, _raise), noisy=False)
    return directory


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda found: found["spot_check"]["problems"][0].update(status="not refuted"), "spot check"),
        (lambda found: found["spot_check"]["problems"][0].update(violations=0), "spot check"),
        (lambda found: found["spot_check"]["problems"][0].update(violated_share=0.01), "spot check"),
        (lambda found: found["spot_check"]["problems"][0].update(start=None), "spot check"),
        (lambda found: found["spot_check"]["problems"][0].update(limit=-0.8), "spot check"),
        (lambda found: found["spot_check"].update(failures=0), "spot check"),
        (lambda found: _raise_by(1e-6, found["spot_check"]["most_starts"]), "spot check"),
        (lambda found: found["spot_check"].update(starts=1000), "spot check"),
        (lambda found: found.pop("spot_check"), "spot check"),
        (lambda found: found["recheck"].update(agreed=20), "recheck"),
        (lambda found: found["recheck"].update(unseen_share=0.05), "recheck"),
        (lambda found: found.pop("recheck"), "recheck"),
        (lambda found: _of(found, "reproducible_rollouts").update(status="not refuted"), "audit"),
        (lambda found: _of(found, "rkhs_norm/robustness").update(status="assumed"), "audit"),
        (lambda found: found["assumptions"].remove(_of(found, "only_campaign")), "audit"),
        (lambda found: found["claims"][0].update(refuted=[]), "claims"),
    ],
)
def test_an_edited_finding_is_caught(broken: Path, tmp_path: Path, change: Callable[[Any], object], line: str) -> None:
    directory = tmp_path / "run"
    directory.symlink_to(broken)
    text = (broken / files.CERTIFICATE).read_text()
    assert set(refuted(text)) == {"rkhs_norm/robustness", "reproducible_rollouts"}
    try:
        edit(directory, change)
        assert line in verified(directory)
    finally:
        (broken / files.CERTIFICATE).write_text(text)
    assert verified(directory) == []


def in_check(name: str, *tests: int) -> Iterator[Stop]:
    """Yield rules that stop a campaign at these tests of a check, one after the other."""
    for test in tests:
        yield lambda request, test=test: request.problem == name and request.test >= test  # type: ignore[misc]


@pytest.mark.rest
@pytest.mark.parametrize(
    ("config", "is_noisy", "function"),
    [
        (exact(), False, lambda request: hole(*request.x)),
        (noisy(), True, noisy_hole),
        (noisy(spot_replicates=2), True, noisy_hole),
    ],
    ids=["exact", "noisy", "replicates"],
)
def test_stops_in_the_checks_change_nothing(
    tmp_path: Path, config: CampaignConfig, function: Function, *, is_noisy: bool
) -> None:
    calm = simulate(tmp_path / "calm", config, function, noisy=is_noisy)
    directory = tmp_path / "stopped"
    # Tests from 100 on are follow-ups, which depend on the observations before them; two replicates need none here.
    points = (0, 30, 99, 110) if is_noisy and config.spot_replicates == 1 else (0, 30, 99)
    stops = [*in_check("spot_check", *points), *in_check("recheck", 0, 7, 19)]
    ends = [simulate(directory, config, function, noisy=is_noisy, stop=stop) for stop in stops]
    assert ends.count(None) >= len(stops) - 1, "it stopped nearly every time"
    assert simulate(directory, config, function, noisy=is_noisy) == calm
    assert verified(directory) == []


@pytest.mark.rest
@pytest.mark.parametrize("workers", [2, 3])
def test_a_recheck_is_simulated_by_another_worker(tmp_path: Path, workers: int) -> None:
    directory = tmp_path / "run"
    simulate(directory, exact(), flat, noisy=False, workers=workers)
    query = "SELECT rollout, worker FROM outcomes WHERE outcome = 'recorded'"
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        worker = dict(connection.execute(query).fetchall())
    journal = Journal.open(directory)
    ledger = Ledger(directory, journal)
    ledger.replay()
    journal.close()
    originals = {each: ledger.closing.original(each) for each in map(RolloutId.parse, worker)}
    pairs = [(str(again), str(original)) for again, original in originals.items() if original]
    assert len(pairs) == 20
    assert all(worker[again] != worker[original] for again, original in pairs)
