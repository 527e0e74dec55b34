"""The metrics of a campaign: their text, their labels, their agreement with the database; and the probes."""

import asyncio
import itertools
import shutil
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client import Metric
from prometheus_client.openmetrics import parser as open_parser
from prometheus_client.parser import text_string_to_metric_families as parsed_plain

from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.web import app, metrics, run_feed
from perfbound.orchestrator.report.web.metric_list import LONGEST_HOST, METRICS, MOST_HOSTS, OTHER
from perfbound.orchestrator.report.web.metrics import CampaignMetrics
from perfbound.orchestrator.report.web.run_feed import RunFeed
from perfbound.orchestrator.report.web.snapshots import SnapshotCache
from perfbound.orchestrator.report.web.watched import Watched
from perfbound.orchestrator.run import service
from perfbound.orchestrator.run.page.address import Address
from perfbound.orchestrator.run.page.page_feed import RunFigures, read_message
from perfbound.orchestrator.run.page.page_feed import message as feed_message
from perfbound.orchestrator.run.routers import RouterLink
from perfbound.orchestrator.run.service import RunStatus
from perfbound.orchestrator.store.commit_times import CommitTimes
from perfbound.orchestrator.store.counts import CampaignCounts
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.result.known import Expected, Span
from tests.campaigns import config
from tests.fakes.inmemory import Log, campaign
from tests.fakes.interleaving import meanwhile
from tests.unit.report.web.test_app import Answer, Client

OPEN_METRICS = "application/openmetrics-text;version=1.0.0;escaping=allow-utf-8;q=0.6,text/plain;version=0.0.4;q=0.3"
FIGURES = RunFigures(
    1.8e9, {}, {"idle": 3, "set aside": 1}, 7, 2, 1, CommitTimes().with_one(0.002).with_one(20.0), False
)


