"""Verdicts, claims, assumptions and how sure a result is."""

import functools
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from perfbound.orchestrator.certificate.words.control_text import control_sentence
from perfbound.orchestrator.certificate.words.known_text import verdict_lines
from perfbound.orchestrator.certificate.words.refutation_text import counterexample_parts, simplest_words
from perfbound.orchestrator.certificate.words.search_text import failure_parts, search_parts
from perfbound.orchestrator.certificate.words.text import notes
from perfbound.orchestrator.cli.result import print_end, print_everything
from perfbound.orchestrator.run import service
from perfbound.orchestrator.run.directory import finished_certificate
from perfbound.orchestrator.store.read import stored_header
from perfbound.schemas.result.certificate import (
    Assumption,
    Bounded,
    BoundedDisturbance,
    ClosestStart,
    Counterexample,
    DrawnValue,
    FailureAtStart,
    FailureCluster,
    Failures,
    LikeliestFailure,
    MostStarts,
    RandomTests,
    Rollouts,
    Search,
    Simplest,
    SpotCheck,
)
from perfbound.schemas.result.known import CampaignVerdict
from perfbound.schemas.rollout import RolloutRequest
from tests.fakes.simulators import noise, robustness, simulate
from tests.texts import Cases
from tests.unit.campaign import test_regions, test_sample, test_starts
from tests.unit.certificate import test_sensitivity, test_verdict
from tests.unit.certificate.words import test_confidence, test_control_text, test_text

ROOT = Path(__file__).parents[2]
FINISHED = Path("tests/fixtures/finished")
WIDTH = 100


