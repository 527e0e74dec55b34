"""A study that threads, forks, a chdir and wrong arguments share: what was told is there, once."""

import copy
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.library.study import Study
from perfbound.schemas.errors import PerfboundError
from tests.facts import facts, says
from tests.patience import PATIENCE
from tests.unit.library.test_study import KEYS, T, asked, curve, finish, rig

pytestmark = pytest.mark.integration

MANY = {**KEYS, "replicates": 8, "window": 3, "max_tests": 6}
"""Of a campaign with several wanted rollouts at a time."""


@pytest.fixture
def study(tmp_path: Path) -> Iterator[Study]:
    with pb.Campaign(rig(), **MANY).ask_tell(tmp_path / "run") as found:
        yield found


def in_fork(call: Callable[[], object]) -> str:
    """Return what a call in a forked process raises or returns, as text."""
    ours, theirs = multiprocessing.Pipe()
    child = os.fork()
    if not child:
        try:
            theirs.send(f"returned {call()!r}")
        except BaseException as error:  # noqa: BLE001  (whatever comes is the answer)
            theirs.send(f"{type(error).__name__}: {error}")
        finally:
            os._exit(0)
    assert ours.poll(PATIENCE), "the fork hangs"
    os.waitpid(child, 0)
    return str(ours.recv())


@pytest.mark.rest
def test_threads_tell_a_campaign_to_the_certificate_of_one_thread(study: Study, tmp_path: Path) -> None:
    while requests := study.requests:
        with ThreadPoolExecutor(8) as threads:
            for told in [threads.submit(study.tell, each, curve(each)) for each in requests]:
                told.result(PATIENCE)
            list(threads.map(lambda _: (study.ask(), study.requests, repr(study)), range(8)))
    with pb.Campaign(rig(), **MANY).ask_tell(tmp_path / "calm") as calm:
        finish(calm)
    certificates = [(tmp_path / name / "certificate.json").read_bytes() for name in ("run", "calm")]
    assert certificates[0] == certificates[1]
    assert study.run.verify().checks.good


def test_the_same_data_from_many_threads_are_one_record(study: Study) -> None:
    request = asked(study)
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda _: study.tell(request, curve(request)), range(16)))
    assert len(study.run.rollouts) == 1


def test_of_other_data_from_many_threads_one_counts(study: Study) -> None:
    request = asked(study)
    told: list[float] = []

    def tell(shift: float) -> None:
        study.tell(request, {"t": T, "y": T + shift})
        told.append(shift)

    with ThreadPoolExecutor(8) as threads:
        faults = [each.exception() for each in [threads.submit(tell, 0.01 * k) for k in range(8)]]
    assert len(told) == 1
    assert study.run.trajectory(request.id).column("y")[0] == told[0]
    assert all(isinstance(each, PerfboundError | None) for each in faults)


@pytest.mark.rest
def test_failures_and_a_close_from_other_threads(study: Study, tmp_path: Path) -> None:
    first, *others = study.requests
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda k: study.failed(first, f"trial {k}"), range(8)))
        returned = [threads.submit(study.tell, each, curve(each)) for each in others]
        threads.submit(study.close).result(PATIENCE)
    recorded = [each for each in returned if each.exception() is None]
    assert {type(each.exception()) for each in returned} <= {type(None), PerfboundError}
    assert len(study.run.table("failures")) == 8
    assert len(study.run.rollouts) == len(recorded)
    with pb.open(tmp_path / "run").ask_tell() as again:
        finish(again)
        assert again.run.verify().checks.good


@pytest.mark.rest
@pytest.mark.parametrize("name", ["ask", "requests", "tell", "failed", "close"])
def test_a_fork_is_refused_in_one_line(study: Study, name: str) -> None:
    request = asked(study)
    calls: dict[str, Callable[[], object]] = {
        "ask": study.ask,
        "requests": lambda: study.requests,
        "tell": lambda: study.tell(request, curve(request)),
        "failed": lambda: study.failed(request, "no"),
        "close": study.close,
    }
    with study._lock:  # as a thread has it that does not exist in the fork
        said = in_fork(calls[name])
    assert says(said, f"^PerfboundError: {study.directory}: {os.getpid()}")
    assert "\n" not in said
    finish(study)
    assert study.run.verify().checks.good


