"""docs/logs.md as a person follows it: logs that exist, and a rig that is driven test by test over a page."""

import json
import os
import re
import signal
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from tests.end_to_end.processes import Process, Processes, wait_for
from tests.fakes.logs import write_csv

PAGE = Path(__file__).parents[3] / "docs" / "logs.md"
ENDPOINT = "tcp/127.0.0.1:{port}"


def blocks(title: str) -> list[str]:
    section = PAGE.read_text(encoding="utf-8").partition(f"## {title}\n")[2].partition("\n## ")[0]
    return re.findall(r"```(?:python|toml)\n(.*?)```", section, re.DOTALL)


@pytest.mark.journey
def test_the_logs_of_the_page_become_a_certificate(started: Processes) -> None:
    script, campaign = blocks("Logs that exist")
    (started.folder / "drives.py").write_text(script)
    (started.folder / "drives.toml").write_text(campaign)
    assert started.run("python", "drives.py").code == 0
    ended = started.run("perfbound", "import", "drives", "--starts", "starts.csv", "--campaign", "drives.toml")
    assert ended.code == 0, ended.err
    assert re.search("CLAIM  probability that a rollout at a drawn start violates", ended.out)
    assert "VERIFIED" in started.run("perfbound", "verify", "runs/drives").out


class Hand:
    """A person at the page."""

    def __init__(self, worker: Process) -> None:
        wait_for(lambda: "tests by hand: " in worker.err)
        self._address = worker.err.partition("tests by hand: ")[2].split()[0]

    def state(self) -> dict[str, Any]:
        with urllib.request.urlopen(f"{self._address}state") as answer:
            found: dict[str, Any] = json.load(answer)
            return found

    def trial(self, after: str = "") -> dict[str, Any]:
        """Return the request that is shown, another one than `after`."""
        found: dict[str, Any] = {}

        def shown() -> bool:
            nonlocal found
            found = self.state()["trial"] or {}
            return bool(found) and found["key"] != after

        wait_for(shown)
        return found

    def post(self, what: str, body: bytes = b"", **given: Any) -> str:
        """Return the fault that the page shows, empty for none."""
        query = urllib.parse.quote(json.dumps(given))
        request = urllib.request.Request(f"{self._address}{what}?given={query}", data=body, method="POST")
        try:
            with urllib.request.urlopen(request):
                return ""
        except urllib.error.HTTPError as error:
            with error:
                found: str = json.load(error)["fault"]
                return found


def log_of(folder: Path, speed: float) -> bytes:
    t = np.arange(41) * 0.05
    return write_csv(folder / "measured.csv", {"t": t, "force": 30.0 * speed * np.exp(-t)}).read_bytes()


def test_a_rig_is_driven_by_hand_through_restarts(started: Processes) -> None:
    """Slips are refused and change nothing; the worker and the orchestrator are killed between and during tests."""
    (campaign,) = blocks("A rig by hand")
    (started.folder / "bench.toml").write_text(campaign.replace("max_tests = 59", "max_tests = 4"))
    orchestrator = started.start("perfbound", "orchestrate", "bench.toml", "--listen", "tcp/127.0.0.1:0")
    wait_for(lambda: "waiting for workers: " in orchestrator.err)
    line = orchestrator.err.partition("waiting for workers: ")[2].splitlines()[0].split()
    assert line[-2:] == ["--manual", "logs"], "the command as it is printed"

    def worker(endpoint: str) -> tuple[Process, Hand]:
        arguments = [endpoint if each.startswith("tcp/") else each for each in line[1:]]
        found = started.start("perfbound-worker", *arguments, "--manual-port", "0")
        return found, Hand(found)

    endpoint = next(each for each in line if each.startswith("tcp/"))
    first, hand = worker(endpoint)
    trial = hand.trial()
    (asked,) = trial["start"]
    body = log_of(started.folder, asked["value"])
    near = {"speed": asked["value"] + 0.1}
    refused = [
        hand.post("log", body, key=trial["key"], name="a.csv", start={"speed": asked["value"] + 1.0}),
        hand.post("log", body.replace(b"force", b"farce"), key=trial["key"], name="a.csv"),
        hand.post("log", body[: len(body) // 2], key=trial["key"], name="a.csv"),
        hand.post("log", key=trial["key"], name="a.csv"),
        hand.post("log", body, key="0" * 14, name="a.csv"),
        hand.post("log", key=trial["key"], path="/no/such/log.csv"),
        hand.post("failed", key=trial["key"], reason=" "),
    ]
    words = [
        "1 from the",
        "no column 'force'",
        "it ends",
        "choose the log",
        "withdrawn",
        "No such file",
        "say why",
    ]
    assert [(word, fault) for word, fault in zip(words, refused, strict=True) if word not in fault] == []
    assert hand.trial()["key"] == trial["key"]
    assert not list((started.folder / "logs").glob("*")), "nothing is kept of what was refused"
    assert not hand.post("log", body, key=trial["key"], name="a.csv", start=near)
    # From a second window: what was handed in before is untouched.
    assert "withdrawn" in hand.post("log", body, key=trial["key"], name="a.csv", start=near)
    assert len(list((started.folder / "logs").glob("*-a.csv"))) == 1

    given_up = hand.trial(after=trial["key"])["key"]
    os.kill(first.pid, signal.SIGKILL)
    first.popen.wait()
    _, hand = worker(endpoint)
    second = hand.trial()

    # Handed in while there is no orchestrator: the folder has it, and it is not asked for again.
    os.kill(orchestrator.pid, signal.SIGKILL)
    orchestrator.popen.wait()
    body = log_of(started.folder, second["start"][0]["value"])
    assert not hand.post("log", body, key=second["key"], name="b.csv")
    orchestrator = started.start("perfbound", "resume", "runs/bench", "--workers", "0", "--listen", endpoint)
    keys, last = [trial["key"], second["key"]], second["key"]
    for _ in range(2):
        trial = hand.trial(after=last)
        last = trial["key"]
        keys.append(last)
        body = log_of(started.folder, trial["start"][0]["value"])
        assert not hand.post("log", body, key=last, name="c.csv")
    assert len(set(keys)) == 4, "each once"
    assert given_up in keys, "that of the worker that was killed as well"
    ended = orchestrator.wait()
    assert ended.code == 0, ended.err
    run = pb.open(started.folder / "runs" / "bench")
    driven = [run.trajectory(k).column("driven_speed")[0] - run.tests["speed"][k] for k in range(4)]
    assert sorted(driven) == pytest.approx([0.0, 0.0, 0.0, 0.1])
    assert "VERIFIED" in started.run("perfbound", "verify", "runs/bench").out


def test_a_rig_has_no_other_worker(started: Processes) -> None:
    (campaign,) = blocks("A rig by hand")
    (started.folder / "bench.toml").write_text(campaign)
    run = started.run("perfbound", "run", "bench.toml").fault
    assert "`perfbound orchestrate` with `perfbound-worker --manual`" in run
    serve = started.run("perfbound-worker", "--system", "bench.toml", "--connect", "tcp/127.0.0.1:1").fault
    assert "brake-bench is a rig: a person drives it; give --manual FOLDER" in serve
    none = started.run("perfbound-worker", "--manual", "logs", "--connect", "tcp/127.0.0.1:1").fault
    assert "give the campaign file of one rig" in none
    for command in ("init", "check-system", "plan"):
        refused = started.run("perfbound", command, "bench.toml").fault
        assert "brake-bench is a rig, of which nothing here makes a rollout" in refused
