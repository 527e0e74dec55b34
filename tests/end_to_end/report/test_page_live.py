"""The live page in a real browser; the test simulates its server."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
from playwright.sync_api import Browser, Route

from perfbound.orchestrator.report import html
from perfbound.orchestrator.report.data.claims import AssumptionRow
from perfbound.orchestrator.report.data.page import LiveCard, ReportData, to_json
from perfbound.orchestrator.run.routers import RouterLink
from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report import example_reports
from tests.end_to_end.report.browser import Watched

browser = chromium.browser

ORIGIN = "http://campaign.test"


class Campaign:
    """The server of a live page: every answer of `/events` ends after one event, and the browser reconnects."""

    def __init__(self, watch: Watched) -> None:
        self.watch, self.tests, self.refusing = watch, 4, 0
        self.report: Callable[[int], ReportData] = example_reports.running
        self.fetched: list[str] = []
        watch.page.route(f"{ORIGIN}/**", self._answer)

    def _answer(self, route: Route) -> None:
        path = route.request.url.removeprefix(ORIGIN)
        if path == "/":
            route.fulfill(
                content_type="text/html", body=html.served_page("live", to_json(example_reports.begun())).html
            )
        elif path == "/events" and self.refusing:
            self.refusing -= 1
            route.fulfill(status=503)
        elif path == "/events":
            text = f"retry: 20\n\nevent: story\ndata: {to_json(self.report(self.tests))}\n\n"
            route.fulfill(content_type="text/event-stream", body=text)
        else:
            self.fetched.append(path)
            number = int(path.rpartition("=")[2])
            route.fulfill(
                content_type="application/json",
                body=to_json(example_reports.rollouts_of_test("nominal_robustness", number)),
            )

    def wait_for_tests(self, tests: int) -> None:
        self.watch.page.wait_for_selector(f"#map-0[data-tests='{tests}']")


def test_a_page_without_data_says_so_and_draws_what_the_events_bring(browser: Browser) -> None:
    """A campaign of a million rollouts takes seconds to read for the first time."""
    events = ["event: fault\ndata: runs/a: no campaign here\n\n", ""]

    def answer(route: Route) -> None:
        if route.request.url.endswith("/events"):
            text = events.pop(0) if events else f"event: story\ndata: {to_json(example_reports.running(4))}\n\n"
            route.fulfill(content_type="text/event-stream", body=f"retry: 200\n\n{text}")
        else:
            route.fulfill(content_type="text/html", body=html.served_page("live", "").html)

    with chromium.watched(browser) as watch:
        watch.page.route(f"{ORIGIN}/**", answer)
        watch.page.goto(f"{ORIGIN}/")
        watch.page.wait_for_selector("#reading:text('no campaign here')")
        watch.shown()
        assert watch.page.locator("#reading").count() == 0
        assert watch.errors == []


@pytest.fixture
def campaign(browser: Browser) -> Iterator[Campaign]:
    with chromium.watched(browser) as watch:
        found = Campaign(watch)
        watch.page.goto(f"{ORIGIN}/")
        found.wait_for_tests(4)
        yield found


def test_a_live_page_follows_and_keeps_the_choices_of_the_reader(campaign: Campaign) -> None:
    page = campaign.watch.page
    page.click("#problem-0 [data-series=lower]")
    page.click('[data-test="nominal_robustness:2"]')
    page.wait_for_selector("#test[data-test='2'][data-curves='3']")
    page.locator("#assumptions details").last.locator("summary").click()
    page.evaluate("window.kept = [document.getElementById('map-0'), document.querySelector('#decay-0 .uplot')]")
    page.evaluate("window.scrollTo({top: 700, behavior: 'instant'})")
    page.focus("#problem-0 [data-series=lower]")
    where, charts = page.evaluate("scrollY"), page.locator(".uplot").count()
    for tests in range(5, 12):
        campaign.tests = tests
        campaign.wait_for_tests(tests)
    assert page.locator("#test").get_attribute("data-test") == "2"
    assert page.locator("#map-0").get_attribute("data-series") == "lower"
    assert page.locator("#assumptions details").last.get_attribute("open") is not None
    assert page.evaluate("kept[0] === document.getElementById('map-0') && kept[1].isConnected")
    assert page.evaluate("document.activeElement.dataset.series") == "lower"
    assert page.evaluate("scrollY") == where
    assert page.locator(".uplot").count() == charts == page.evaluate("charts.size")
    assert len([path for path in campaign.fetched if path.endswith("test=2")]) == 1
    assert campaign.watch.errors == []


def test_a_live_page_fetches_the_rollouts_of_the_worst_test(campaign: Campaign) -> None:
    worst = example_reports.worst(example_reports.running(4).problems[0])
    campaign.watch.page.wait_for_selector(f"#test[data-test='{worst}'][data-curves='3']")
    assert campaign.fetched[0] == f"/scene?problem=nominal_robustness&test={worst}"


def test_a_live_page_fetches_further_columns_when_they_are_wanted(campaign: Campaign) -> None:
    """Its events have the rollouts of some tests, without these columns."""
    page = campaign.watch.page
    scene = example_reports.rollouts_of_test("nominal_robustness", 2)
    campaign.report = lambda tests: example_reports.running(tests, scenes=(replace(scene, further=()),))
    campaign.tests = 5
    campaign.wait_for_tests(5)
    page.click('[data-test="nominal_robustness:2"]')
    page.wait_for_selector("#test[data-test='2'] #curves-0 canvas")
    asked = [path for path in campaign.fetched if path.endswith("test=2")]
    assert asked == [], "the curves of the specification came with the event"
    page.click('[data-column="vx"]')
    page.wait_for_selector("figcaption:has-text('vx (rad) against time')")
    page.wait_for_selector("#curves-1 canvas")
    assert [path for path in campaign.fetched if path.endswith("test=2")] == [
        "/scene?problem=nominal_robustness&test=2"
    ]
    assert campaign.watch.errors == []


def test_a_live_page_reconnects_after_its_server_was_away(campaign: Campaign) -> None:
    """An HTTP error closes an EventSource; the page opens a new one."""
    page = campaign.watch.page
    campaign.refusing = 1
    page.wait_for_selector("#live[data-connection=lost]")
    assert "connection lost, retrying; updated at " in page.locator("#live").inner_text()
    campaign.tests = 9
    campaign.wait_for_tests(9)
    assert campaign.refusing == 0
    assert page.evaluate("page.connection") in ("live", "lost")


def test_a_finished_campaign_is_said_to_be_finished(campaign: Campaign) -> None:
    """Also where the server ends at once: it is no lost connection, and no worker lacks a heartbeat."""
    page = campaign.watch.page
    campaign.report = lambda tests: replace(example_reports.running(tests), state="finished")
    campaign.tests = 6
    page.wait_for_selector("#live[data-connection=ended]")
    campaign.refusing = 1000
    page.wait_for_timeout(1500)
    assert "the campaign has finished" in page.locator("#live").inner_text()
    assert "never" not in page.locator("#workers").inner_text()
    assert campaign.watch.errors == []


CARD = LiveCard(
    at=1.8e9,
    head=("", "bound", "probability", "tests", "verdict"),
    rows=(
        ("proven so far", ">= 0.1250 rad", "at least 0.9500", "30", "if it ended now: NOT SHOWN"),
        (
            "expected at the end",
            "about 0.31 (0.25 to 0.4 rad)",
            "at least 0.9500",
            "about 56 (37 to 60)",
            "SHOWN, in about 32 s",
        ),
    ),
    verdict="NOT SHOWN",
    ahead="SHOWN",
    reason="The bound 0.1250 does not reach the required 0.2 rad.",
    share=0.255,
    bar="25 % of the work, by forecast",
    violations="2 of 300 rollouts violate the specification so far; the worst -0.0312 rad",
    violated=True,
    tested=(
        AssumptionRow("replicate_spread/robustness", "Repeated rollouts vary no more", "refuted", "they vary more <b>"),
        AssumptionRow("rkhs_norm/sim_gap", "The norm of the gap", "refuted", "it is too small"),
        AssumptionRow("rkhs_norm/robustness", "The norm is large enough", "not refuted", "a norm of 2 is enough"),
    ),
    others=("rkhs_norm/sim_gap",),
    then="The campaign continues.",
)


def test_what_holds_now_is_on_the_first_screen_and_a_refutation_is_red(campaign: Campaign) -> None:
    page = campaign.watch.page
    assert page.locator("#holding, #tested").count() == 0, "its orchestrator has written nothing yet"
    campaign.report = lambda tests: replace(example_reports.running(tests), live=CARD)
    campaign.tests = 5
    page.wait_for_selector("#holding table")
    rows = page.locator("#holding tbody tr")
    assert rows.nth(0).inner_text().split("\t")[0] == "proven so far"
    assert rows.nth(0).inner_text().endswith("if it ended now: NOT SHOWN")
    assert rows.nth(1).inner_text().endswith("SHOWN, in about 32 s")
    assert page.locator("#holding progress").get_attribute("value") == "25"
    assert page.locator("#holding .bad").inner_text().startswith("2 of 300 rollouts violate")
    box = page.locator("#holding").bounding_box()
    assert box is not None
    assert box["y"] + box["height"] < 900
    refuted = page.locator("#tested .refuted")
    assert "they vary more <b>" in refuted.inner_text(), "a text is no markup"
    assert "rkhs_norm" not in refuted.inner_text()
    assert "sim_gap" not in refuted.inner_text(), "the first claim does not rest on it"
    further, passed = page.locator("#tested summary").all_inner_texts()
    assert further.startswith("1 refuted, on which the first claim does not rest: The norm of the gap")
    assert passed.startswith("1 not refuted so far")
    line = page.evaluate("getComputedStyle(document.querySelector('#tested .refuted')).borderTopColor")
    assert line == "rgb(198, 43, 32)"
    assert campaign.watch.overflow() <= 0
    assert campaign.watch.errors == []


def test_a_campaign_that_stops_is_no_lost_connection(campaign: Campaign) -> None:
    page = campaign.watch.page
    campaign.report = lambda tests: replace(
        example_reports.running(tests), live=CARD, state="stopped", resume="perfbound resume r"
    )
    campaign.tests = 5
    page.wait_for_selector("#live[data-connection=stopped]")
    campaign.refusing = 1000
    page.wait_for_timeout(1500)
    said = page.locator("#live").inner_text()
    assert said.startswith("stopped: no process runs this campaign; continue with: perfbound resume r; updated at ")
    assert "live" not in said
    assert page.locator("#holding h2").inner_text() == "What held when it stopped"
    assert "never" not in page.locator("#workers").inner_text()
    assert page.locator("#workers th", has_text="Heartbeat").count() == 0
    campaign.refusing, campaign.tests = 0, 6
    campaign.report = example_reports.running
    campaign.wait_for_tests(6)
    assert page.locator("#live").get_attribute("data-connection") in ("live", "lost"), "it was resumed"


def test_the_top_line_names_a_link_to_the_router_that_is_down(campaign: Campaign) -> None:
    def shown() -> tuple[str, str, str]:
        """Return the top line of a page that follows, and the colours of its text and its dot."""
        text, *colours = campaign.watch.page.evaluate("""() => {
            setConnection("live"); // the server of this test ends each stream after one event
            const line = document.getElementById("live");
            return [line.innerText, getComputedStyle(line).color, getComputedStyle(line, "::before").backgroundColor];
        }""")
        return text, colours[0], colours[1]

    campaign.report = lambda tests: replace(example_reports.running(tests), link=RouterLink(12.3, 0))
    campaign.tests = 5
    campaign.wait_for_tests(5)
    text, ink, dot = shown()
    assert text.startswith("live; updated at ")
    assert text.endswith("; the link to the router has been down for 12 s")
    assert (ink, dot) == ("rgb(163, 18, 10)", "rgb(198, 43, 32)")
    campaign.report = lambda tests: replace(example_reports.running(tests), link=RouterLink(None, 1))
    campaign.tests = 6
    campaign.wait_for_tests(6)
    text, ink, dot = shown()
    assert "router" not in text
    assert dot == "rgb(0, 121, 90)"
    assert campaign.watch.errors == []


def test_a_counterexample_appears_on_a_live_page_with_its_trajectory(campaign: Campaign) -> None:
    page = campaign.watch.page
    assert page.locator("#counterexample").count() == 0
    campaign.report = lambda tests: example_reports.ended_by_counterexample(example_reports.running(tests), tests - 1)
    campaign.tests = 5
    page.wait_for_selector("#counterexample")
    assert "Test 4 violates the specification." in page.locator("#counterexample").inner_text()
    page.wait_for_selector("#test[data-test='4'][data-curves='3']")
    assert campaign.watch.errors == []
