"""The metrics of a campaign: what `/metrics` has, and the table of them in the docs is made from.

Names and units follow the conventions of Prometheus. No label has a value for each worker, rollout or test: with those,
a campaign of weeks would make a time series of its own for each of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

MOST_HOSTS = 50
"""Hosts with a label of their own; all that came later are one, `OTHER`."""
LONGEST_HOST = 64
"""Characters of a host in a label."""
OTHER = "other"

Kind = Literal["counter", "gauge", "histogram", "info"]
Place = Literal["database", "run", "so far"]
"""Where a number comes from. `database`: it is there for every campaign, and continues after a resume. `run`: from the
orchestrator whose page this is. `so far`: what a run has shown so far, or the certificate."""


@dataclass(frozen=True, slots=True)
class DeclaredMetric:
    """One metric family; the name is that of its samples but for the suffixes of a histogram."""

    name: str
    kind: Kind
    labels: tuple[str, ...]
    place: Place
    text: str


METRICS = (
    DeclaredMetric("perfbound_build_info", "info", ("version",), "database", "The perfbound that serves the page."),
    DeclaredMetric(
        "perfbound_campaign_info",
        "info",
        ("campaign", "run", "digest", "system"),
        "database",
        "Name, run id and system of the campaign; the digest is the SHA-256 of its file.",
    ),
    DeclaredMetric(
        "perfbound_state",
        "gauge",
        ("state",),
        "database",
        "1 for the state of the campaign: running, stopped, finished.",
    ),
    DeclaredMetric("perfbound_tests_total", "counter", ("problem",), "database", "Tests that were observed."),
    DeclaredMetric("perfbound_rollouts_total", "counter", ("problem",), "database", "Rollouts that were recorded."),
    DeclaredMetric(
        "perfbound_violations_total",
        "counter",
        ("problem",),
        "database",
        "Recorded rollouts with a robustness below 0.",
    ),
    DeclaredMetric("perfbound_attempts_total", "counter", ("host",), "database", "Attempts that were started."),
    DeclaredMetric(
        "perfbound_results_total", "counter", ("host",), "database", "Attempts whose result was recorded or restored."
    ),
    DeclaredMetric(
        "perfbound_handed_back_total",
        "counter",
        ("host",),
        "database",
        "Attempts that a worker gave back because it was stopped; another one gets their rollouts.",
    ),
    DeclaredMetric(
        "perfbound_failures_total",
        "counter",
        ("host", "kind"),
        "database",
        "Attempts that failed, by kind of the reason: system (the system under test) or infrastructure (all else).",
    ),
    DeclaredMetric(
        "perfbound_bound",
        "gauge",
        ("problem", "sense"),
        "database",
        "Bound that holds so far for the objective; sense is >= or <=.",
    ),
    DeclaredMetric(
        "perfbound_worst_observed",
        "gauge",
        ("problem", "sense"),
        "database",
        "Worst value of the objective in a test of the problem; the bound cannot pass it. Starts of the spot check are "
        "not among them: for these see perfbound_violations_total.",
    ),
    DeclaredMetric(
        "perfbound_rollouts_open",
        "gauge",
        ("state",),
        "run",
        "Rollouts that are wanted and not recorded: waiting for a worker, or under_way.",
    ),
    DeclaredMetric("perfbound_workers", "gauge", ("phase",), "run", "Workers by phase."),
    DeclaredMetric(
        "perfbound_router_link_up",
        "gauge",
        (),
        "run",
        "1 while the orchestrator has a link to a router, else 0; only where it connects to one.",
    ),
    DeclaredMetric(
        "perfbound_routers", "gauge", (), "run", "Routers that the orchestrator sees; only where it connects to one."
    ),
    DeclaredMetric(
        "perfbound_queue_messages", "gauge", (), "run", "Messages of workers that the loop has received and not taken."
    ),
    DeclaredMetric(
        "perfbound_commit_seconds",
        "histogram",
        ("le",),
        "run",
        "Time of a commit of the database until it is on the disk, since this orchestrator started.",
    ),
    DeclaredMetric(
        "perfbound_loop_timestamp_seconds", "gauge", (), "run", "Unix time at which the loop last sent these numbers."
    ),
    DeclaredMetric("perfbound_certificate_issued", "gauge", (), "so far", "1 if there is a certificate, else 0."),
    DeclaredMetric(
        "perfbound_verdict",
        "gauge",
        ("verdict",),
        "so far",
        "1 for the verdict SHOWN, VIOLATED or NOT SHOWN: of the certificate, else if the campaign ended now.",
    ),
    DeclaredMetric("perfbound_claim_bound", "gauge", ("sense",), "so far", "Bound of the first claim."),
    DeclaredMetric(
        "perfbound_claim_required", "gauge", ("sense",), "so far", "What the campaign file requires of that bound."
    ),
    DeclaredMetric(
        "perfbound_assumptions_refuted", "gauge", (), "so far", "Assumptions that the data refute, of all claims."
    ),
    DeclaredMetric(
        "perfbound_done_ratio", "gauge", (), "so far", "Share of the work that is done, by the forecast; 1 at the end."
    ),
    DeclaredMetric(
        "perfbound_forecast_left_tests",
        "gauge",
        ("estimate",),
        "so far",
        "Tests that are left of a running campaign: a low, a middle and a high estimate.",
    ),
    DeclaredMetric(
        "perfbound_forecast_left_seconds",
        "gauge",
        ("estimate",),
        "so far",
        "Time that is left of a running campaign, at the rate of the last minutes.",
    ),
    DeclaredMetric(
        "perfbound_forecast_bound",
        "gauge",
        ("estimate",),
        "so far",
        "Bound of the first claim that is expected at the end of a running campaign.",
    ),
)


PLACES: Mapping[Place, str] = {
    "database": "every campaign, by its database",
    "run": "a run, on its own page",
    "so far": "what a run has shown so far, or its certificate",
}
"""The rows of the table in the docs."""


def metrics_table() -> str:
    """Return the names and labels of the metrics by their place, as a table in Markdown; `text` is in `/metrics`."""
    rows = [f"| {words} | {', '.join(map(_selector, _of_place(place)))} |" for place, words in PLACES.items()]
    return "\n".join(["| of | metrics |", "|---|---|", *rows])


def _of_place(place: Place) -> list[DeclaredMetric]:
    return [each for each in METRICS if each.place == place]


def _selector(metric: DeclaredMetric) -> str:
    labels = ",".join(metric.labels)
    return f"`{metric.name}{{{labels}}}`" if labels else f"`{metric.name}`"
