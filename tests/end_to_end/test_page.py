"""A report in a real browser, opened from disk."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Position

from perfbound.orchestrator.report import html
from perfbound.orchestrator.report.data import ReportData, to_json
from tests.end_to_end import browser as chromium
from tests.end_to_end import stories
from tests.end_to_end.browser import Scheme, Watched

browser = chromium.browser

STORIES = {
    "refuted": stories.small,
    "calm": stories.calm,
    "starts": stories.starts,
    "profile": stories.profile,
    "no test yet": stories.begun,
    "hostile": stories.hostile,
}
WORST = stories.worst(stories.small().problems[0])


@contextmanager
def opened(
    browser: Browser, folder: Path, story: ReportData, *, width: int = 1280, scheme: Scheme = "light"
) -> Iterator[Watched]:
    """Open the report of a story from disk; whatever the test does, the page logs no error and asks for nothing."""
    file = folder / "report.html"
    file.write_text(html.standalone_page(story.name, to_json(story)).html, "utf-8")
    with chromium.watched(browser, width=width, scheme=scheme) as watch:
        watch.page.goto(file.as_uri())
        watch.shown()
        yield watch
        assert watch.errors == []
        assert watch.requests == [file.as_uri()]


@pytest.mark.parametrize("name", STORIES)
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (360, "light")])
def test_a_report_is_drawn_and_fits(browser: Browser, tmp_path: Path, name: str, width: int, scheme: Scheme) -> None:
    story = STORIES[name]()
    with opened(browser, tmp_path, story, width=width, scheme=scheme) as watch:
        assert watch.overflow() == 0
        for index, problem in enumerate(story.problems):
            map_ = watch.page.locator(f"#map-{index}")
            assert map_.get_attribute("data-tests") == str(len(problem.tests.test))
            assert map_.get_attribute("data-problem") == problem.name
        assert watch.page.evaluate("window.pwned") is None


def test_a_colour_scheme_is_followed(browser: Browser, tmp_path: Path) -> None:
    paper = "getComputedStyle(document.body).backgroundColor"
    with opened(browser, tmp_path, stories.small(), scheme="dark") as watch:
        before, drawn = watch.page.evaluate(paper), watch.drawn()
        watch.page.emulate_media(color_scheme="light")
        watch.page.wait_for_selector(f"html:not([data-drawn='{drawn}'])")
        assert before == "rgb(21, 24, 28)"
        assert watch.page.evaluate(paper) == "rgb(255, 255, 255)"


def test_what_is_refuted_is_said_before_the_claim(browser: Browser, tmp_path: Path) -> None:
    story = stories.small()
    with opened(browser, tmp_path, story) as watch:
        said = watch.page.locator("#verdict").inner_text()
        assert said.index("REFUTED: 1 assumption. Do not rely on the claim below.") < said.index(
            story.claims[0].sentence
        )
        assert story.assumptions[0].detail in said
        assert watch.page.locator("#assumptions summary").all_inner_texts()[0].startswith("1 refuted")
    with opened(browser, tmp_path, stories.calm()) as watch:
        assert watch.page.locator("#refuted").count() == 0
        assert watch.page.locator("#claim").inner_text() == story.claims[0].sentence


def test_no_bound_promises_more_than_it_holds(browser: Browser, tmp_path: Path) -> None:
    """0.17439 is shown as 0.1743 where it bounds from below, as 0.1744 where it bounds from above."""
    with opened(browser, tmp_path, stories.small()) as watch:
        low, high = (watch.page.locator(f"#problem-{index} .facts").inner_text() for index in (0, 1))
        assert ">= 0.1743 rad" in low
        assert ">= 0.9243" in low
        assert "<= 0.1744 rad" in high


def test_clicking_the_worst_test_shows_its_trajectory(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, stories.small()) as watch:
        scene = watch.page.locator("#scene")
        assert scene.get_attribute("data-test") == str(WORST)
        watch.page.click('[data-test="sim_gap:0"]')
        assert scene.get_attribute("data-problem") == "sim_gap"
        assert scene.get_attribute("data-test") == "0"
        assert scene.get_attribute("data-curves") == "3"
        assert watch.page.locator("#curves-0 canvas").count() == 1
        assert watch.page.locator("#scene tbody tr").count() == 3
        assert "perfbound replay runs/small sim_gap.0.true.1" in scene.inner_text()
        links = watch.page.locator("#scene tbody a").evaluate_all("all => all.map(each => each.getAttribute('href'))")
        assert links[0] == "trajectories/sim_gap/0/sim_gap.0.nominal.0.mcap"
        watch.page.click(f'[data-test="nominal_robustness:{WORST}"]')
        assert scene.get_attribute("data-test") == str(WORST)


def test_a_test_without_curves_says_where_they_are(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, stories.small()) as watch:
        watch.page.click('[data-test="sim_gap:1"]')
        assert "not in this page" in watch.page.locator("#scene").inner_text()
        assert watch.page.locator("#scene").get_attribute("data-curves") == "0"


def test_a_dot_of_the_map_shows_its_test(browser: Browser, tmp_path: Path) -> None:
    """Test 0 stands at x = 0, y = 0, the node of the lower left corner; above it nothing does."""
    with opened(browser, tmp_path, stories.small()) as watch:
        spot = _place(watch, 0.0, 0.0)
        watch.page.locator("#map-0").hover(position=spot)
        said = watch.page.locator("#read-0").inner_text()
        assert "x = 0 m, y = 0 m: test 0 observed 0.7 rad" in said
        assert "x = 0 m, y = 0 m: mean 0.3 rad, lower 0.2 rad, upper 0.4 rad" in said
        watch.page.locator("#map-0").click(position=spot)
        assert watch.page.locator("#scene").get_attribute("data-test") == "0"


def test_colours_stand_where_their_nodes_are(browser: Browser, tmp_path: Path) -> None:
    """The last axis runs fastest; dark is worse, be it low or high."""
    pixel = """([index, x, y]) => {
        const canvas = document.getElementById(`map-${index}`), at = views.get(canvas);
        const spot = [Math.round(at.px(x)), Math.round(at.py(y)), 1, 1];
        return [...canvas.getContext("2d").getImageData(...spot).data].slice(0, 3);
    }"""
    with opened(browser, tmp_path, stories.small()) as watch:
        for node in (11, 16):  # no test stands there, and the worst start does not either
            place = stories.NODES[node]
            wanted = [watch.page.evaluate("viridis", share) for share in (node / 19, 1 - node / 19)]
            assert [watch.page.evaluate(pixel, [index, *place]) for index in (0, 1)] == wanted
        watch.page.locator("#map-0").hover(position=_place(watch, 4.0, 0.0))
        assert "x = 4 m, y = 0 m: mean 0.62 rad" in watch.page.locator("#read-0").inner_text()


def test_the_worst_is_least_or_greatest(browser: Browser, tmp_path: Path) -> None:
    story = stories.small()
    with opened(browser, tmp_path, story) as watch:
        for index, problem in enumerate(story.problems):
            first = watch.page.locator(f"#problem-{index} [data-test]").first
            assert first.get_attribute("data-test") == f"{problem.name}:{stories.worst(problem)}"


def _place(watch: Watched, x: float, y: float) -> Position:
    """Return where a start stands on the first map, in pixels."""
    call = "([x, y]) => { const at = views.get(document.getElementById('map-0')); return [at.px(x), at.py(y)]; }"
    left, top = watch.page.evaluate(call, [x, y])
    return {"x": left, "y": top}


def test_a_map_is_reached_with_the_keyboard(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, stories.small()) as watch:
        watch.page.focus("#map-1")
        for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "Enter"):
            watch.page.keyboard.press(key)
        scene = watch.page.locator("#scene")
        assert [scene.get_attribute("data-problem"), scene.get_attribute("data-test")] == ["sim_gap", "0"]


def test_the_map_shows_mean_lower_or_upper(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, stories.small()) as watch:
        assert watch.page.locator("#map-0").get_attribute("data-series") == "mean"
        watch.page.click("#problem-0 [data-series=upper]")
        assert watch.page.locator("#map-0").get_attribute("data-series") == "upper"
        assert watch.page.locator("#map-1").get_attribute("data-series") == "mean"
        assert watch.page.locator("#problem-0 [aria-pressed=true]").inner_text() == "upper"


def test_starts_are_sorted_by_their_bound(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, stories.starts()) as watch:
        values = [float(text) for text in watch.page.locator("#bars-0 .value").all_inner_texts()]
        assert len(values) == 20
        assert values == sorted(values)
        assert watch.page.locator("#problem-0 [data-series=upper]").is_disabled()


def test_counterexamples_are_counted_and_linked(browser: Browser, tmp_path: Path) -> None:
    story = stories.small()
    with opened(browser, tmp_path, story) as watch:
        assert "None: of 24 recorded rollouts" in watch.page.locator("#counterexamples").inner_text()
    found = tuple(stories.rollout("sim_gap", 0, "true", k, robustness=-0.1) for k in range(12))
    with opened(browser, tmp_path, replace(story, counterexamples=found, violations=1200)) as watch:
        section = watch.page.locator("#counterexamples")
        assert "1,200 rollouts of 24 violated" in section.inner_text()
        assert section.locator("a").first.get_attribute("href") == "counterexamples.csv"
        assert section.locator("tbody tr").count() == 12
        section.locator("button[data-select]").first.click()
        assert watch.page.locator("#scene").get_attribute("data-problem") == "sim_gap"


def test_hostile_names_lead_nowhere(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, stories.hostile()) as watch:
        links = watch.page.locator("a").evaluate_all("all => all.map(each => each.getAttribute('href'))")
        assert {link for link in links if not link.startswith("#problem-")} == {"counterexamples.csv"}
        assert watch.page.locator("#page script, #page img, #page iframe").count() == 0
        seen = watch.page.locator("#page").inner_text()
        assert "<script>window.pwned=1</script>" in seen
        assert not any(sign in seen for sign in "\u0000\u001b\u202e\u2066")
        for button in watch.page.locator("[data-select]:enabled:visible").all()[:3]:
            button.click()
        watch.page.mouse.move(300, 700)
        assert watch.page.evaluate("window.pwned") is None


def test_paper_is_light_and_unfolded(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, stories.small(), scheme="dark") as watch:
        closed = "document.querySelectorAll('details:not([open])').length"
        before = watch.page.evaluate(closed)
        watch.page.evaluate(f"addEventListener('beforeprint', () => window.seen = [{closed}, theme().paper])")
        assert watch.page.pdf().startswith(b"%PDF")
        assert watch.page.evaluate("window.seen") == [0, "#ffffff"]
        assert watch.page.evaluate(closed) == before > 0