@contextmanager
def hurried(folder: Path = ROOT) -> Iterator[None]:
    """Nothing waits for the disk or for a clock; paths are relative, since lines end where they are long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)
        patch.setattr(service, "TICK", 0.01)
        patch.chdir(folder)
        yield


def verdicts(folder: Path) -> Cases:
    """Yield the verdict on campaigns: standing, violated, refuted, vacuous, out of budget, without a requirement."""
    with hurried(folder):
        for name, make in _VERDICTS.items():
            yield name, "\n".join(verdict_lines(make(Path(name.replace(" ", "-")))))


def shown(_folder: Path) -> Cases:
    """Yield everything that is printed of the finished campaigns."""
    with hurried():
        for directory in sorted(each for each in FINISHED.iterdir() if each.is_dir()):
            header, certificate = stored_header(directory), finished_certificate(directory)
            console = _console()
            print_end(directory, header, certificate, console)
            yield f"the end of {directory.name}", _text(console)
            console = _console()
            print_everything(directory, header, certificate, console, assumptions=True)
            yield f"perfbound show {directory.name} --assumptions", _text(console)


def claims(folder: Path) -> Cases:
    """Yield claims of every kind, and how sure each is."""
    with hurried(folder):
        drawn = test_sample.several(claims=test_sample.LEVELS, replicates=2)
        simulate(Path("drawn"), drawn, test_sample.shaky, noisy=True)
        yield "every claim about drawn starts", _end(Path("drawn"))
        simulate(Path("fixed"), robustness(test_starts.EXACT, candidates=16), test_starts.hill, noisy=False)
        yield "fixed starts", _end(Path("fixed"))
        divided = robustness(test_regions.EXACT, regions=True, spot_check=12, recheck=2, max_tests=20)
        simulate(Path("regions"), divided, test_regions.wave, noisy=False)
        yield "regions", _end(Path("regions"))
        simulate(Path("hole"), divided, test_regions.gone, noisy=False)
        yield "regions with a hole", _end(Path("hole"))
    for values in ({}, {"without_data": -0.06}, {"bound": 0.46}, {"bound": 0.4}):
        found = notes(test_sensitivity.a_claim(**values), 0)
        yield f"the share of the rollouts: {values}", "\n".join(found)
    for bound, parts in ((0.48, test_control_text.BOTH), (0.48, test_control_text.GUST), (None, {})):
        result = test_control_text.a_result(parts)
        yield (
            f"a control, {bound} without it: {parts}",
            control_sentence(test_sensitivity.a_claim().claims[0], bound, [result]),
        )
    yield from _disturbances()
    yield from _searched()
    yield from _confidence()
    assumptions = (
        Assumption(id="rkhs_norm/maximum", status="refuted", detail="B is wrong."),
        Assumption(id="workers_honest", status="assumed", detail="believed."),
        Assumption(id="clip/maximum", status="derived", detail="in [bold] :warning: [/]"),
    )
    yield "a refuted claim", "\n".join(test_text.printed(test_text.a_certificate(*assumptions)))


def _disturbances() -> Cases:
    """Yield what is said of bounded disturbances, and of the likeliest failure."""
    gust = BoundedDisturbance(name="gust", low=-3, high=3, unit="sd", values=(-6, 6), unit_of_values="m/s")
    mass = BoundedDisturbance(name="mass", low=0.9, high=1.1, unit="kg", values=(0.9, 1.1), unit_of_values="kg")
    for each, safe in (((gust,), None), ((gust, mass), 0.0026998)):
        bounded = Bounded(disturbances=each, outside=0.0026998, failure_probability=safe)
        found = test_sensitivity.a_claim().model_copy(update={"bounded": bounded})
        yield f"bounded: {', '.join(one.name for one in each)}", "\n".join(notes(found, 0))
    near = LikeliestFailure(
        start={"speed": 30.0, "gust": 2.9},
        disturbances={"gust": DrawnValue(value=5.8, unit="m/s")},
        distance=2.9,
        robustness=-0.001,
        rollout="shrink.47.nominal.0",
        rollouts=75,
        at_start=FailureAtStart(bound=0.000731299, probability=0.95, rollouts=200, failures=81, share=0.1),
    )
    counterexample = Counterexample(
        rollout="robustness.2.nominal.0",
        test=2,
        rollouts=1,
        start={"speed": 30.0, "gust": 4.5},
        disturbances={"gust": DrawnValue(value=9.0, unit="m/s")},
        seed=7,
        robustness=-0.25,
        likeliest=near,
    )
    yield "the likeliest failure", "; ".join(counterexample_parts(counterexample, "m", {"speed": "m/s", "gust": "sd"}))


def _searched() -> Cases:
    """Yield what is said of several failures, of the simplest ones, and of a search without one."""
    near = Simplest(
        nominal={"speed": 20.0, "gap": 30.0},
        start={"speed": 30.0, "gap": 30.0},
        away=("speed",),
        robustness=-0.125,
        rollout="simplest.2.nominal.0",
        rollouts=3,
    )
    one = FailureCluster(
        violated=("always gap > 2",),
        tests=3,
        starts={"speed": (28.0, 31.0), "gap": (5.0, 9.0)},
        start={"speed": 30.0, "gap": 5.0},
        robustness=-0.25,
        rollout="robustness.8.nominal.0",
        seed=7,
        simplest=near,
    )
    other = one.model_copy(update={"violated": (), "tests": 1, "simplest": near.model_copy(update={"away": ()})})
    units = {"gap": "m", "speed": "m/s"}
    found = Failures(clusters=(one, other), undecided=1)
    yield "clusters of failing starts", "\n".join(failure_parts(found, "m", units))
    yield "clusters on one screen", "\n".join(failure_parts(found, "m", units, most=1))
    left = near.model_copy(update={"away": ("speed", "gap")})
    yield "a failure that is not simplified", simplest_words(left, "m", units)
    closest = ClosestStart(start=near.start, robustness=0.01, rollout="robustness.5.nominal.0", seed=3)
    for failures, share in ((0, (0.0, 0.0484)), (2, (0.0021, 0.1134))):
        drawn = RandomTests(tests=75, failures=failures, share=share, probability=0.95)
        searched = Search(at_random=drawn, closest=None if failures else closest)
        yield f"a search with {failures} failures at random", "\n".join(search_parts(searched, "m", units))


def _confidence() -> Cases:
    sure = test_confidence.sentences
    names = ("rkhs_norm/robustness", "kernel/robustness", "workers_honest")
    borders = Assumption(id="borders", status="assumed", detail="so", values={"number": 1, "rollouts": 3, "first": "a"})
    most = MostStarts(share=0.1, quantity="expected_robustness", bound=0.75, probability=0.95)
    fresh = SpotCheck(
        starts=9,
        rollouts=Rollouts(nominal=9, true=0),
        level=0.05,
        failures=0,
        failure_probability=0.3,
        most_starts=most,
        problems=(),
    )
    for name, found in {
        "a claim that rests on a kernel": sure(),
        "certain": sure({"probability": 1.0}),
        "other constants": sure(sensitivity=test_confidence.rows(0.5, None), verdict="SHOWN"),
        "refuted": sure({"assumptions": names, "refuted": names[:2]}),
        "fresh starts": sure(spot_check=fresh),
        "fresh starts of a vacuous claim": sure({"vacuous": True}, spot_check=fresh),
        "a violation by rollouts": sure(by_rollouts="probable", verdict="VIOLATED"),
        "a violation without noise": sure(by_rollouts="certain", verdict="VIOLATED", repeated=True),
        "a violation that was not repeated": sure(by_rollouts="certain", verdict="VIOLATED"),
        "a violation at a border": sure(by_rollouts="certain", verdict="VIOLATED", assumptions=(borders,)),
        "a violation by the other bound": sure(verdict="VIOLATED"),
    }.items():
        yield f"how sure: {name}", "\n".join(each for each in found if each)


def _end(directory: Path) -> str:
    console = _console()
    print_everything(directory, stored_header(directory), finished_certificate(directory), console, assumptions=True)
    return _text(console)


def _console() -> Console:
    return Console(file=io.StringIO(), width=WIDTH)


def _text(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def _hole(request: RolloutRequest) -> float:
    return (-0.7 if request.x == (1.0, 1.0) else 1.8) + 0.1 * noise(request.seed)


def _cut_short(request: RolloutRequest) -> float:
    return (-0.3 if 0.4 < request.x[0] < 0.47 else 0.5) + 0.4 * noise(request.seed)


def _by_chance(directory: Path) -> CampaignVerdict:
    drawn = np.random.default_rng(1)
    function = lambda _: float(drawn.choice((-0.4, 0.6)))  # noqa: E731
    return test_verdict.verdict(directory, test_verdict.RIGOROUS, function, recheck=20)


def _of(problem: dict[str, Any], function: Any, **changes: Any) -> Any:
    return functools.partial(test_verdict.verdict, problem=problem, function=function, **changes)


_exact, _noisy, _shifted, _smooth = (
    test_verdict.RIGOROUS,
    {**test_verdict.NOISY, "replicates": 2},
    test_verdict.shifted,
    test_verdict.smooth,
)
_CLIP = {"noisy": True, "clip": [-1.0, 2.0]}
_refuted = {**_exact, "rkhs_norm": 0.1, "prior_mean": 0.0}
_certain = {**_noisy, "noise_scale": 0.6, "rkhs_norm": 0.1, "prior_mean": -0.5}
_short = {**test_verdict.OUT_OF_BUDGET, "replicates": 2}
_VERDICTS: dict[str, Any] = {
    "a bound beyond what is required": _of(_exact, _smooth),
    "a larger margin": _of(_exact, _smooth, required_margin=0.28),
    "one start without noise violates": _of(_exact, _shifted(-0.35)),
    "an expectation below the margin": _of(_noisy, _shifted(-0.5, noisy=0.2), max_tests=20, **_CLIP),
    "an expectation near the margin": _of(_noisy, _shifted(-0.305, noisy=0.2), max_tests=20, **_CLIP),
    "a forecast of more tests": _of(_short, _shifted(0.4, noisy=0.2), max_tests=32, **_CLIP),
    "too few tests for a forecast": _of(_short, _shifted(0.4, noisy=0.2), max_tests=8, **_CLIP),
    "a norm that nothing can be shown with": _of(
        {**_short, "rkhs_norm": 300.0}, _shifted(0.4, noisy=0.2), max_tests=20, **_CLIP
    ),
    "every start was tested": _of({**_exact, "rkhs_norm": 60.0, "alpha": 1e-9}, _smooth, resolution=3, max_tests=9),
    "too few samples": _of(
        test_verdict.SAMPLE, _smooth, claims=[{"quantity": "failure_probability"}], max_tests=59, required_at_most=0.01
    ),
    "no acceptable probability": _of(test_verdict.SAMPLE, _smooth, max_tests=60),
    "no acceptable probability and a violation": _of(test_verdict.SAMPLE, _shifted(-0.35), max_tests=60),
    "a search found none": _of(test_verdict.SAMPLE, _smooth, max_tests=60, falsify={}),
    "a search found a counterexample": _of(test_verdict.SAMPLE, _shifted(-0.35), max_tests=60, falsify={}),
    "a counterexample ended it": _of(
        test_verdict.SAMPLE, _shifted(-0.35), max_tests=60, required_at_most=0.05, until_counterexample=True
    ),
    "a refuted claim": _of(_refuted, _smooth),
    "a refuted claim with too small a probability": _of(
        {**_refuted, "noise_scale": 0.01}, _shifted(0.0, noisy=0.01), required_probability=0.99, **_CLIP
    ),
    "a start that looks bad": _of(
        {**_noisy, "rkhs_norm": 0.1, "prior_mean": -1.8}, _hole, noisy=True, clip=[-4.0, 6.0], max_tests=82
    ),
    "rollouts that do not follow from their seeds": _by_chance,
    "a violation before any fresh start": _of(
        _certain, _cut_short, until_counterexample=True, max_tests=60, spot_check=100, **_CLIP
    ),
    "a vacuous claim": _of(
        {**_noisy, "noise_scale": "derived", "rkhs_norm": 50.0},
        _shifted(0.1, noisy=0.1),
        noisy=True,
        clip=[-0.5, 2.0],
        max_tests=3,
    ),
    "too small a probability": _of(_noisy, _shifted(0.4, noisy=0.2), required_probability=0.99, max_tests=20, **_CLIP),
    "about the next rollout": _of(
        test_verdict.SAMPLE,
        _shifted(-0.31),
        max_tests=60,
        clip=[-2.0, 2.0],
        claims=[{"quantity": "next_rollout", "level": 0.1}],
    ),
}
