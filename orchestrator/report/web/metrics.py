"""The metrics of a campaign in the text formats of OpenMetrics and Prometheus, made at each request."""

import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import get_args

from prometheus_client import CollectorRegistry, Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.exposition import generate_latest as plain_text
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
)
from prometheus_client.openmetrics.exposition import CONTENT_TYPE_LATEST
from prometheus_client.openmetrics.exposition import generate_latest as open_metrics
from prometheus_client.registry import Collector as MetricSource

from ....schemas import __version__
from ....schemas.result.facts import HANDED_BACK, NO_FAILURE
from ....schemas.result.known import Span, VerdictWord
from ....schemas.values import Bound, ProblemProgress
from ...fleet.dispatch.state import WorkerPhase
from ...run.display.progress_table import bound_in_sense
from ...run.page.page_feed import RunFigures
from ...store.commit_times import EDGES, CommitTimes, cumulative
from ...store.counts import CampaignCounts
from ..data.page import State
from .metric_list import LONGEST_HOST, METRICS, MOST_HOSTS, OTHER, DeclaredMetric
from .run_feed import RunFeed
from .watched import ClaimNow, Watched, WatchedCampaign

PAUSE = 1.0
"""Seconds between two readings of the database at least, however many ask."""
PHASES = (*get_args(WorkerPhase), "set aside", "out of reach")
Samples = Mapping[tuple[str, ...], float]
"""Value by the values of the labels, in the order of the declaration."""


class CampaignMetrics(MetricSource):
    """The metrics of one campaign; any thread may ask for them."""

    def __init__(self, directory: Path, feed: RunFeed | None) -> None:
        self._campaign, self._feed = WatchedCampaign(directory), feed
        self._lock, self._due = threading.Lock(), 0.0
        self._last: Watched | None = None
        # Of our own: the default one has numbers of this process, which is not the orchestrator.
        self._registry = CollectorRegistry()
        self._registry.register(self)

    def refresh(self) -> Watched:
        """Return the numbers of at most `PAUSE` s ago.

        Raises:
            PerfboundError: the campaign cannot be read.
            OSError: the disk fails.

        """
        with self._lock:
            if self._last is None or time.monotonic() >= self._due:
                self._last = self._campaign.read()
                self._due = time.monotonic() + PAUSE
            return self._last

    def exposition(self, accept: str) -> tuple[bytes, str]:
        """Return the metrics as a client accepts them, and their media type; Prometheus accepts OpenMetrics."""
        types = {each.partition(";")[0].strip().lower() for each in accept.split(",")}
        if "application/openmetrics-text" in types:
            text: bytes = open_metrics(self._registry)  # type: ignore[no-untyped-call]
            return text, CONTENT_TYPE_LATEST
        return plain_text(self._registry), CONTENT_TYPE_PLAIN_0_0_4

    def collect(self) -> Iterator[Metric]:
        """Yield the metric families that have values."""
        watched = self.refresh()
        found = samples(watched)
        figures = self._feed.figures if self._feed else None
        if figures is not None:
            found |= samples_of_run(figures)
        for declared in METRICS:
            if declared.name == COMMITS and figures is not None:
                yield _commit_histogram(declared, figures.commits)
            elif values := found.get(declared.name):
                yield _metric_family(declared, values)


COMMITS = "perfbound_commit_seconds"


def samples(watched: Watched) -> dict[str, Samples]:
    """Return the values that do not depend on a run, by metric."""
    header, state = watched.counts.header, watched.state
    info = (header.config.name, header.run, header.config_sha256, header.spec.name)
    found: dict[str, Samples] = {
        "perfbound_build_info": {(__version__,): 1},
        "perfbound_campaign_info": {info: 1},
        "perfbound_state": {(each,): float(each == state) for each in get_args(State)},
        "perfbound_certificate_issued": {(): float(state == "finished")},
        **_series_samples(watched.counts),
        **_host_samples(watched.counts),
    }
    if watched.standing is not None:
        found |= _claim_samples(watched.standing)
    if state == "finished":
        found["perfbound_done_ratio"] = {(): 1}
    elif (ahead := watched.ahead) is not None:
        left = ahead.tests and Span(**{end: max(0.0, n - watched.tests) for end, n in ahead.tests.model_dump().items()})
        found["perfbound_done_ratio"] = {(): ahead.share}
        found["perfbound_forecast_left_tests"] = _estimates(left)
        found["perfbound_forecast_left_seconds"] = _estimates(ahead.seconds)
        found["perfbound_forecast_bound"] = _estimates(ahead.bound)
    return found


