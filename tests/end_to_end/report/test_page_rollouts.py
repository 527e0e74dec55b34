"""Rollouts and counterexamples in a real browser: identities, zoom, further columns, groups, paper."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser

from perfbound.orchestrator.report.data.page import ReportData
from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report import example_reports
from tests.end_to_end.report.browser import Watched
from tests.end_to_end.report.pdf_text import pages_of
from tests.end_to_end.report.test_page import WORST, opened

browser = chromium.browser

NAME = f"nominal_robustness.{WORST}.true.1"
"""The worst rollout of the test that is shown."""
RANGES = "[...curvePlots.values()].map(({ plot }) => [plot.scales.x.min, plot.scales.x.max])"


@contextmanager
def shown(browser: Browser, folder: Path, report: ReportData | None = None, **options: Any) -> Iterator[Watched]:
    with opened(browser, folder, report or example_reports.calm(), **options) as watch:
        yield watch


def ranges(watch: Watched) -> list[list[float]]:
    found: list[list[float]] = watch.page.evaluate(RANGES)
    return found


# Which test


def test_the_worst_rollout_is_shown_first_and_says_so(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path, example_reports.violating()) as watch:
        section = watch.page.locator("#test")
        assert section.get_attribute("data-test") == "0"
        assert "the worst of 845 true rollouts: robustness -3 rad" in section.locator(".why").inner_text()
        assert section.locator(".ranked button[aria-pressed=true]").all_inner_texts() == ["worst rollout"]
        watch.page.click(".ranked button:has-text('best')")
        assert [section.get_attribute(f"data-{name}") for name in ("problem", "test")] == ["sim_gap", "0"]
        watch.page.click(".ranked button:has-text('first violation')")
        assert "Test 5 of spot check" in section.locator("h2").inner_text()
        assert "the first violation among 845 true rollouts" in section.locator(".why").inner_text()


def test_the_worst_rollout_is_drawn_beside_the_claim_whatever_is_chosen(browser: Browser, tmp_path: Path) -> None:
    """Its column with the limit; and the way to all of its columns."""
    drawn = """() => {
        const { plot, overlay } = charts.get(document.getElementById("worst-curve"));
        return [plot.series[1].label, Math.min(...plot.data[1]), overlay.levels.map(({ label }) => label)];
    }"""
    with shown(browser, tmp_path) as watch:
        first = watch.page.evaluate(drawn)
        assert first[2], "with its limit"
        watch.page.click('[data-select="sim_gap:0"]')
        assert watch.page.evaluate(drawn) == first
        watch.page.click(f".worst-picture button:has-text('Show test {WORST}')")
        assert watch.page.locator("#test").get_attribute("data-test") == str(WORST)


def test_without_a_robustness_the_observed_values_rank_the_tests(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path) as watch:
        assert watch.page.locator("#test").get_attribute("data-test") == str(WORST)
        assert "the worst observed value of 6 tests" in watch.page.locator("#test .why").inner_text()
        assert watch.page.locator(".ranked button").all_inner_texts() == [
            "worst rollout",
            "median rollout",
            "best rollout",
        ]


def test_a_counterexample_comes_before_the_worst(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.ended_by_counterexample(example_reports.violating(), 3)
    with shown(browser, tmp_path, report) as watch:
        assert watch.page.locator("#test").get_attribute("data-test") == "3"
        assert "which ended the campaign" in watch.page.locator("#test .why").inner_text()


# Rollouts told apart


def test_each_rollout_has_an_identity_of_its_own(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path) as watch:
        keys = watch.page.locator("[data-curve]")
        assert keys.all_inner_texts() == [
            "nominal, replicate 0: 0.65",
            "true, replicate 0: 0.6",
            "true, replicate 1: 0.55 (the worst)",
        ]
        found = watch.page.evaluate(
            "drawnRollouts(page.report.scenes[0]).map(({ colour, dash, width }) => [colour, dash.length, width])"
        )
        assert found == [["ink", 2, 2], ["c1", 0, 1.5], ["c0", 0, 3]], "one nominal rollout for all replicates"


def test_a_nominal_rollout_has_the_colour_of_its_true_one(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path) as watch:
        found = watch.page.evaluate(
            """() => {
                const scene = structuredClone(page.report.scenes[0]);
                const more = { ...scene.drawn[0], id: "second", replicate: 1 };
                scene.drawn.push(more);
                scene.traces.push({ ...scene.traces[0], rollout: "second" });
                const told = ({ variant, replicate, colour, dash }) => [variant, replicate, colour, dash.length];
                return drawnRollouts(scene).map(told);
            }"""
        )
        assert found == [["nominal", 0, "c1", 2], ["true", 0, "c1", 0], ["true", 1, "c0", 0], ["nominal", 1, "c0", 2]]


@pytest.mark.parametrize("how", ["hover", "focus"])
def test_a_highlighted_rollout_is_named(browser: Browser, tmp_path: Path, how: str) -> None:
    with shown(browser, tmp_path) as watch:
        getattr(watch.page.locator(f'[data-curve="{NAME}"]'), how)()
        text = watch.page.locator("#read-rollout").inner_text()
        assert text == f"{NAME}, seed 7, robustness 0.55, worst moment 1.4 s"
        faded = "[...curvePlots.values()].map(({ plot }) => plot.series.map((each) => each.alpha))"
        assert watch.page.evaluate(faded) == [[1, 0.25, 0.25, 1]] * 2


def test_a_curve_at_the_pointer_is_named_in_all_charts(browser: Browser, tmp_path: Path) -> None:
    at = """([t, k]) => {
        const { plot } = curvePlots.get("curves-0"), box = plot.over.getBoundingClientRect();
        const value = plot.data[k][plot.valToIdx(t)];
        return [box.left + plot.valToPos(t, "x"), box.top + plot.valToPos(value, "y")];
    }"""
    with shown(browser, tmp_path) as watch:
        watch.page.locator("#curves-0").scroll_into_view_if_needed()
        watch.page.mouse.move(*watch.page.evaluate(at, [1.4, 3]))
        assert NAME in watch.page.locator("#read-rollout").inner_text()
        assert f"phi 0.4 rad of {NAME}" in watch.page.locator("#read-curves-0").inner_text()
        assert f"robustness 0.55 rad of {NAME}" in watch.page.locator("#read-curves-margin").inner_text()


def test_a_rollout_is_switched_off_and_on(browser: Browser, tmp_path: Path) -> None:
    seen = "[...curvePlots.values()].map(({ plot }) => plot.series.slice(1).map((each) => each.show))"
    with shown(browser, tmp_path) as watch:
        button = watch.page.locator(f'[data-curve="{NAME}"]')
        button.click()
        assert watch.page.evaluate(seen) == [[True, True, False]] * 2
        assert button.get_attribute("aria-pressed") == "false"
        button.press("Enter")
        assert watch.page.evaluate(seen) == [[True, True, True]] * 2


# The worst moment, and the robustness over time


def test_the_worst_moment_is_a_dot_of_the_rollouts_colour(browser: Browser, tmp_path: Path) -> None:
    pixel = """(id) => {
        const { plot, of } = curvePlots.get(id), worst = of.rollouts.find((each) => each.worst);
        const [value] = valuesAt(of.curve(worst), [worst.moment[0]]);
        const at = [plot.valToPos(worst.moment[0], "x", true), plot.valToPos(value, "y", true)].map(Math.round);
        return [...plot.ctx.getImageData(at[0], at[1] + 3, 1, 1).data].slice(0, 3);
    }"""
    with shown(browser, tmp_path) as watch:
        for chart in ("curves-0", "curves-margin"):
            assert watch.page.evaluate(pixel, chart) == [0xC2, 0x4F, 0x00]


def test_the_robustness_over_time_says_what_it_is(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path) as watch:
        figure = watch.page.locator("figure:has(#curves-margin)").inner_text()
        assert "Robustness over time (rad)" in figure
        assert "Shown is abs(phi) <= 0.95 at each moment. Its least value is the robustness" in figure
        assert "The campaign clips it to -0.05 to 0.75 rad." in figure
        assert watch.page.evaluate("curvePlots.get('curves-margin').plot.scales.y.min") < 0, "the requirement is there"


def test_without_a_moment_nothing_is_marked(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.calm()
    scenes = tuple(
        replace(each, drawn=tuple(replace(one, moment=None, columns=()) for one in each.drawn))
        for each in report.scenes
    )
    with shown(browser, tmp_path, replace(report, scenes=scenes)) as watch:
        figure = watch.page.locator("figure:has(#curves-margin)")
        assert "at separate times, so none is marked" in figure.inner_text()
        assert figure.locator(".mark.moment").count() == 0


# Zoom, and further columns


def test_a_drag_zooms_all_charts_and_a_double_click_ends_it(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path) as watch:
        watch.page.click('[data-column="vx"]')
        assert ranges(watch) == [[0, 2]] * 3
        box = watch.page.locator("#curves-0 .u-over").bounding_box()
        assert box is not None
        watch.page.locator("#curves-0").scroll_into_view_if_needed()
        box = watch.page.locator("#curves-0 .u-over").bounding_box()
        assert box is not None
        y = box["y"] + box["height"] / 2
        watch.page.mouse.move(box["x"] + box["width"] / 4, y)
        watch.page.mouse.down()
        watch.page.mouse.move(box["x"] + box["width"] / 2, y, steps=4)
        watch.page.mouse.up()
        (low, high), *others = ranges(watch)
        assert [low, high] == pytest.approx([0.5, 1.0], abs=0.02)
        assert others == [[low, high]] * 2
        watch.page.mouse.dblclick(box["x"] + box["width"] / 3, y)
        assert ranges(watch) == [[0, 2]] * 3


def test_zoom_has_buttons_for_the_keyboard(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path) as watch:

        def press(name: str) -> list[float]:
            watch.page.get_by_role("button", name=name, exact=True).press("Enter")
            first, *others = ranges(watch)
            assert others == [first]
            return first

        assert press("Zoom in") == pytest.approx([0.9, 1.9]), "about the worst moment"
        assert press("Earlier") == pytest.approx([0.4, 1.4])
        assert press("Later") == pytest.approx([0.9, 1.9])
        assert press("Later") == pytest.approx([1.0, 2.0]), "not beyond the end"
        assert press("Zoom out") == pytest.approx([0.5, 2.0])
        assert press("Whole time") == [0, 2]
        assert watch.page.locator("[data-zoom]:disabled").count() == 4


def test_the_values_in_sight_fill_a_zoomed_chart(browser: Browser, tmp_path: Path) -> None:
    """Also between two samples, where a chart by itself would see none of the curve."""
    with shown(browser, tmp_path) as watch:
        watch.page.evaluate("setRange([0.42, 0.48])")
        low, high, *seen = watch.page.evaluate(
            """() => {
                const { plot, of } = curvePlots.get("curves-margin"), { min, max } = plot.scales.y;
                return [min, max, ...of.rollouts.flatMap((each) => valuesAt(of.curve(each), [0.42, 0.48]))];
            }"""
        )
        assert low < 0 < min(seen)
        assert max(seen) < high < max(seen) + 0.2


def test_a_range_of_time_outlives_no_other_test(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path) as watch:
        watch.page.get_by_role("button", name="Zoom in", exact=True).click()
        watch.page.click('[data-select="sim_gap:0"]')
        assert ranges(watch) == [[0, 2]] * 2


def test_further_columns_are_one_click_away(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path) as watch:
        assert watch.page.locator("#test [data-column]").all_inner_texts() == ["vx", "vy"]
        watch.page.click('[data-column="vy"]')
        captions = watch.page.locator("#test figure:has([id^=curves-]) figcaption").all_inner_texts()
        assert captions == ["phi (rad) against time", "vy (rad) against time", "Robustness over time (rad)"]
        assert watch.page.locator("#curves-1 canvas").count() == 1
        watch.page.click('[data-column="vy"]')
        assert watch.page.locator("#curves-1").count() == 0


def test_a_report_without_room_says_where_the_columns_are(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.calm()
    scenes = tuple(replace(each, further=(), more_columns=3) for each in report.scenes)
    with shown(browser, tmp_path, replace(report, scenes=scenes)) as watch:
        assert (
            "5 further columns of this test: in its files, and on the live page"
            in watch.page.locator("#test .choice").inner_text()
        )


# Counterexamples


def test_counterexamples_are_grouped_by_start_and_counted(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path, example_reports.violating()) as watch:
        section = watch.page.locator("#counterexamples")
        groups = section.locator("details.violating")
        assert [each.split("\n")[0] for each in groups.locator("> summary").all_inner_texts()] == [
            "x 0 m, y 0 to 0.3 m: 4 starts, 80 of 160 rollouts, worst -3 rad",
            "x 1 m, y 0 m: 20 of 40 rollouts, worst -2 rad",
            "x 2 m, y 0 to 0.3 m: 4 starts, 80 of 160 rollouts, worst -1 rad",
        ]
        assert groups.evaluate_all("all => all.map((each) => each.open)") == [True, False, False]
        starts = groups.first.locator("details.start")
        assert starts.evaluate_all("all => all.map((each) => each.open)") == [True, False, False, False]
        assert "x 0 m, y 0 m: 20 of 40, worst -3 rad" in starts.first.inner_text()
        assert "and 5 more, in counterexamples.csv" in starts.first.inner_text(), "15 of 20 are listed"
        assert "perfbound replay runs/small sim_gap.0.true.0" in starts.first.inner_text()
        text = section.inner_text()
        assert "187 rollouts of 459 violated" in text
        assert "The worst 9 of 11 starts, in 3 groups, the worst first." in text
        assert "and 2 further starts, less bad: 7 of 19 rollouts." in text
        assert "differ by at most 10 % of its range in every parameter" in text
        starts.first.locator("button[data-select]").first.click()
        assert watch.page.locator("#test").get_attribute("data-problem") == "sim_gap"


def test_an_open_group_stays_open(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path, example_reports.violating()) as watch:
        watch.page.click("details.violating:nth-of-type(2) > summary")
        watch.page.click('[data-select="sim_gap:0"]')
        opened = watch.page.locator("details.violating").evaluate_all("all => all.map((each) => each.open)")
        assert opened == [True, True, False]


# Paper


HEADING = 16
"""Pixels: headings of sections are larger, and all other text is smaller."""
PRINTED = {
    "counterexamples": lambda: example_reports.violating(groups=3, starts=40, rollouts=25),
    "refuted": example_reports.small,
    "drawn starts": example_reports.many,
}


@pytest.mark.parametrize("name", PRINTED)
@pytest.mark.parametrize("size", ["A4", "Letter"])
def test_each_page_has_its_number_and_ends_with_no_heading(
    browser: Browser, tmp_path: Path, name: str, size: str
) -> None:
    with shown(browser, tmp_path, PRINTED[name]()) as watch:
        found = pages_of(watch.page.pdf(format=size))
    assert 2 <= len(found) <= 12
    for number, (header, *lines, footer) in enumerate(found, 1):
        assert header.text.split() == ["small", "perfbound", "report"]
        assert footer.text == f"run c0ffee page {number} of {len(found)}"
        assert lines, "no page is empty"
        assert lines[-1].size < HEADING, f"page {number} ends with {lines[-1].text!r}"
    sections = [line.text for lines in found for line in lines if line.size >= HEADING]
    assert "Counterexamples" in sections
    assert "Workers" in sections


def test_paper_names_what_it_leaves_out(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path, PRINTED["counterexamples"]()) as watch:
        text = [line.text for lines in pages_of(watch.page.pdf()) for line in lines]
    assert "and 15 starts more, in counterexamples.csv" in text
    assert "and 15 more, in counterexamples.csv" in text, "10 of 25 listed rollouts"
    assert not any("Zoom" in line or "Copy" in line or "Point at" in line for line in text)


def test_paper_has_a_header_and_a_footer(browser: Browser, tmp_path: Path) -> None:
    margins = "[...document.styleSheets[0].cssRules].filter((each) => each instanceof CSSPageRule).at(-1).cssText"
    titles = "addEventListener('beforeprint', () => window.seen = document.title)"
    with shown(browser, tmp_path, replace(example_reports.calm(), name='a "b\\ } c')) as watch:
        text = watch.page.evaluate(margins)
        for place in ("@top-left", "@top-right", "@bottom-left", "@bottom-right"):
            assert place in text, "the name cannot end its string"
        assert "counter(page)" in text
        assert "c0ffee" in text
        before = watch.page.title()
        watch.page.evaluate(titles)
        watch.page.pdf()
        assert watch.page.evaluate("window.seen") == 'a "b\\ } c, run c0ffee: perfbound report'
        assert watch.page.title() == before


@pytest.mark.parametrize("size", ["A4", "Letter"])
def test_long_lists_are_cut_on_paper(browser: Browser, tmp_path: Path, size: str) -> None:
    with shown(browser, tmp_path, example_reports.violating(groups=3, starts=40, rollouts=25)) as watch:
        watch.page.evaluate(
            """addEventListener('beforeprint', () => {
                window.seen = [...document.querySelectorAll('details[data-paper=folded]:not([open])')].length;
            })"""
        )
        short = len(pages_of(watch.page.pdf(format=size)))
        assert watch.page.evaluate("window.seen") > 40, "all starts but the first"
    with shown(browser, tmp_path, example_reports.violating(groups=3, starts=4, rollouts=5)) as watch:
        assert short <= len(pages_of(watch.page.pdf(format=size))) + 2
        watch.page.emulate_media(media="print")
        for control in (".ranked .switch", ".zoom", ".choice", ".copy", "#test h2 .switch", ".hint"):
            assert not watch.page.locator(control).first.is_visible(), control


def test_nothing_changes_its_width_while_pages_are_divided(browser: Browser, tmp_path: Path) -> None:
    """Charts that were drawn again in between would leave an empty page at the end."""
    with shown(browser, tmp_path) as watch:
        watch.page.evaluate("setPrinting(true)")
        before = watch.page.evaluate("document.querySelector('#curves-0 canvas').clientWidth")
        watch.page.emulate_media(media="print")
        assert watch.page.evaluate("document.querySelector('#curves-0').clientWidth") == before
