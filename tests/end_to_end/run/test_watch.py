"""Watching a campaign on the real parts: Prometheus' requests, probes, a token, TLS and a browser."""

import json
import os
import shutil
import signal
import sqlite3
import ssl
from collections.abc import Mapping
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

import psutil
import pytest
import trustme
from playwright.sync_api import Browser
from prometheus_client.openmetrics import parser as open_parser

from tests.end_to_end.processes import Processes, arguments, contents, of_run, processes, wait_for
from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report.test_live import SHOWN, STATE, url_of
from tests.patience import PATIENCE
from tests.sharing import free_port

browser = chromium.browser
EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "cars"
NOTHING: Mapping[str, str] = {}
TOKEN = "a-token-that-no-worker-sees"
OPEN_METRICS = {"Accept": "application/openmetrics-text; version=1.0.0"}
BEARER = {"Authorization": f"Bearer {TOKEN}"}
CURIOUS = """
import os, pathlib
_place = pathlib.Path(__file__).parent / "seen"
_place.mkdir(exist_ok=True)
_own = b"\\0".join(f"{name}={value}".encode() for name, value in os.environ.items())
(_place / str(os.getpid())).write_bytes(_own + b"\\0" + pathlib.Path("/proc/self/environ").read_bytes())
"""
"""A system that writes down every environment it can see."""


def write(folder: Path, more: str = "") -> Path:
    """Write the cars, each rollout of which takes half a second until there is a file `hurry`; return the campaign."""
    code, text = (EXAMPLE / "cars.py").read_text(), (EXAMPLE / "cars.toml").read_text()
    first = "    t = np.arange(0.0, horizon"
    assert first in code
    slow = (
        "    import pathlib, time\n    time.sleep(0.0 if pathlib.Path(__file__).with_name('hurry').exists() else 0.5)\n"
    )
    (folder / "cars.py").write_text(code.replace(first, slow + first) + more)
    (folder / "cars.toml").write_text(text)
    return folder / "cars.toml"


def hurry(campaign: Path) -> Path:
    """Let the rollouts of a campaign take no time from now on."""
    campaign.with_name("hurry").touch()
    return campaign


def get(url: str, headers: Mapping[str, str] = NOTHING, trusted: ssl.SSLContext | None = None) -> tuple[int, str]:
    try:
        with urlopen(Request(url, headers=dict(headers)), timeout=PATIENCE, context=trusted) as answer:
            return answer.status, answer.read().decode()
    except HTTPError as error:
        with error:
            return error.code, error.read().decode()


def numbers(text: str) -> dict[tuple[str, str], float]:
    """Return the value of every sample, by name and labels."""
    families = open_parser.text_string_to_metric_families(text)  # type: ignore[no-untyped-call]
    return {
        (sample.name, json.dumps(sample.labels, sort_keys=True)): sample.value
        for family in families
        for sample in family.samples
    }


def total(found: dict[tuple[str, str], float], name: str) -> float:
    return sum(value for (sample, _), value in found.items() if sample == name)


def count(directory: Path, query: str) -> int:
    with closing(sqlite3.connect(directory / "campaign.db")) as connection:
        (found,) = connection.execute(query).fetchone()
    return int(found)


def answers(url: str, headers: Mapping[str, str] = NOTHING) -> bool:
    try:
        return get(url, headers)[0] == 200
    except (URLError, OSError):
        return False


@pytest.mark.journey
def test_a_campaign_is_scraped_while_it_runs_and_no_worker_sees_the_token(started: Processes) -> None:
    directory, address = started.folder / "run", f"127.0.0.1:{free_port()}"
    url, campaign = f"http://{address}/", write(started.folder, CURIOUS)
    options = ("--out", directory, "--workers", "2", "--web", address)
    process = started.start("perfbound", "run", campaign, *options, PERFBOUND_WEB_TOKEN=TOKEN)
    wait_for(lambda: answers(f"{url}readyz", BEARER) or not process.running)
    assert get(f"{url}metrics")[0] == 401
    assert get(f"{url}metrics", {"Authorization": "Bearer wrong"})[0] == 403
    scrapes = [numbers(get(f"{url}metrics", {**OPEN_METRICS, **BEARER})[1])]
    children = process.children()
    assert len(children) >= 3, "the page and two workers"
    assert not [each for each in (psutil.Process(process.pid), *children) if TOKEN in str(arguments(each))]
    assert not [each for each in children if TOKEN in str(each.environ())]

    def another() -> bool:
        status, text = get(f"{url}metrics", {**OPEN_METRICS, **BEARER})
        assert status == 200, text
        scrapes.append(numbers(text))
        more = total(scrapes[-1], "perfbound_rollouts_total") - total(scrapes[0], "perfbound_rollouts_total")
        return more > 10 and ("perfbound_done_ratio", "{}") in scrapes[-1]

    wait_for(another)
    hurry(campaign)
    ended = process.wait()
    assert (ended.code, TOKEN in ended.err + ended.out) == (0, False)
    assert f"live page: {url} (asks for the token in PERFBOUND_WEB_TOKEN)\n" in ended.err
    assert len(scrapes) > 2
    for before, after in pairwise(scrapes):
        for (name, labels), value in before.items():
            if name.endswith(("_total", "_bucket", "_count")):
                assert after[name, labels] >= value
    assert max(value for each in scrapes for key, value in each.items() if key[0] == "perfbound_workers") > 0
    assert total(scrapes[-1], "perfbound_commit_seconds_count") > 0
    assert 0 < scrapes[-1]["perfbound_done_ratio", "{}"] < 1
    seen = list((started.folder / "seen").iterdir())
    assert len(seen) >= 2
    assert not [each for each in seen if TOKEN.encode() in each.read_bytes() or b"WEB_TOKEN" in each.read_bytes()]
    assert not [path for path, data in contents(directory).items() if TOKEN.encode() in data]

    page = started.start("perfbound", "web", directory)
    at_the_end = numbers(get(f"{url_of(page)}metrics", OPEN_METRICS)[1])
    for name, query in (
        ("perfbound_rollouts_total", "SELECT count(*) FROM rollouts"),
        ("perfbound_attempts_total", "SELECT count(*) FROM attempts"),
        ("perfbound_results_total", "SELECT count(*) FROM outcomes WHERE outcome = 'recorded'"),
        ("perfbound_failures_total", "SELECT count(*) FROM outcomes WHERE outcome != 'recorded'"),
        ("perfbound_tests_total", "SELECT count(*) FROM observations"),
    ):
        assert total(at_the_end, name) == count(directory, query), name
        assert total(at_the_end, name) >= total(scrapes[-1], name)
    assert at_the_end["perfbound_certificate_issued", "{}"] == 1


