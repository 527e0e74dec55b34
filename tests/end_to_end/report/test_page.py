"""A report in a real browser, opened from disk."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Position

from perfbound.orchestrator.report import html
from perfbound.orchestrator.report.data.page import ReportData, to_json
from perfbound.schemas.result.certificate import CompositionTerms
from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report import example_reports
from tests.end_to_end.report.browser import Scheme, Watched

browser = chromium.browser

REPORTS = {
    "refuted": example_reports.small,
    "calm": example_reports.calm,
    "starts": example_reports.starts,
    "profile": example_reports.profile,
    "no test yet": example_reports.begun,
    "three parameters": example_reports.cube,
    "drawn starts": example_reports.many,
    "hostile": example_reports.hostile,
}
TYPESET = "\u03c1* \u2265\u00a00.1743 with probability at least 0.8544 (product)"
WORST = example_reports.worst(example_reports.small().problems[0])


@contextmanager
def opened(
    browser: Browser, folder: Path, report: ReportData, *, width: int = 1280, scheme: Scheme = "light"
) -> Iterator[Watched]:
    """Open a report from disk; the page must log no error and request nothing."""
    file = folder / "report.html"
    file.write_text(html.standalone_page(report.name, to_json(report)).html, "utf-8")
    with chromium.watched(browser, width=width, scheme=scheme) as watch:
        watch.page.goto(file.as_uri())
        watch.shown()
        yield watch
        assert watch.errors == []
        assert watch.requests == [file.as_uri()]


@pytest.mark.parametrize("name", REPORTS)
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (360, "light")])
def test_a_report_is_drawn_and_fits(browser: Browser, tmp_path: Path, name: str, width: int, scheme: Scheme) -> None:
    report = REPORTS[name]()
    with opened(browser, tmp_path, report, width=width, scheme=scheme) as watch:
        assert watch.overflow() == 0
        for index, problem in enumerate(report.problems):
            map_ = watch.page.locator(f"#map-{index}")
            assert map_.get_attribute("data-tests") == str(len(problem.tests.test))
            assert map_.get_attribute("data-problem") == problem.name
        assert watch.page.evaluate("window.pwned") is None


def test_a_colour_scheme_is_followed(browser: Browser, tmp_path: Path) -> None:
    paper = "getComputedStyle(document.body).backgroundColor"
    with opened(browser, tmp_path, example_reports.small(), scheme="dark") as watch:
        before, drawn = watch.page.evaluate(paper), watch.drawn()
        watch.page.emulate_media(color_scheme="light")
        watch.page.wait_for_selector(f"html:not([data-drawn='{drawn}'])")
        assert before == "rgb(21, 24, 28)"
        assert watch.page.evaluate(paper) == "rgb(255, 255, 255)"


def test_refuted_assumptions_come_before_the_claim(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.small()
    with opened(browser, tmp_path, report) as watch:
        text = watch.page.locator("#verdict").inner_text()
        assert text.index("REFUTED: 1 assumption. Do not rely on the claim below.") < text.index(TYPESET)
        assert report.assumptions[0].detail in text
        assert watch.page.locator("#assumptions summary").all_inner_texts()[0].startswith("1 refuted")
    with opened(browser, tmp_path, example_reports.calm()) as watch:
        assert watch.page.locator("#refuted").count() == 0
        assert watch.page.locator("#claim").inner_text() == TYPESET


def test_bounds_are_rounded_to_the_safe_side(browser: Browser, tmp_path: Path) -> None:
    """0.17439 is shown as 0.1743 where it bounds from below, as 0.1744 where it bounds from above."""
    with opened(browser, tmp_path, example_reports.small()) as watch:
        low, high = (watch.page.locator(f"#problem-{index} .facts").inner_text() for index in (0, 1))
        assert "\u2265\u00a00.1743 rad" in low
        assert "\u2265\u00a00.9243" in low
        assert "\u2264\u00a00.1744 rad" in high


def test_bounds_in_legends_are_rounded_to_the_safe_side(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.small()
    tests = replace(report.problems[0].tests, upper=(0.70861,) * 6)
    bounded = replace(report, problems=(replace(report.problems[0], tests=tests),))
    with opened(browser, tmp_path, bounded) as watch:
        watch.page.locator("#bound-0").hover()
        assert "upper bound 0.7087 rad" in watch.page.locator("#read-bound-0").inner_text()


def test_a_gap_term_below_zero_raises_the_bound(browser: Browser, tmp_path: Path) -> None:
    composition = CompositionTerms(
        rule="pointwise",
        nominal_bound=-1.580693,
        gap_bound=2.0,
        lipschitz=1.0,
        gap_term=-1.530693,
        risk_term=0.00792156,
        bound=-0.05792156,
    )
    with opened(browser, tmp_path, replace(example_reports.small(), composition=composition)) as watch:
        values = watch.page.locator("#composition .value").all_inner_texts()
        assert values == ["\u22121.5807", "+1.5306", "\u22120.0080", "\u22120.0580"]


def test_clicking_the_worst_test_shows_its_trajectory(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.small()) as watch:
        section = watch.page.locator("#test")
        assert section.get_attribute("data-test") == str(WORST)
        watch.page.click('[data-test="sim_gap:0"]')
        assert section.get_attribute("data-problem") == "sim_gap"
        assert section.get_attribute("data-test") == "0"
        assert section.get_attribute("data-curves") == "3"
        assert watch.page.locator("#curves-0 canvas").count() == 1
        assert watch.page.locator("#test tbody tr").count() == 3
        assert "perfbound replay runs/small sim_gap.0.true.1" in section.inner_text()
        links = watch.page.locator("#test tbody a").evaluate_all("all => all.map(each => each.getAttribute('href'))")
        assert links[0] == "trajectories/sim_gap/0/sim_gap.0.nominal.0.mcap"
        watch.page.click(f'[data-test="nominal_robustness:{WORST}"]')
        assert section.get_attribute("data-test") == str(WORST)


def test_a_test_without_curves_names_its_files(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.small()) as watch:
        watch.page.click('[data-test="sim_gap:1"]')
        assert "has no curves of this test" in watch.page.locator("#test").inner_text()
        assert watch.page.locator("#test").get_attribute("data-curves") == "0"


def test_a_dot_of_the_map_shows_its_test(browser: Browser, tmp_path: Path) -> None:
    """Test 0 is at x = 0, y = 0, the node of the lower left corner."""
    with opened(browser, tmp_path, example_reports.small()) as watch:
        spot = _place(watch, 0.0, 0.0)
        watch.page.locator("#map-0").hover(position=spot)
        text = watch.page.locator("#read-0").inner_text()
        assert "test 0 observed 0.7 rad at x = 0 m, y = 0 m" in text
        assert "x = 0 m, y = 0 m: mean 0.3 rad, lower bound 0.2000 rad, upper bound 0.4000 rad" in text
        watch.page.locator("#map-0").click(position=spot)
        assert watch.page.locator("#test").get_attribute("data-test") == "0"


def test_colours_are_drawn_at_their_nodes(browser: Browser, tmp_path: Path) -> None:
    """The last axis runs fastest; dark is worse, be it low or high."""
    pixel = """([index, x, y]) => {
        const canvas = document.getElementById(`map-${index}`), at = mapModels.get(canvas);
        const spot = [Math.round(at.toX(x)), Math.round(at.toY(y)), 1, 1];
        return [...canvas.getContext("2d").getImageData(...spot).data].slice(0, 3);
    }"""
    with opened(browser, tmp_path, example_reports.small()) as watch:
        for node in (11, 16):  # no test is there, and no hatching
            place = example_reports.NODES[node]
            wanted = [watch.page.evaluate("viridis", share) for share in (node / 19, 1 - node / 19)]
            assert [watch.page.evaluate(pixel, [index, *place]) for index in (0, 1)] == wanted
        watch.page.locator("#map-0").hover(position=_place(watch, 4.0, 0.0))
        assert "x = 4 m, y = 0 m: mean 0.62 rad" in watch.page.locator("#read-0").inner_text()


def test_the_worst_is_least_or_greatest(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.small()
    with opened(browser, tmp_path, report) as watch:
        for index, problem in enumerate(report.problems):
            first = watch.page.locator(f"#problem-{index} [data-test]").first
            assert first.get_attribute("data-test") == f"{problem.name}:{example_reports.worst(problem)}"


def _place(watch: Watched, x: float, y: float) -> Position:
    """Return the pixel of a start on the first map."""
    call = "([x, y]) => { const at = mapModels.get(document.getElementById('map-0')); return [at.toX(x), at.toY(y)]; }"
    left, top = watch.page.evaluate(call, [x, y])
    return {"x": left, "y": top}


def test_a_map_is_reached_with_the_keyboard(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.small()) as watch:
        watch.page.focus("#map-1")
        for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "Enter"):
            watch.page.keyboard.press(key)
        section = watch.page.locator("#test")
        assert [section.get_attribute("data-problem"), section.get_attribute("data-test")] == ["sim_gap", "0"]


def test_the_map_shows_mean_lower_or_upper(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.small()) as watch:
        assert watch.page.locator("#map-0").get_attribute("data-series") == "mean"
        watch.page.click("#problem-0 [data-series=upper]")
        assert watch.page.locator("#map-0").get_attribute("data-series") == "upper"
        assert watch.page.locator("#map-1").get_attribute("data-series") == "mean"
        assert watch.page.locator("#problem-0 [aria-pressed=true]").inner_text() == "upper bound"


def test_starts_are_sorted_by_their_bound(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.starts()) as watch:
        values = [float(text) for text in watch.page.locator("#bars-0 .value").all_inner_texts()]
        assert len(values) == 20
        assert values == sorted(values)
        assert watch.page.locator("#problem-0 [data-series=upper]").is_disabled()


def test_counterexamples_are_counted_and_linked(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.small()
    with opened(browser, tmp_path, report) as watch:
        assert "None among 24 recorded rollouts" in watch.page.locator("#counterexamples").inner_text()
    found = tuple(example_reports.rollout("sim_gap", 0, "true", k, robustness=-0.1) for k in range(12))
    with opened(browser, tmp_path, replace(report, counterexamples=found, violations=1200)) as watch:
        section = watch.page.locator("#counterexamples")
        assert "1,200 rollouts of 24 violated" in section.inner_text()
        assert section.locator("a").first.get_attribute("href") == "counterexamples.csv"
        assert section.locator("tbody tr").count() == 12
        section.locator("button[data-select]").first.click()
        assert watch.page.locator("#test").get_attribute("data-problem") == "sim_gap"


def test_hostile_names_become_no_links(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.hostile()) as watch:
        links = watch.page.locator("a").evaluate_all("all => all.map(each => each.getAttribute('href'))")
        assert {link for link in links if not link.startswith("#")} == {
            "certificate.json",
            "counterexamples.csv",
        }
        assert watch.page.locator("#page script, #page img, #page iframe").count() == 0
        seen = watch.page.locator("#page").inner_text()
        assert "<script>window.pwned=1</script>" in seen
        assert not any(sign in seen for sign in "\u0000\u001b\u202e\u2066")
        for button in watch.page.locator("[data-select]:enabled:visible").all()[:3]:
            button.click()
        watch.page.mouse.move(300, 700)
        assert watch.page.evaluate("window.pwned") is None


def test_paper_is_light_and_unfolded(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.small(), scheme="dark") as watch:
        closed = "document.querySelectorAll('details:not([open])').length"
        before = watch.page.evaluate(closed)
        watch.page.evaluate(f"addEventListener('beforeprint', () => window.seen = [{closed}, theme().paper])")
        assert watch.page.pdf().startswith(b"%PDF")
        assert watch.page.evaluate("window.seen") == [0, "#ffffff"]
        assert watch.page.evaluate(closed) == before > 0