def samples_of_run(figures: RunFigures) -> dict[str, Samples]:
    """Return the values that the orchestrator of a run sends, by metric, but for the times of its commits."""
    link = figures.link
    return {
        "perfbound_rollouts_open": {("waiting",): figures.waiting, ("under_way",): figures.under_way},
        "perfbound_workers": {(phase,): figures.phases.get(phase, 0) for phase in PHASES},
        "perfbound_queue_messages": {(): figures.messages},
        "perfbound_loop_timestamp_seconds": {(): figures.at},
        "perfbound_router_link_up": {} if link is None else {(): float(link.down_for is None)},
        "perfbound_routers": {} if link is None else {(): link.routers},
    }


def _series_samples(counts: CampaignCounts) -> dict[str, Samples]:
    config, bounds, worst = counts.header.config, dict[tuple[str, ...], float](), dict[tuple[str, ...], float]()
    for problem in config.problems:
        each, sense = counts.series.get(problem.name), config.sense_of(problem)
        if each is None:
            continue
        labels = (problem.name, ">=" if sense == "min" else "<=")
        progress = ProblemProgress(each.tests, each.rollouts, None, Bound(each.upper, None, None), None)
        if (bound := bound_in_sense(config, problem, progress)) is not None:
            bounds[labels] = bound
        if each.greatest is not None:
            worst[labels] = -each.greatest if sense == "min" else each.greatest
    return {
        "perfbound_tests_total": {(name,): each.tests for name, each in counts.series.items()},
        "perfbound_rollouts_total": {(name,): each.rollouts for name, each in counts.series.items()},
        "perfbound_violations_total": {(name,): each.violations for name, each in counts.series.items()},
        "perfbound_bound": bounds,
        "perfbound_worst_observed": worst,
    }


def _host_samples(counts: CampaignCounts) -> dict[str, Samples]:
    # The first ones, not the busiest: a host that lost its label to another would begin again at 0.
    own = {host_label(host) for host in islice(counts.attempts, MOST_HOSTS)}

    def label(host: str) -> str:
        return found if (found := host_label(host)) in own else OTHER

    attempts, results, back, failures = (Counter[tuple[str, ...]]() for _ in range(4))
    for host, number in counts.attempts.items():
        attempts[label(host),] += number
    for (host, outcome), number in counts.outcomes.items():
        if outcome == HANDED_BACK:
            back[label(host),] += number
        elif outcome in NO_FAILURE:
            results[label(host),] += number
        else:
            failures[label(host), outcome] += number
    return {
        "perfbound_attempts_total": attempts,
        "perfbound_results_total": results,
        "perfbound_handed_back_total": back,
        "perfbound_failures_total": failures,
    }


def host_label(host: str) -> str:
    """Return a host, which is text of a worker, as the value of a label: one line, of bounded length.

    >>> host_label("a\\nb" + 100 * "c") == "a?b" + 61 * "c"
    True
    """
    return "".join(each if each.isprintable() else "?" for each in host[:LONGEST_HOST])


def _claim_samples(standing: ClaimNow) -> dict[str, Samples]:
    sense = (standing.sense,)
    return {
        "perfbound_verdict": {(word,): float(word == standing.verdict) for word in get_args(VerdictWord)},
        "perfbound_claim_bound": {} if standing.bound is None else {sense: standing.bound},
        "perfbound_claim_required": {} if standing.required is None else {sense: standing.required},
        "perfbound_assumptions_refuted": {(): standing.refuted},
    }


def _estimates(span: Span | None) -> Samples:
    return {} if span is None else {(end,): value for end, value in span.model_dump().items()}


def _metric_family(declared: DeclaredMetric, values: Samples) -> Metric:
    name, text, labels = declared.name, declared.text, declared.labels
    if declared.kind == "info":
        info = InfoMetricFamily(name.removesuffix("_info"), text)
        for given in values:
            info.add_metric([], dict(zip(labels, given, strict=True)))
        return info
    family = (CounterMetricFamily if declared.kind == "counter" else GaugeMetricFamily)(name, text, labels=labels)
    for given, value in values.items():
        family.add_metric(given, value)
    return family


def _commit_histogram(declared: DeclaredMetric, times: CommitTimes) -> Metric:
    edges = (*map(str, EDGES), "+Inf")
    buckets = [(edge, float(number)) for edge, number in zip(edges, cumulative(times.numbers), strict=True)]
    return HistogramMetricFamily(declared.name, declared.text, buckets=buckets, sum_value=times.seconds)