class Watching(Log):
    """Asks for the metrics at every tick, as Prometheus would if it were in a hurry."""

    def __init__(self, directory: Path) -> None:
        super().__init__()
        self._feed = RunFeed()
        self._metrics = CampaignMetrics(directory, self._feed)
        self.texts: list[str] = []

    def show(self, status: RunStatus) -> None:
        self._feed.take(read_message(feed_message(status)))
        self.texts.append(self._metrics.exposition(OPEN_METRICS)[0].decode())


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A finished campaign, and the metrics while it ran."""
    directory = tmp_path_factory.mktemp("metrics") / "run"
    log = Watching(directory)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(service, "TICK", 0.002)
        patch.setattr(metrics, "PAUSE", 0.0)
        campaign(directory, config("test-function", resolution=7, max_tests=20, replicates=2), workers=2, log=log)
    return directory, log.texts


@pytest.fixture(scope="module")
def counts(watched: tuple[Path, list[str]]) -> CampaignCounts:
    return CampaignMetrics(watched[0], None).refresh().counts


def parsed_open(text: str) -> list[Metric]:
    return list(open_parser.text_string_to_metric_families(text))  # type: ignore[no-untyped-call]


def families(text: str) -> dict[str, Metric]:
    return {each.name: each for each in parsed_open(text)}


Numbers = Mapping[tuple[str, frozenset[tuple[str, str]]], float]


def numbers(text: str) -> Numbers:
    """Return the value of every sample."""
    found = [
        ((sample.name, frozenset(sample.labels.items())), sample.value)
        for family in parsed_open(text)
        for sample in family.samples
    ]
    assert len(found) == len(dict(found)), "no sample is there twice"
    return dict(found)


def value(found: Numbers, name: str, **labels: str) -> float:
    return found[name, frozenset(labels.items())]


def text_of(directory: Path, feed: RunFeed | None = None) -> str:
    text, media_type = CampaignMetrics(directory, feed).exposition(OPEN_METRICS)
    assert media_type == "application/openmetrics-text; version=1.0.0; charset=utf-8"
    assert text.endswith(b"# EOF\n")
    return text.decode()


def fed(figures: RunFigures = FIGURES) -> RunFeed:
    feed = RunFeed()
    feed.take(figures)
    return feed


@pytest.mark.rest
def test_every_declared_metric_appears_with_its_type_labels_and_text(watched: tuple[Path, list[str]]) -> None:
    """And no other one."""
    directory, texts = watched
    metric = CampaignMetrics(directory, fed(replace(FIGURES, link=RouterLink(None, 2))))
    ahead = Expected(
        share=0.5,
        by_budget=False,
        tests=Span(low=10, middle=20, high=30),
        most_tests=30,
        seconds=Span(low=1, middle=2, high=3),
        bound=Span(low=0, middle=0, high=0),
        verdict=None,
    )
    whole = metric.refresh()
    host = next(iter(whole.counts.attempts))
    failed = replace(whole.counts, outcomes={**whole.counts.outcomes, (host, "system"): 1, (host, "handed back"): 2})
    assert whole.standing is not None
    standing = replace(whole.standing, required=0.5)
    given = replace(whole, counts=failed, state="running", standing=standing, ahead=ahead, tests=15)
    metric._last, metric._due = given, float("inf")
    found = families(metric.exposition(OPEN_METRICS)[0].decode())
    assert len({each.name for each in METRICS}) == len(METRICS)
    for declared in METRICS:
        family = found.pop(declared.name.removesuffix("_total").removesuffix("_info"))
        assert (family.type, family.documentation) == (declared.kind, declared.text)
        labels = {name for sample in family.samples for name in sample.labels}
        assert labels == set(declared.labels), declared.name
    assert found == {}
    left = numbers(metric.exposition(OPEN_METRICS)[0].decode())
    estimates = {end: value(left, "perfbound_forecast_left_tests", estimate=end) for end in ("low", "middle", "high")}
    assert estimates == {"low": 0, "middle": 5, "high": 15}
    assert {name for text in texts for name in families(text)} <= {
        each.name.removesuffix("_total").removesuffix("_info") for each in METRICS
    }


def test_counters_never_fall_and_end_with_what_the_database_has(
    watched: tuple[Path, list[str]], counts: CampaignCounts
) -> None:
    directory, texts = watched
    assert len(set(texts)) > 3
    before: Numbers = {}
    for text in (*texts, text_of(directory)):
        now = numbers(text)
        for (name, labels), number in before.items():
            if name.endswith("_total"):
                assert now[name, labels] >= number
        before = now
    for name, each in counts.series.items():
        assert value(before, "perfbound_rollouts_total", problem=name) == each.rollouts
        assert value(before, "perfbound_tests_total", problem=name) == each.tests
    host = next(iter(counts.attempts))
    assert value(before, "perfbound_attempts_total", host=host) == counts.attempts[host]
    assert value(before, "perfbound_results_total", host=host) == sum(each.rollouts for each in counts.series.values())


def test_a_finished_campaign_has_its_verdict_and_no_forecast(watched: tuple[Path, list[str]]) -> None:
    directory, texts = watched
    found, story = numbers(text_of(directory)), Collector(directory).refresh()
    assert story.verdict is not None
    assert value(found, "perfbound_verdict", verdict=story.verdict.word) == 1
    assert sum(number for (name, _), number in found.items() if name == "perfbound_verdict") == 1
    assert value(found, "perfbound_certificate_issued") == value(found, "perfbound_done_ratio") == 1
    assert value(found, "perfbound_state", state="finished") == 1
    assert value(found, "perfbound_state", state="running") == 0
    assert value(found, "perfbound_bound", problem="maximum", sense="<=") == pytest.approx(story.problems[0].bound)
    worst = value(found, "perfbound_worst_observed", problem="maximum", sense="<=")
    assert worst == pytest.approx(max(filter(None, story.problems[0].tests.y)))
    assert not [name for name, _ in found if "forecast" in name]
    during = numbers(texts[-1])
    assert value(during, "perfbound_certificate_issued") == 0
    assert value(during, "perfbound_state", state="running") == 1


def test_what_only_a_run_knows(watched: tuple[Path, list[str]]) -> None:
    directory, texts = watched
    found = numbers(text_of(directory, fed()))
    assert value(found, "perfbound_workers", phase="idle") == 3
    assert value(found, "perfbound_workers", phase="set aside") == 1
    assert value(found, "perfbound_workers", phase="gone") == 0, "every phase has a value, so that none disappears"
    assert value(found, "perfbound_rollouts_open", state="waiting") == 7
    assert value(found, "perfbound_rollouts_open", state="under_way") == 2
    assert value(found, "perfbound_queue_messages") == 1
    assert not [name for name, _ in found if "router" in name], "this run has none"
    for link, up in ((RouterLink(None, 2), 1), (RouterLink(3.5, 0), 0)):
        behind = numbers(text_of(directory, fed(replace(FIGURES, link=link))))
        assert value(behind, "perfbound_router_link_up") == up
        assert value(behind, "perfbound_routers") == link.routers
    assert value(found, "perfbound_loop_timestamp_seconds") == 1.8e9
    assert value(found, "perfbound_commit_seconds_bucket", le="0.001") == 0
    assert value(found, "perfbound_commit_seconds_bucket", le="0.0025") == 1
    assert (
        value(found, "perfbound_commit_seconds_bucket", le="+Inf")
        == value(found, "perfbound_commit_seconds_count")
        == 2
    )
    assert value(found, "perfbound_commit_seconds_sum") == pytest.approx(20.002)
    of_run = {each.name for each in METRICS if each.place == "run"}
    assert not [name for name in families(text_of(directory)) if name in of_run], "this page has no run"
    busy = [numbers(text) for text in texts]
    assert max(value(each, "perfbound_rollouts_open", state="under_way") for each in busy) >= 1
    assert value(busy[-1], "perfbound_rollouts_open", state="waiting") == 0


def test_a_client_gets_the_format_that_it_accepts(watched: tuple[Path, list[str]]) -> None:
    metric = CampaignMetrics(watched[0], fed())
    for accept in ("", "*/*", "text/html", "text/plain;version=0.0.4", ";;;,,,=", "application/json"):
        text, media_type = metric.exposition(accept)
        assert media_type == "text/plain; version=0.0.4; charset=utf-8"
        names = {each.name for each in parsed_plain(text.decode())}
        assert {"perfbound_rollouts", "perfbound_commit_seconds", "perfbound_bound"} <= names
    for accept in ("application/openmetrics-text", OPEN_METRICS, "text/plain, Application/OpenMetrics-Text; version=x"):
        assert metric.exposition(accept)[0].endswith(b"# EOF\n")


# Names of hosts, which are texts of workers

hostile = st.text(st.characters(), max_size=200) | st.sampled_from(
    ['a"} 1\nperfbound_bound 99', "\\", '"', "\n", "a\\nb", OTHER, "\ud800", "\u2028", "{}", "#", "é"]
)


def of_hosts(counts: CampaignCounts, hosts: Mapping[str, int], failures: Mapping[str, int]) -> str:
    metric = CampaignMetrics(Path("nowhere"), None)
    outcomes = {
        (host, kind): n
        for host, n in failures.items()
        for kind in ("system", "infrastructure", "recorded", "handed back")
    }
    given = replace(counts, attempts=dict(hosts), outcomes=outcomes)
    metric._last, metric._due = Watched(given, "running", None, None, 0), float("inf")
    return metric.exposition(OPEN_METRICS)[0].decode()


@given(data=st.data(), hosts=st.dictionaries(hostile, st.integers(1, 9), min_size=1, max_size=120))
def test_no_host_writes_a_line_of_its_own_and_their_number_is_bounded(
    data: st.DataObject, hosts: dict[str, int], counts: CampaignCounts
) -> None:
    failures = {host: data.draw(st.integers(0, number)) for host, number in list(hosts.items())[:3]}
    text = of_hosts(counts, hosts, failures)
    found = families(text)
    usual = families(of_hosts(counts, {"host": 1}, {"host": 1}))
    assert found.keys() <= usual.keys()
    attempts = found["perfbound_attempts"].samples
    assert sum(each.value for each in attempts) == sum(hosts.values())
    assert len(attempts) <= MOST_HOSTS + 1
    assert all(len(each.labels["host"]) <= LONGEST_HOST for each in attempts)
    assert sum(each.value for each in found["perfbound_failures"].samples) == 2 * sum(failures.values())
    values = [sample.value for sample in found["perfbound_bound"].samples]
    assert values == [sample.value for sample in usual["perfbound_bound"].samples]


def test_a_host_keeps_its_label_when_more_come(counts: CampaignCounts) -> None:
    hosts = {f"host-{number}": 1 for number in range(MOST_HOSTS)}
    few = numbers(of_hosts(counts, hosts, {}))
    many = numbers(of_hosts(counts, {**hosts, **{f"later-{number}": 1000 for number in range(500)}}, {"later-7": 5}))
    for number in range(MOST_HOSTS):
        name, label = "perfbound_attempts_total", f"host-{number}"
        assert value(few, name, host=label) == value(many, name, host=label) == 1
    assert value(many, "perfbound_attempts_total", host=OTHER) == 500_000
    assert value(many, "perfbound_failures_total", host=OTHER, kind="system") == 5


# The routes


def client(directory: Path, feed: RunFeed | None = None) -> Client:
    snapshots = SnapshotCache(Collector(directory), pytest.fail)
    return Client(app.application(directory, snapshots, Address("127.0.0.1", 8000), feed=feed))


def ask(directory: Path, path: str, feed: RunFeed | None = None, **asked: Any) -> Answer:
    return asyncio.run(client(directory, feed).ask(path, **asked))


def test_the_route_has_the_media_type_of_its_text(watched: tuple[Path, list[str]]) -> None:
    headers = (("host", "localhost"), ("accept", OPEN_METRICS))
    answer = ask(watched[0], "/metrics", headers=headers)
    assert answer.headers["content-type"] == "application/openmetrics-text; version=1.0.0; charset=utf-8"
    assert parsed_open(answer.text)
    assert ask(watched[0], "/metrics").headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"


def test_many_clients_cost_one_reading(watched: tuple[Path, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    metric, read = CampaignMetrics(watched[0], None), list[float]()
    whole = metric._campaign.read

    def timed() -> Watched:
        read.append(time.monotonic())
        return whole()

    monkeypatch.setattr(metric._campaign, "read", timed)
    for _ in range(20):
        metric.exposition("")
    assert all(later - earlier >= metrics.PAUSE for earlier, later in itertools.pairwise(read))
    assert 1 <= len(read) < 20


def test_clients_that_ask_at_the_same_time_cost_one_reading(
    watched: tuple[Path, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader of the database is for one thread."""
    metric, readings, threads = CampaignMetrics(watched[0], None), list[int](), list[threading.Thread]()
    whole = metric._campaign.read

    def read() -> Watched:
        readings.append(1)
        if len(readings) == 1:
            threads.append(meanwhile(metric.refresh))
        return whole()

    monkeypatch.setattr(metrics, "PAUSE", 60.0)
    monkeypatch.setattr(metric._campaign, "read", read)
    metric.refresh()
    threads[0].join()
    assert len(readings) == 1


