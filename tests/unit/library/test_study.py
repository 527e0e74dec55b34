"""Ask and tell: what is admitted, what is refused, and what is left after a restart."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.library.study import Study, TrialRequest
from perfbound.orchestrator.certificate.words.text import claim_words
from perfbound.schemas.errors import CampaignError, DefinitionError, PerfboundError
from perfbound.schemas.trajectory.trajectory import encode
from tests.facts import facts, says
from tests.patience import PATIENCE
from tests.tampering import editing

KEYS: dict[str, Any] = {
    "space": {"x": (0, 1)},
    "specification": "always (y <= 2)",
    "horizon": 1.0,
    "resolution": 5,
    "max_tests": 3,
    "delta": 0.05,
    "alpha": 0.01,
    "rkhs_norm": 5,
    "noise_scale": 0.1,
    "clip": (-0.1, 2),
    "kernel": {"nu": 2.5, "length_scale": 0.5},
    "spot_check": 0,
}
T = np.arange(6) * 0.2


def rig(**changes: Any) -> pb.Rig:
    made = {"parameters": {"x": pb.Parameter(0, 1, unit="m")}, "columns": {"y": "m"}, "step": 0.2}
    return pb.Rig("rig", **{**made, **changes})


def curve(request: TrialRequest) -> dict[str, Any]:
    return {"t": T, "y": request.start["x"] + 0.1 * T}


@pytest.fixture
def study(tmp_path: Path) -> Iterator[Study]:
    with pb.Campaign(rig(), **KEYS).ask_tell(tmp_path / "run") as found:
        yield found


def asked(study: Study) -> TrialRequest:
    request = study.ask()
    assert request is not None
    return request


def finish(study: Study) -> None:
    while (request := study.ask()) is not None:
        study.tell(request, curve(request))


def statuses(study: Study) -> dict[str, tuple[str, str]]:
    return {each.id: (each.status, each.detail) for each in study.run.certificate.assumptions}


def test_a_campaign_is_told_to_its_certificate(study: Study) -> None:
    request = asked(study)
    assert (request.id, list(request.start), request.horizon) == ("robustness.0.nominal.0", ["x"], 1.0)
    assert study.ask() == request, "the same until it is told"
    finish(study)
    assert study.ask() is None
    assert len(study.run.tests) == 3
    assert study.run.verify().checks.good
    assert set(study.run.rollouts["worker"]) == {"told"}
    assert study.run.certificate.recheck is None
    status, detail = statuses(study)["reproducible_rollouts"]
    assert status == "assumed"
    assert "no simulator repeats one" in detail
    assert "measured" in statuses(study)["simulator_is_the_system"][1]
    assert statuses(study)["unrelated_crashes"][1].startswith("a trial that was lost, or measured again")


@pytest.mark.parametrize("form", ["dict", "tuple", "array", "frame", "trajectory", "csv", "units", "mcap"])
def test_every_form_of_the_same_data_is_the_same_file(study: Study, tmp_path: Path, form: str) -> None:
    request = asked(study)
    columns = curve(request)
    samples = np.column_stack([T, columns["y"]])

    class Frame:
        columns = ("t", "y")

        def __getitem__(self, name: str) -> Any:
            return samples[:, self.columns.index(name)].tolist()

    pairs = samples.tolist()
    (tmp_path / "a.csv").write_text("\n".join(["t,y", *(f"{t!r},{y!r}" for t, y in pairs)]))
    (tmp_path / "b.csv").write_text("\n".join(["\ufeffy (m),t (s)", *(f"{y!r},{t!r}" for t, y in pairs), ""]))
    trajectory = pb.Trajectory(("t", "y"), samples)
    fields = request.request.model_dump(mode="json")
    payload = encode(trajectory, request=fields, metadata=request.request.metadata, units={"t": "s", "y": "m"})
    (tmp_path / "c.mcap").write_bytes(payload)
    data = {
        "dict": columns,
        "tuple": (columns["y"],),
        "array": columns["y"],
        "frame": Frame(),
        "trajectory": trajectory,
        "csv": tmp_path / "a.csv",
        "units": str(tmp_path / "b.csv"),
        "mcap": tmp_path / "c.mcap",
    }
    study.tell(request, columns)
    study.tell(request, data[form])  # the same bytes, or it would be refused
    assert len(study.run.rollouts) == 1
    with pytest.raises(PerfboundError, match="another trajectory was told before"):
        study.tell(request, {"t": T, "y": columns["y"] + 1e-9})


def test_second_opinions_need_workers(tmp_path: Path) -> None:
    with pytest.raises(PerfboundError, match=facts("second_opinion: rollouts worker")):
        pb.Campaign(rig(), **KEYS, second_opinion=0.1).ask_tell(tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"t": T, "z": T}, "t z columns y"),
        ({"t": T, "y": T[:3]}, "the columns differ in length"),
        ((T, T), "its columns are y"),
        (None, "None real numbers"),
        ("no-such.csv", "no-such.csv: No such file or directory"),
        ("no-such.mcap", "no-such.mcap: No such file or directory"),
        (pb.Trajectory(("t", "z"), np.zeros((1, 2))), "columns"),
    ],
)
def test_data_that_do_not_fit_are_refused_and_change_nothing(study: Study, data: object, words: str) -> None:
    request = asked(study)
    with pytest.raises(PerfboundError) as error:
        study.tell(request, data)
    assert str(error.value).startswith("robustness.0.nominal.0: ")
    assert says(str(error.value), words)
    assert "\n" not in str(error.value)
    assert study.ask() == request
    assert len(study.run.table("failures")) == 0
    finish(study)
    assert statuses(study)["reproducible_rollouts"][0] == "assumed"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it is empty; its columns are t, y"),
        ("t,z\n0,1\n", "there is no column 'y'; it has t, z"),
        ("t,y,y\n0,1,1\n", "two columns are called 'y'"),
        ("t,y (km)\n0,1\n", "y is in 'km', and the system has it in 'm'"),
        ("t,y\n0,x\n", "'x' is no number"),
        ("t,y\n0,1\n1\n", "line 3 has 1 cells, and the first line 2"),
        ("t,y\n", "it has no sample"),
    ],
)
def test_a_csv_file_that_is_none_is_refused(study: Study, tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(PerfboundError) as error:
        study.tell(asked(study), tmp_path / "a.csv")
    assert words in str(error.value)


@pytest.mark.parametrize(
    "columns",
    [{"t": T, "y": T * np.nan}, {"t": T / 2, "y": T}, {"t": T + 0.5, "y": T}],
    ids=["nan", "early", "late"],
)
def test_data_that_no_trial_has_may_be_a_slip_and_are_not_recorded(study: Study, columns: dict[str, Any]) -> None:
    request = asked(study)
    with pytest.raises(PerfboundError, match=facts("request study.failed")):
        study.tell(request, columns)
    assert len(study.run.table("failures")) == 0
    finish(study)
    assert statuses(study)["reproducible_rollouts"][0] != "refuted"


def test_a_trial_that_failed_is_recorded_and_the_certificate_says_so(study: Study) -> None:
    request = asked(study)
    study.failed(request, "the brake did not answer")
    (failure,) = study.run.table("failures")
    assert (failure["rollout"], failure["kind"]) == (request.id, "system")
    assert asked(study) == request
    study.tell(request, curve(request))
    with pytest.raises(PerfboundError, match=facts("trajectory record never")):
        study.failed(request, "too late")
    finish(study)
    assert statuses(study)["reproducible_rollouts"][0] == "refuted"
    assert study.run.verify().checks.good


def test_other_data_for_a_record_are_refused_and_the_same_are_nothing(study: Study) -> None:
    request = asked(study)
    study.tell(request, curve(request))
    before = len(study.run.table("rollouts"))
    study.tell(request, curve(request))
    with pytest.raises(PerfboundError, match=facts("another trajectory record never")):
        study.tell(request, {"t": T, "y": T})
    with pytest.raises(PerfboundError, match="not finite"):
        study.tell(request, {"t": T, "y": T * np.nan})
    assert len(study.run.table("rollouts")) == before
    assert len(study.run.table("failures")) == 0


def test_requests_of_another_campaign_and_of_none_are_refused(study: Study, tmp_path: Path) -> None:
    with pb.Campaign(rig(), **{**KEYS, "seed": 2}).ask_tell(tmp_path / "other") as other:
        request = asked(other)
    with pytest.raises(PerfboundError, match="one of another campaign"):
        study.tell(request, curve(request))
    for name in ("robustness.9.nominal.0", "x", "robustness.0.true.0"):
        with pytest.raises(PerfboundError, match=r"ask again|is no request"):
            study.tell(name, {"t": T, "y": T})


def test_it_continues_where_it_was(study: Study, tmp_path: Path) -> None:
    study.tell(asked(study), curve(asked(study)))
    waiting = asked(study)
    again = pb.Campaign(rig(), **KEYS).ask_tell(tmp_path / "run")
    with pytest.raises(PerfboundError, match=facts("closed again ask_tell")):
        study.ask()
    assert again.ask() == waiting
    again.close()
    with pb.open(tmp_path / "run").ask_tell() as last:
        finish(last)
        assert last.run.finished
    with pytest.raises(PerfboundError, match="another campaign is here"):
        pb.Campaign(rig(), **{**KEYS, "seed": 2}).ask_tell(tmp_path / "run")


@pytest.mark.rest
@pytest.mark.integration
@pytest.mark.usefixtures("study")
def test_another_process_cannot_have_it_at_the_same_time(tmp_path: Path) -> None:
    code = f"import perfbound as pb; pb.open({str(tmp_path / 'run')!r}).ask_tell()"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert says(ended.stderr, "another orchestrator running campaign")


def test_several_requests_can_be_told_in_any_order(tmp_path: Path) -> None:
    certificates = []
    for order in (1, -1):
        directory = tmp_path / str(order)
        with pb.Campaign(rig(), **{**KEYS, "replicates": 3, "window": 2}).ask_tell(directory) as study:
            while requests := study.requests:
                for request in requests[::order]:
                    study.tell(request, curve(request))
        certificates.append((directory / "certificate.json").read_bytes())
    assert certificates[0] == certificates[1]


def test_a_damaged_file_is_asked_for_again(study: Study, tmp_path: Path) -> None:
    request = asked(study)
    study.tell(request, curve(request))
    (tmp_path / "run" / study.run.rollouts["path"][0]).write_bytes(b"")
    study.close()
    with pb.open(tmp_path / "run").ask_tell() as again:
        assert asked(again).id == request.id
        with pytest.raises(PerfboundError):
            again.tell(request, {"t": T, "y": 0.5 * T})
    with pb.open(tmp_path / "run").ask_tell() as last:
        last.tell(request, curve(request))
        assert asked(last).id != request.id


def test_a_rig_is_not_run_and_not_rechecked(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match=facts("rig repeated 0")):
        pb.Campaign(rig(), **KEYS, recheck=5)
    campaign = pb.Campaign(rig(), **KEYS)
    with pytest.raises(CampaignError, match=facts("simulator rig")):
        campaign.run(tmp_path / "run")
    assert not (tmp_path / "run").exists()
    campaign.ask_tell(tmp_path / "run").close()
    with pytest.raises(CampaignError, match="no simulator makes the rollouts"):
        pb.resume(tmp_path / "run")
    with pytest.raises(DefinitionError, match="rig 'A rig': rig: "):
        pb.Rig("A rig", parameters={}, columns={})


def test_a_run_that_is_not_finished_says_so(study: Study, tmp_path: Path) -> None:
    study.tell(asked(study), curve(asked(study)))
    run = pb.open(tmp_path / "run")
    assert not run.finished
    assert "not finished, 1 rollout so far" in repr(run)
    with pytest.raises(PerfboundError, match="no certificate yet"):
        _ = run.certificate
    assert run.trajectory(0).columns == ("t", "y")
    with pytest.raises(PerfboundError, match="no rollout"):
        run.trajectory(2)
    with pytest.raises(PerfboundError, match="no campaign here"):
        pb.open(tmp_path)


def test_what_breaks_off_inside_a_tell_is_told_again(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = asked(study)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("perfbound.orchestrator.store.attempts.AttemptLog.ended", interrupted)
        with pytest.raises(KeyboardInterrupt):
            study.tell(request, curve(request))
    with pytest.raises(PerfboundError, match="closed"):
        study.tell(request, curve(request))
    with pb.open(tmp_path / "run").ask_tell() as again:
        assert asked(again).id == request.id
        finish(again)
        assert again.run.verify().checks.good


def test_an_input_over_time_of_a_rig_is_a_function_of_it(tmp_path: Path) -> None:
    over_time = rig(parameters={"x": pb.Parameter(0, 1, unit="m", signal=True)})
    keys = {**KEYS, "space": {"x": {"signal": "linear", "knots": 2, "low": 0, "high": 1}}, "recheck": 0}
    with pb.Campaign(over_time, **keys).ask_tell(tmp_path / "run") as study:
        request = asked(study)
        assert request.x == (request.start["x"](0.0), request.start["x"](1.0))
        while (request := study.ask()) is not None:  # type: ignore[assignment]
            study.tell(request, {"t": T, "y": request.start["x"](T)})
        assert {"x_0", "x_1"} <= set(study.run.tests.dtype.names or ())
        assert study.run.verify().checks.good


def fault_after(run: Path, statement: str) -> str:
    """Return what `verify` finds after an edit of the database."""
    with editing(run) as database:
        database.execute(statement)
    (failed,) = [each for each in pb.open(run).verify().checks.lines() if each.status == "failed"]
    return failed.detail


def test_what_the_tolerance_around_time_stamps_could_decide_is_counted(tmp_path: Path) -> None:
    keys = KEYS | {"specification": "always[0,0.6] (y <= 1.5)"}
    with pb.Campaign(rig(step=None), **keys).ask_tell(tmp_path / "run") as study:
        for number in range(3):
            # 0.6 s is the border: of float32 it is 0.60000002 s, and there alone y is above 1.5.
            times = T.astype(np.float32).astype(np.float64) if number else T
            study.tell(asked(study), {"t": times, "y": np.where(np.arange(6) == 3, 1.8, 0.5)})
        status, detail = statuses(study)["borders"]
        assert status == "assumed"
        assert says(detail, "2 of 3 rollouts closing robustness.1.")
        assert study.run.verify().checks.good
    assert "robustness.1.nominal.0: by_tolerance" in fault_after(
        tmp_path / "run", "UPDATE rollouts SET by_tolerance = 0"
    )


def test_a_verdict_by_rollouts_says_where_the_tolerance_could_decide(tmp_path: Path) -> None:
    keys: dict[str, Any] = {"space": {"x": (0, 1)}, "horizon": 1.0, "max_tests": 3}
    keys |= {"claims": [{"quantity": "failure_probability"}]}
    keys |= {"specification": "always[0,0.6] (y <= 1.5)", "spot_check": 0}
    with pb.Campaign(rig(step=None), **keys).ask_tell(tmp_path / "run") as study:
        for number in range(3):
            times = T.astype(np.float32).astype(np.float64) if number else T
            study.tell(asked(study), {"t": times, "y": np.where(np.arange(6) == 3, 1.8, 0.5)})
        verdict = study.run.verdict
    assert verdict.by_rollouts == "certain"
    assert says(verdict.reasons[-1], "2 of 3 rollouts violate time stamp")


def test_stamps_that_are_exact_are_not_counted(study: Study) -> None:
    finish(study)
    assert "borders" not in statuses(study)


def test_windows_that_end_with_the_rollout_are_named_in_the_claim(tmp_path: Path) -> None:
    gears = rig(columns={"y": "m", "gear": "discrete"})
    formula = "always (rise(gear == 2) implies always[0,0.5) gear == 2) and always eventually[0,5] y <= 1"
    with pytest.raises(PerfboundError, match="reaches to"):
        pb.Campaign(gears, **KEYS | {"specification": formula}).ask_tell(tmp_path / "refused")
    with pb.Campaign(gears, **KEYS | {"specification": formula, "beyond": "truncate"}).ask_tell(
        tmp_path / "run"
    ) as study:
        for last in (2, 2, 1):
            study.tell(asked(study), {"y": np.full(6, 0.5), "gear": np.array([1, 1, 1, 2, 2, last])})
        status, detail = statuses(study)["truncated"]
        assert (status, says(detail, "windows truncated end always true eventually false")) == ("assumed", True)
        assert list(study.run.rollouts["robustness"]) == [0.5, 0.5, -0.1]  # by the clip
        assert study.run.certificate.question["beyond"] == "truncate"
        assert "truncated" in claim_words(study.run.certificate.claims[0])
        assert study.run.verify().checks.good


def test_a_column_of_whole_numbers_with_others_is_refused(tmp_path: Path) -> None:
    campaign = pb.Campaign(rig(columns={"gear": "discrete"}), **KEYS | {"specification": "always gear == 1"})
    fault = pytest.raises(PerfboundError, match="compares numbers at sample 2 that are not whole")
    with campaign.ask_tell(tmp_path / "run") as study, fault:
        study.tell(asked(study), {"gear": np.array([1, 1, 1.5, 1, 1, 1])})


@pytest.mark.parametrize("after_end", ["hold", "fail"])
def test_an_early_end_is_what_the_rig_declares(tmp_path: Path, after_end: str) -> None:
    keys = KEYS | {"clip": (-1, 2)}
    with pb.Campaign(rig(after_end=after_end), **keys).ask_tell(tmp_path / "run") as study:
        for samples in (6, 3, 6):
            study.tell(asked(study), {"y": np.full(samples, 0.5)})
        status, detail = statuses(study)["early_ends"]
        assert says(detail, "1 of 3 rollouts horizon robustness.1.nominal.0")
        assert status == ("assumed" if after_end == "hold" else "derived")
        found = study.run.rollouts
        np.testing.assert_equal(found["ended"], [np.nan, 0.4, np.nan])
        assert list(found["robustness"]) == [1.5, 1.5 if after_end == "hold" else pytest.approx(-0.6), 1.5]
        assert study.run.verify().checks.good
    assert "robustness.1.nominal.0: ended" in fault_after(tmp_path / "run", "UPDATE rollouts SET ended = NULL")


def test_an_early_end_is_refused_with_the_remedy_where_nothing_is_declared(study: Study) -> None:
    with pytest.raises(PerfboundError, match='after_end = "hold"'):
        study.tell(asked(study), {"y": np.full(3, 0.5)})