def test_a_failing_system_is_counted_by_host(started: Processes) -> None:
    campaign = hurry(write(started.folder))
    code = campaign.with_name("cars.py")
    once = "    mark = __import__('pathlib').Path(__file__).with_name(str(seed))\n"
    once += "    if seed % 5 == 0 and not mark.exists():\n        mark.touch()\n        raise RuntimeError('once')\n"
    code.write_text(code.read_text().replace("    import pathlib", f"{once}    import pathlib", 1))
    directory = started.folder / "run"
    ended = started.run("perfbound", "run", campaign, "--out", directory)
    assert ended.code == 0, ended.err
    page = started.start("perfbound", "web", directory)
    found = numbers(get(f"{url_of(page)}metrics", OPEN_METRICS)[1])
    failures = {key: value for key, value in found.items() if key[0] == "perfbound_failures_total"}
    host = os.uname().nodename
    number = count(directory, "SELECT count(*) FROM outcomes WHERE kind = 'system'")
    assert number > 0
    assert failures == {("perfbound_failures_total", json.dumps({"host": host, "kind": "system"})): number}


def test_a_probe_sees_a_loop_that_stands_still(started: Processes) -> None:
    campaign = write(started.folder)
    process = started.start("perfbound", "run", campaign, "--out", started.folder / "run", "--web")
    url = url_of(process)
    wait_for(lambda: answers(f"{url}readyz"))
    assert get(f"{url}healthz") == (200, "ok")
    process.popen.send_signal(signal.SIGSTOP)
    wait_for(lambda: get(f"{url}readyz") == (503, "stalled"))
    assert get(f"{url}healthz") == (200, "ok"), "not for so short a time"
    process.popen.send_signal(signal.SIGCONT)
    wait_for(lambda: answers(f"{url}readyz"))
    process.popen.send_signal(signal.SIGINT)
    assert process.wait().code == 130


@pytest.mark.parametrize("command", ["orchestrate", "resume"])
def test_a_probe_is_answered_while_no_router_is_there(started: Processes, command: str) -> None:
    campaign, directory = hurry(write(started.folder)), started.folder / "run"
    place, router = f"127.0.0.1:{free_port()}", f"tcp/127.0.0.1:{free_port()}"
    arguments: tuple[str | Path, ...] = (campaign, "--out", directory)
    if command == "resume":
        arguments = (directory, "--workers", "0")
        first = started.start("perfbound", "orchestrate", campaign, "--out", directory, "--listen", "tcp/127.0.0.1:0")
        wait_for(lambda: "waiting for workers" in first.err)
        first.popen.terminate()
        assert first.wait().code == 143
    waiting = started.start("perfbound", command, *arguments, "--connect", router, "--web", place)
    wait_for(lambda: "router" in waiting.err or not waiting.running)
    assert get(f"http://{place}/healthz") == (200, "ok"), waiting.err
    assert get(f"http://{place}/readyz") == (503, "starting")
    if command == "orchestrate":  # it begins as soon as there is a router
        assert get(f"http://{place}/metrics")[0] == 503
        assert not directory.exists()
    started.start("perfbound", "router", "--listen", router)
    wait_for(lambda: answers(f"http://{place}/readyz"))
    assert get(f"http://{place}/")[0] == 200
    waiting.popen.terminate()
    assert waiting.wait().code == 143, waiting.err