def test_probes_of_a_page_without_a_run(watched: tuple[Path, list[str]], tmp_path: Path) -> None:
    """A finished campaign is ready to be read."""
    directory = Path(shutil.copytree(watched[0], tmp_path / "run"))
    for path in ("/healthz", "/readyz"):
        answer = ask(directory, path)
        assert (answer.status, answer.text) == (200, "ok")
    (directory / DATABASE).write_bytes(b"no database" * 1000)
    assert (ask(directory, "/readyz").status, ask(directory, "/readyz").text) == (503, "unreadable")
    assert (ask(directory, "/healthz").status, ask(directory, "/healthz").text) == (200, "ok")
    assert ask(directory, "/metrics").status == 503
    (directory / DATABASE).unlink()
    assert ask(directory, "/readyz").text == "unreadable"


def test_probes_of_the_page_of_a_run(watched: tuple[Path, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    directory, feed, now = watched[0], RunFeed(), [1000.0]
    monkeypatch.setattr(run_feed, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def words() -> tuple[tuple[int, str], tuple[int, str]]:
        healthy, ready = (asyncio.run(served.ask(path)) for path in ("/healthz", "/readyz"))
        return (healthy.status, healthy.text), (ready.status, ready.text)

    served = client(directory, feed)
    now[0] += 1e6
    assert words() == ((200, "ok"), (503, "starting")), "the database is read, which may take long"
    feed.take(FIGURES)
    assert words() == ((200, "ok"), (200, "ok"))
    now[0] += run_feed.RECENT + 1
    assert words() == ((200, "ok"), (503, "stalled"))
    now[0] += run_feed.SILENT
    assert words() == ((503, ""), (503, "stalled"))
    feed.take(replace(FIGURES, done=True))
    now[0] += 1e6
    assert words() == ((200, "ok"), (200, "ok")), "the certificate is made, which may take long"


def test_what_a_run_sends_is_what_its_page_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    status = RunStatus(config("test-function"), {}, {}, {"a": "sent", "b": "set aside", "c": "sent"}, {}, 3, 4, 5.0, 6)
    found = read_message(feed_message(status))
    assert (found.phases, found.waiting, found.under_way, found.done) == ({"sent": 2, "set aside": 1}, 4, 6, False)
    assert {name: each.state for name, each in found.workers.items()} == {"a": "busy", "b": "set aside", "c": "busy"}
    assert found.link is None
    link = RouterLink(3.5, 0)
    assert read_message(feed_message(replace(status, link=link))).link == link
    many = replace(status, workers={f"worker-{number:06}-0123456789abcdef": "busy" for number in range(20_000)})
    sent = feed_message(many)
    assert len(sent) < 200_000, "the kernel takes no more"
    assert read_message(sent).phases == {"busy": 20_000}


def test_declarations_follow_the_conventions() -> None:
    for each in METRICS:
        assert each.name.startswith("perfbound_")
        assert each.name.endswith("_total") == (each.kind == "counter")
        assert each.name.endswith("_info") == (each.kind == "info")
        assert each.text.endswith(".")