@pytest.mark.rest
def test_a_fork_that_ends_by_itself_leaves_the_study_alone(study: Study, tmp_path: Path) -> None:
    request = asked(study)
    study.tell(request, curve(request))
    child = os.fork()
    if not child:
        with study:  # as a fork inside the block leaves it
            pass
        del study
        os._exit(0)
    os.waitpid(child, 0)
    code = f"import perfbound as pb; pb.open({str(tmp_path / 'run')!r}).ask_tell()"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert says(other.stderr, "another orchestrator running campaign")
    finish(study)
    assert study.run.verify().checks.good


def test_a_fork_that_lives_on_does_not_keep_the_directory(tmp_path: Path) -> None:
    study = pb.Campaign(rig(), **MANY).ask_tell(tmp_path / "run")
    ours, theirs = multiprocessing.Pipe()
    child = os.fork()
    if not child:
        ours.close()
        theirs.poll(PATIENCE)
        os._exit(0)
    try:
        study.close()
        with pb.open(tmp_path / "run").ask_tell() as again:
            assert asked(again).id
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


@pytest.mark.parametrize("copied", [pickle.dumps, copy.copy, copy.deepcopy])
def test_a_study_is_not_copied(study: Study, copied: Callable[[object], object]) -> None:
    with pytest.raises(PerfboundError, match="stays in process"):
        copied(study)


KILLED = """
import os, threading, sys
import perfbound as pb
from tests.unit.library.test_shared_study import MANY, curve, rig

study = pb.Campaign(rig(), **MANY).ask_tell(sys.argv[1])
requests = list(study.requests)

def tell():
    while requests:
        request = requests.pop()
        study.tell(request, curve(request))
        os.write(1, f"{request.id}\\n".encode())
        if len(requests) < 12:
            os.kill(os.getpid(), 9)

threads = [threading.Thread(target=tell) for _ in range(4)]
for each in threads:
    each.start()
"""
"""Its threads outlive the main one."""


@pytest.mark.rest
def test_what_was_told_is_there_after_kill_9(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path / "run")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    told = ended.stdout.split()
    assert told
    with pb.open(tmp_path / "run").ask_tell() as again:
        assert set(again.run.rollouts["rollout"]) >= set(told)
        finish(again)
        assert again.run.verify().checks.good


@pytest.mark.parametrize("name", ["campaign.db-wal", "campaign.db"])
@pytest.mark.parametrize("share", [0, 2, None])
def test_a_database_that_is_cut_ends_the_study(study: Study, name: str, share: int | None) -> None:
    request, following, *_ = study.requests
    study.tell(request, curve(request))
    path = study.directory / name
    if share is None:
        path.unlink()
    else:
        os.truncate(path, path.stat().st_size // 2 if share else 0)
    with pytest.raises(PerfboundError, match=rf"{name}: (cut from|removed or replaced) .*; restore"):
        study.tell(following, curve(following))
    with pytest.raises(PerfboundError, match="this study is closed"):
        study.ask()
    assert not (study.directory / "certificate.json").exists()


def test_a_chdir_moves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    campaign = pb.Campaign(rig(), **KEYS)
    with campaign.ask_tell("here") as study:
        run = pb.open("here")
        monkeypatch.chdir(tmp_path / "elsewhere")
        finish(study)
        assert study.run.finished
        assert run.finished
        assert len(run.tests) == 3
        assert run.verify().checks.good
    assert not list((tmp_path / "elsewhere").iterdir())
    assert (tmp_path / "here" / "certificate.json").is_file()


HUGE = pytest.param(10**400, id="huge")
RECURSIVE: list[Any] = []
RECURSIVE.append(RECURSIVE)
MASKED = np.ma.masked_equal([0.0, 1.0, 2.0, 3.0, 4.0, 5.0], 2.0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"t": T, "y": MASKED}, "y has a masked value at row 2"),
        ([MASKED], "y has a masked value at row 2"),
        (np.ma.column_stack([MASKED]), "masked value at row 2, column 0"),
        ({"t": np.ma.array(T, mask=T > 0.9), "y": T}, "t has a masked value at row 5"),
        ({"t": T, "y": [0, 1, np.ma.masked, 3, 4, 5]}, "y has a masked value at row 2"),
        ({"t": T, "y": ["0", "1", "2", "3", "4", "5"]}, "y is text ('0' at row 0)"),
        ({"t": T, "y": [0, 1, 2, 3, 4, "1_000"]}, "y is text ('1_000' at row 5)"),
        ({"t": T, "y": np.array(["0"] * 6, dtype=object)}, "y is str ('0' at row 0)"),
        ({"t": T, "y": [b"0"] * 6}, "y is bytes"),
        ({"t": T, "y": bytearray(6)}, "y is bytearray"),
        ({"t": np.array(range(6), "M8[s]"), "y": T}, "t is dates"),
        ({"t": np.array(range(6), "m8[ms]"), "y": T}, "t is durations"),
        ({"t": [np.timedelta64(k, "s") for k in range(6)], "y": T}, "t is durations"),
        ({"t": T, "y": T + 0j}, "y is complex numbers"),
        ({"t": T, "y": np.zeros(6, [("a", float)])}, "y is records"),
        ({"t": T, "y": [0, 1, None, 3, 4, 5]}, "y is None (None at row 2)"),
        ({"t": T, "y": (k for k in range(6))}, "y is generator"),
        ({"t": T, "y": [10**400] * 6}, "not finite"),
        ({"t": T, "y": [[1.0], [1.0, 2.0]]}, "y is list whose entries differ in length"),
        ({"t": T, "y": RECURSIVE}, "y is lists within lists"),
        ({1: T, None: T}, "the function returned 1, None"),
        (RECURSIVE, "y is lists within lists"),
        ({"t": T}, "the function returned t"),
        (12, "one sample at 0 s"),
        ("12", "No such file"),
        ("a\0b", "no path of a file"),
        ("\udc80.mcap", "No such file"),
        (object(), "is object; give real numbers"),
        (int, "is type; give real numbers"),
    ],
)
def test_what_is_no_real_number_is_refused(study: Study, data: object, words: str) -> None:
    request = asked(study)
    with pytest.raises(PerfboundError) as error:
        study.tell(request, data)
    assert str(error.value).startswith(f"{request.id}: ")
    assert says(str(error.value), words), "between them shape and type of an array"
    assert "\n" not in str(error.value)
    assert study.ask() == request