# TLS


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture
def pem(started: Processes, authority: trustme.CA) -> tuple[str, ...]:
    """The options of a page with a certificate for the loopback."""
    found = authority.issue_cert("localhost", "127.0.0.1")
    certificate, key = started.folder / "page.pem", started.folder / "page.key"
    found.cert_chain_pems[0].write_to_path(certificate)
    found.private_key_pem.write_to_path(key)
    key.chmod(0o600)
    return "--web-tls-certificate", str(certificate), "--web-tls-key", str(key)


def test_a_page_by_https_with_a_token_in_a_browser(
    started: Processes, pem: tuple[str, ...], authority: trustme.CA, browser: Browser
) -> None:
    directory, campaign, address = started.folder / "run", write(started.folder), f"127.0.0.1:{free_port()}"
    process = started.start("perfbound", "run", campaign, "--out", directory, "--web", address, "--web-token", *pem)
    url = url_of(process)
    origin, token = url.split("?token=")
    assert (origin, len(token)) == (f"https://{address}/", 43)
    with chromium.watched(browser, any_certificate=True) as stranger:
        answer = stranger.page.goto(origin)
        assert answer is not None
        assert answer.status == 401
        assert stranger.page.inner_text("body").strip() == (
            "this page needs its token: open the address that perfbound printed, with ?token=... at its end"
        )
        for path in ("events", "story.json", "certificate.json", "counterexamples.csv", "metrics"):
            assert stranger.page.context.request.get(f"{origin}{path}").status == 401
    with chromium.watched(browser, any_certificate=True) as watch:
        watch.page.goto(url)
        watch.shown()
        assert watch.page.url == origin, "the token does not stay in the address"
        first = watch.page.evaluate(SHOWN)
        wait_for(lambda: watch.page.evaluate(SHOWN) > first)
        (cookie,) = watch.page.context.cookies()
        assert (cookie["httpOnly"], cookie["secure"], cookie["sameSite"]) == (True, True, "Strict")
        assert watch.page.evaluate("document.cookie") == ""
        trusted = ssl.create_default_context()
        authority.configure_trust(trusted)
        status, text = get(f"{origin}metrics", {"Authorization": f"Bearer {token}", **OPEN_METRICS}, trusted)
        assert (status, max(numbers(text)) >= ("perfbound_build_info", '{"version": ')) == (200, True)
        assert get(f"{origin}healthz", trusted=trusted) == (200, "ok")
        hurry(campaign)
        wait_for(lambda: watch.page.evaluate(STATE) == "finished" or not process.running)
        assert [error for error in watch.errors if "net::ERR_" not in error] == [], "the server ends with the run"
        assert all(each.startswith((origin, "data:")) for each in watch.requests)
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert of_run(directory) == []


def test_a_page_for_other_machines(started: Processes, pem: tuple[str, ...], authority: trustme.CA) -> None:
    with processes(started.folder / "made") as found:
        ended = found.run("perfbound", "run", hurry(write(found.folder)), "--out", found.folder / "run")
        assert ended.code == 0, ended.err
    directory = started.folder / "made" / "run"
    refused = started.run("perfbound", "web", directory, "--web", "0.0.0.0:0")
    assert refused.code == 1
    assert "add --web-tls-certificate and --web-tls-key" in refused.fault
    for wrong in (pem[:2], pem[2:]):
        ended = started.run("perfbound", "web", directory, "--web", "0.0.0.0:0", *wrong)
        assert (ended.code, "--web-tls-certificate and --web-tls-key belong together" in ended.err) == (2, True)
    ended = started.run("perfbound", "run", write(started.folder), "--web-token", "--out", started.folder / "run")
    assert (ended.code, "--web-token: needs --web" in ended.err) == (2, True)

    unencrypted = started.start("perfbound", "web", directory, "--web", "0.0.0.0:0", "--insecure")
    port = url_of(unencrypted).rpartition(":")[2].partition("/")[0]
    assert "travels unencrypted" in unencrypted.err
    assert get(f"http://127.0.0.1:{port}/story.json")[0] == 401
    assert get(f"http://127.0.0.1:{port}/healthz", {"Host": "10.0.0.7:80"}) == (200, "ok")

    encrypted = started.start("perfbound", "web", directory.parent, "--web", "0.0.0.0:0", *pem)
    wait_for(lambda: "?token=" in encrypted.err or not encrypted.running)
    assert "unencrypted" not in encrypted.err
    address, token = encrypted.err.strip().rpartition(" ")[2].split("?token=")
    origin = f"https://127.0.0.1:{address.rpartition(':')[2]}"
    trusted = ssl.create_default_context()
    authority.configure_trust(trusted)
    assert get(f"{origin}campaigns.json", trusted=trusted)[0] == 401
    own = {"Authorization": f"Bearer {token}"}
    assert get(f"{origin}runs/run/metrics", {**own, "Host": "10.0.0.7:80"}, trusted)[0] == 200
    assert get(f"{origin}metrics", own, trusted)[0] == 404
    with pytest.raises(URLError, match="CERTIFICATE_VERIFY_FAILED"):
        get(f"{origin}healthz", trusted=ssl.create_default_context())
    for process in (unencrypted, encrypted):
        process.popen.send_signal(signal.SIGTERM)
        assert process.wait().code == 143
    shutil.rmtree(directory)
