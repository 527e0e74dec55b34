"""The files for Prometheus and Grafana name metrics and labels that there are; the docs have all of them."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.report.web.metric_list import METRICS, metrics_table
from tests.architecture.prometheus import parsed

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "deploy" / "grafana"
TARGET = frozenset({"instance", "job"})
"""Labels that Prometheus adds."""
HISTOGRAM = ("_bucket", "_sum", "_count")
LEGEND = re.compile(r"\{\{(\w+)\}\}")


def samples() -> dict[str, frozenset[str]]:
    """Return the labels of every sample that Prometheus stores."""
    found = {}
    for each in METRICS:
        names = [f"{each.name}{end}" for end in HISTOGRAM] if each.kind == "histogram" else [each.name]
        for name in names:
            own = set(each.labels) if name.endswith("_bucket") else set(each.labels) - {"le"}
            found[name] = frozenset(own) | TARGET
    return found


SAMPLES = {**samples(), "up": TARGET}
"""Of `up`, Prometheus itself makes one for each page."""


def check(query: str, legend: str = "") -> None:
    """Refuse a query with a metric, or a label of one, that there is not; a legend has the labels that remain."""
    found = parsed(query)
    there = frozenset[str]()
    for name, labels in found.metrics.items():
        assert name in SAMPLES, (name, query)
        assert labels <= SAMPLES[name], (labels - SAMPLES[name], query)
        there |= SAMPLES[name]
    assert found.listed <= there, (found.listed - there, query)
    remaining = found.listed if re.search(r"\bsum by\b", query) else there
    assert set(LEGEND.findall(legend)) <= remaining, (legend, query)


def dashboard() -> Any:
    return json.loads((FOLDER / "perfbound.json").read_text())


def panels() -> Iterator[Any]:
    yield from dashboard()["panels"]


def test_every_query_of_the_dashboard_is_about_metrics_that_there_are() -> None:
    seen = set()
    for panel in panels():
        assert panel["targets"], panel["title"]
        for target in panel["targets"]:
            check(target["expr"], target["legendFormat"])
            seen |= set(parsed(target["expr"]).metrics)
            assert 'instance="$instance"' in target["expr"], "each page is shown by itself"
    variables = {each["name"]: each for each in dashboard()["templating"]["list"]}
    assert list(variables) == ["datasource", "campaign", "instance"]
    for name in ("campaign", "instance"):
        check(variables[name]["definition"])
        assert variables[name]["query"]["query"] == variables[name]["definition"]
    wanted = {
        *("perfbound_claim_required", "perfbound_bound", "perfbound_rollouts_total", "perfbound_failures_total"),
        *("perfbound_workers", "perfbound_queue_messages", "perfbound_commit_seconds_bucket", "perfbound_verdict"),
        *("perfbound_forecast_left_seconds", "perfbound_forecast_bound", "perfbound_rollouts_open"),
    }
    assert wanted <= seen


def test_the_dashboard_has_what_grafana_needs_to_import_it() -> None:
    """No Grafana runs here: these are the keys of its documented JSON model."""
    found = dashboard()
    assert {"uid", "title", "schemaVersion", "panels", "templating", "time", "refresh"} <= found.keys()
    assert "id" not in found, "a dashboard that is imported gets its number there"
    taken: set[tuple[int, int]] = set()
    for panel in panels():
        assert panel["type"] in {"stat", "timeseries"}
        assert panel["datasource"] == {"type": "prometheus", "uid": "${datasource}"}
        assert [each["refId"] for each in panel["targets"]] == list("ABCDEFGH"[: len(panel["targets"])])
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert all(0 <= x < 24 for x, _ in cells)
        assert not cells & taken, f"{panel['title']} covers another panel"
        taken |= cells
    numbers = [panel["id"] for panel in panels()]
    assert len(set(numbers)) == len(numbers)


def test_every_alert_is_about_metrics_that_there_are_and_is_described() -> None:
    text, page = (FOLDER / "alerts.yaml").read_text(), (ROOT / "docs/campaign.md").read_text()
    names, queries = (re.findall(rf"^ +(?:- )?{key}: (.+)$", text, re.MULTILINE) for key in ("alert", "expr"))
    assert len(names) == len(queries) >= 4
    for name, query in zip(names, queries, strict=True):
        check(query)
        assert f"`{name}`" in page


def alerts() -> dict[str, str]:
    text = (FOLDER / "alerts.yaml").read_text()
    return dict(re.findall(r"- alert: (\w+)\n +expr: (.+)\n", text))


def test_a_campaign_that_died_and_one_that_is_violated_have_an_alert() -> None:
    """A page ends with its run: after a kill no metric of it is left to compare with."""
    queries = {name: parsed(query).metrics for name, query in alerts().items()}
    assert "up" in queries["PerfboundGone"]
    assert "perfbound_verdict" in queries["PerfboundViolated"]
    assert "perfbound_violations_total" in queries["PerfboundViolation"]


def test_no_worker_is_wanted_while_the_link_is_down() -> None:
    """All of them are then out of reach."""
    assert alerts()["PerfboundNoWorker"].endswith(" unless on (instance) perfbound_router_link_up == 0")


@pytest.mark.parametrize(
    "query",
    [
        *("", "1 + 1", "perfbound_bound{", "perfbound_bound}", "sum(perfbound_bound", "perfbound_bound{problem}"),
        *('perfbound_bound{problem="a" sense="b"}', "perfbound_bound[5 minutes]", "median(perfbound_bound)"),
        *("median by (host) (perfbound_attempts_total)", "sum by host (perfbound_bound)", "sum(down)"),
        *("perfbound_bond", 'perfbound_bound{host="a"}', "sum by (host) (perfbound_bound)", "perfbound_commit_seconds"),
        'perfbound_commit_seconds_sum{le="1"}',
    ],
)
def test_a_query_that_is_wrong_is_found(query: str) -> None:
    with pytest.raises((ValueError, AssertionError)):
        check(query)


def test_the_docs_have_every_metric() -> None:
    page = (ROOT / "docs/campaign.md").read_text()
    assert metrics_table() in page, "`make diagrams` writes it anew"