@pytest.mark.parametrize(
    "y",
    [
        np.ma.array(T),
        np.ma.array(T, mask=np.zeros(6, bool)),
        T.astype(np.float32),
        T.tolist(),
        tuple(map(Decimal, ("0", "0.2", "0.4", "0.6", "0.8", "1"))),
        np.array(T.tolist(), dtype=object),
        np.arange(6) > 2,
        [np.float64(each) for each in T],
        [np.int8(1)] * 6,
    ],
)
def test_real_numbers_of_every_kind_are_taken(study: Study, y: Any) -> None:
    request = asked(study)
    study.tell(request, {"t": T, "y": y})
    assert np.array_equal(study.run.trajectory(request.id).column("y"), np.array(y, dtype=np.float64))


@pytest.mark.parametrize(
    "wrong",
    [None, 5, HUGE, b"a", ["a"], object(), "x" * 10_000, "robustness.0_0.nominal.0", "robustness.\u0660.nominal.0"],
)
def test_what_is_no_request_is_one_line(study: Study, wrong: Any) -> None:
    calls: list[Callable[[], object]] = [
        lambda: study.tell(wrong, {"t": T, "y": T}),
        lambda: study.failed(wrong, "no"),
    ]
    for call in calls:
        with pytest.raises(PerfboundError, match="is no request; give what ask") as error:
            call()
        assert len(str(error.value)) < 300


@pytest.mark.parametrize("wrong", [None, 5, "", " \n", b"no", ValueError("no"), HUGE])
def test_a_reason_is_a_text(study: Study, wrong: Any) -> None:
    request = asked(study)
    with pytest.raises(PerfboundError, match=facts("reason: text why")):
        study.failed(request, wrong)
    study.failed(request, "half a character \udc80, a NUL \0\nand a line")
    assert len(study.run.table("failures")) == 1


@pytest.mark.parametrize("step", ["0.2", 0, -1, float("nan"), float("inf"), [0.2, 0.2], np.timedelta64(1, "s"), HUGE])
def test_a_step_is_a_positive_number(study: Study, step: Any) -> None:
    request = asked(study)
    with pytest.raises(PerfboundError, match=rf"{request.id}: step "):
        study.tell(request, (T,), step=step)
    assert study.ask() == request


def test_a_thread_ends_while_others_wait(study: Study) -> None:
    """A refused tell leaves the lock."""
    request = asked(study)
    with pytest.raises(PerfboundError):
        study.tell(request, None)
    done = threading.Thread(target=study.tell, args=(request, curve(request)))
    done.start()
    done.join(PATIENCE)
    assert not done.is_alive()
