"""The charts of a problem in a real browser: requirement, clip, captions, importance, prediction, all rollouts."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from perfbound.orchestrator.report.data import page
from perfbound.orchestrator.report.data.charts import FailingStart
from perfbound.orchestrator.report.data.claims import VerdictCard
from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report import example_reports
from tests.end_to_end.report.browser import Scheme
from tests.end_to_end.report.test_page import opened

browser = chromium.browser

PLOT = "charts.get(document.getElementById('bound-0'))"
LEVELS = f"() => {PLOT}.overlay"
RANGE = f"() => {{ const {{ min, max }} = {PLOT}.plot.scales.y; return [min, max]; }}"
AXES = f"""() => {{
    const axes = {PLOT}.plot.axes;
    const places = axes[0]._splits.map((value) => {PLOT}.plot.valToPos(value, "x"));
    const [below, beside] = axes.map((each) => each._values.map(textWidth));
    return [axes[1]._size, beside, axes.map((each) => each._values), places, Math.max(...below)];
}}"""
NAMES = f"() => [gutter({PLOT}.overlay), {PLOT}.overlay.levels.map(({{ label }}) => textWidth(label))]"
BARE = """() => [...document.querySelectorAll("section.problem figure")]
    .filter((each) => each.querySelector("canvas, svg"))
    .filter((each) => !each.closest("figure:has(.caption)"))
    .map((each) => each.innerText)"""
BARS = """(id) => charts.get(document.getElementById(id)).plot.data.slice(1)
    .map((each) => each.map((value) => value ?? 0))"""
RED = """(id) => {
    const canvas = document.getElementById(id);
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const isRed = (k) => [194, 79, 0, 255].every((value, part) => data[k + part] === value);
    return [...Array(data.length / 4).keys()].filter((k) => isRed(4 * k)).length;
}"""
CELLS = """() => {
    const canvas = document.getElementById("map-0"), { nodes, toX, toY, scale, band } = mapModels.get(canvas);
    const context = canvas.getContext("2d");
    return nodes.map((node, n) => {
        const pixel = context.getImageData(toX(node[0]) + 14, toY(node[1]) + 14, 1, 1);
        return [[...pixel.data].slice(0, 3), scale.colour(scale.values[n]), band.worst[n]];
    });
}"""
DOTS = "() => mapModels.get(document.getElementById('map-0')).dots.map(({ rows, radius }) => [rows.length, radius])"
KEPT = """() => {
    const plots = () => [...charts.values()].map(({ plot }) => plot);
    const [before, canvases] = [plots(), [...document.querySelectorAll("canvas")]];
    draw();
    const after = plots();
    return [before.length, before.every((plot, k) => plot === after[k]) && canvases.every((each) => each.isConnected)];
}"""


def stopped_at_once(report: page.ReportData) -> page.ReportData:
    """One test alone."""
    problem = report.problems[0]
    tests = page.TestSeries((0,), problem.tests.x[:1], (0.7,), (None,), (-20.0,), (None,))
    return replace(report, problems=(replace(problem, tests=tests, observed=1),))


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (360, "light")])
def test_every_picture_has_a_caption_and_fits(browser: Browser, tmp_path: Path, width: int, scheme: Scheme) -> None:
    with opened(browser, tmp_path, example_reports.disturbed(), width=width, scheme=scheme) as watch:
        assert watch.overflow() == 0
        assert watch.page.evaluate(BARE) == []
        assert watch.page.locator("section.problem .u-legend").count() == 0


def test_requirement_clip_and_bound_are_lines_of_the_bounds(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        overlay = watch.page.evaluate(LEVELS)
        lines = {each["label"]: each["value"] for each in overlay["levels"]}
        assert lines == {
            "required 0.1": 0.1,
            "clip -0.2": -0.2,
            "clip 0.75": 0.75,
            "violated below 0": 0,
            "bound 0.3727": 0.3727,
        }
        assert overlay["stop"] == {"at": 11, "label": "stopped: alpha reached"}
        caption = watch.page.locator("figure:has(#bound-0) .caption").inner_text()
        assert "The final bound is \u2265 0.3727 rad, and meets the requirement of \u2265 0.1 rad." in caption
        assert "It stopped after 12 tests: stop threshold alpha reached." in caption


def test_the_names_of_lines_do_not_overlap(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        spread = "([wanted, least, top, bottom]) => spread(wanted, least, top, bottom)"
        for wanted in ([50, 51, 50.5, 49], [0, 1, 2], [100, 99, 98, 97], [10, 90], [4, 4, 4, 96, 96]):
            rows = watch.page.evaluate(spread, [wanted, 14, 0, 100])
            ordered = sorted(rows)
            assert all(b - a >= 14 - 1e-9 for a, b in pairwise(ordered))
            assert 0 <= ordered[0] <= ordered[-1] <= 100
            order = sorted(range(len(rows)), key=lambda k: rows[k])
            assert [wanted[k] for k in order] == sorted(wanted)


def long_numbers(report: page.ReportData) -> page.ReportData:
    """Tests up to 1,100,000 with bounds of some millionths, as after a million rollouts."""
    problem = report.problems[0]
    small = tuple(k * 1e-6 for k in range(12))
    tests = replace(problem.tests, test=tuple(100_000 * k for k in range(12)), y=small, lower=small, upper=small)
    charts = replace(problem.charts, required=8.25e-6, clip=(None, None), of_robustness=False, rollouts=None)
    return replace(report, problems=(replace(problem, tests=tests, charts=charts, bound=4.75e-6),))


def test_long_numbers_have_room_and_their_thousands_apart(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, long_numbers(example_reports.charted())) as watch:
        size, widths, texts, places, long = watch.page.evaluate(AXES)
        assert size >= 8 + max(widths), "no number is under the label of its axis"
        assert "0.0000075" in texts[1]
        assert texts[0][-1] == "1,000,000"
        assert all(b - a >= long + 8 for a, b in pairwise(places)), "numbers side by side do not touch"
        room, names = watch.page.evaluate(NAMES)
        assert room >= 9 + max(names), "no name of a line is squeezed"
        assert "test 700,000" in watch.page.locator("div.worst").inner_text()
        shown = watch.page.evaluate("[0, -999.5, 1000, -12345.678, 1234567.8, 1e7, 1e-5].map((value) => num(value))")
        assert shown == ["0", "-999.5", "1,000", "-12,350", "1,235,000", "1.000e+7", "0.00001"]


def test_a_first_bound_far_away_flattens_nothing_and_is_told(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        low, high = watch.page.evaluate(RANGE)
        assert -1.0 < low < -0.2
        assert 0.7 < high < 1.0
        caption = watch.page.locator("figure:has(#bound-0) .caption").inner_text()
        assert "Outside of the picture: the lower bound of test 0, as far as \u221220 rad." in caption


def test_a_single_test_is_drawn(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, stopped_at_once(example_reports.charted())) as watch:
        low, high = watch.page.evaluate(RANGE)
        assert low < 0.1
        assert high > 0.7


def test_the_legend_has_no_placeholders_on_paper(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        watch.page.emulate_media(media="print")
        watch.page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        text = watch.page.locator("#problem-0").inner_text()
        assert "--" not in text
        assert "lower bound of the method on the worst start: what is claimed" in text
        assert "observed value of each test" in text


def test_starts_outside_of_the_prediction_are_red_and_counted(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        figure = watch.page.locator("figure.prediction")
        canvas = figure.locator("canvas")
        assert (canvas.get_attribute("data-starts"), canvas.get_attribute("data-inside")) == ("30", "28")
        assert "28 of 30 are within the predicted bounds." in figure.inner_text()
        assert "a point outside does not refute them by itself" in figure.inner_text()
        assert watch.page.evaluate(RED, "predicted-0") > 10


def test_importance_is_bars_and_curves_the_most_important_first(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        figure = watch.page.locator("figure.importance")
        shares = figure.locator(".shares .value").all_inner_texts()
        assert shares == ["70 %; 80 % with the others", "20 %; 30 % with the others"]
        bars = figure.locator("rect.first")
        widths = bars.evaluate_all("each => each.map((rect) => rect.getBoundingClientRect().width)")
        assert widths[0] == pytest.approx(3.5 * widths[1], rel=0.02)
        assert figure.locator(".effect").count() == 2
        assert "is no part of the claim" in figure.inner_text()


def test_rollouts_of_each_variant_have_a_histogram(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        assert watch.page.evaluate(BARS, "rollouts-0-true") == [[1, 2, 0, 0], [0, 0, 5, 4]]
        assert watch.page.evaluate(BARS, "rollouts-0-nominal") == [[0, 0, 0, 0], [0, 0, 3, 9]]
        text = watch.page.locator("figure:has(#rollouts-0-true)").inner_text()
        assert "3 of them violate the specification, and the worst is \u22120.31 rad or lower" in text
        assert "which the clip hides, of test 7" in text
        assert "none of them violates the specification" in text


def test_the_region_is_a_line_and_changes_no_colour(browser: Browser, tmp_path: Path) -> None:
    """A cell has one colour inside of the region as outside, but for its edge."""
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        found = watch.page.evaluate(CELLS)
        assert {possible for _, _, possible in found} == {True, False}
        for shown, meant, _ in found:
            assert shown == pytest.approx(meant, abs=1)
        legend = watch.page.locator("figure:has(#map-0) .legend").inner_text()
        assert "the worst start may be on the side of the ticks" in legend


def test_sizes_of_dots_are_in_the_legend(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.charted()
    problem = report.problems[0]
    x = (problem.tests.x[0],) * 8 + (problem.tests.x[1],) * 3 + (problem.tests.x[2],)
    repeated = replace(report, problems=(replace(problem, tests=replace(problem.tests, x=x)),))
    with opened(browser, tmp_path, repeated) as watch:
        legend = watch.page.locator("figure:has(#map-0) .legend").inner_text()
        assert all(entry in legend for entry in ("1 test at a start", "5 tests", "8 tests"))
        radii = dict(watch.page.evaluate(DOTS))
        circles = watch.page.locator("figure:has(#map-0) .mark.size circle")
        shown = circles.evaluate_all("each => each.map((one) => Number(one.getAttribute('r')))")
        assert shown[0] == pytest.approx(radii[1])
        assert shown[-1] == pytest.approx(radii[8])


def test_a_mean_beyond_the_clip_is_told(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        text = watch.page.locator("figure:has(#map-0) .caption").inner_text()
        assert "At 25 % of the starts the model goes beyond the clip" in text
        assert "All colours are above the required 0.1 rad." in text


def test_drawing_again_builds_no_chart_anew(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.charted()
    many = example_reports.small(1000).problems[0]
    large = replace(report, problems=(replace(many, charts=report.problems[0].charts),))
    with opened(browser, tmp_path, large) as watch:
        number, kept = watch.page.evaluate(KEPT)
        assert number >= 4
        assert kept


def refuted(report: page.ReportData) -> page.ReportData:
    """The same with a refuted bound: the worst of two failing fresh starts is worse than every test."""
    problem = report.problems[0]
    failing = (
        FailingStart((2.5, 1.5), "spot_check", 7, -0.9, 16, 16, contradicts=True),
        FailingStart((1.0, 2.0), "spot_check", 3, -0.1, 1, 1, contradicts=False),
    )
    charts = replace(problem.charts, failing=failing)
    return replace(
        report,
        problems=(replace(problem, charts=charts, refuted=True),),
        violations=17,
        later_violations=17,
        rollouts=480,
        closing_rollouts={"spot_check": 314, "recheck": 20},
    )


CROSS = """([x, y]) => {
    const canvas = document.getElementById("map-0"), { toX, toY } = mapModels.get(canvas);
    return [...canvas.getContext("2d").getImageData(toX(x), toY(y), 1, 1).data].slice(0, 3);
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pictures_and_captions_of_a_refuted_bound_say_so(browser: Browser, tmp_path: Path, scheme: Scheme) -> None:
    with opened(browser, tmp_path, refuted(example_reports.charted()), scheme=scheme) as watch:
        section = watch.page.locator("section.problem").first
        facts = section.locator("dl.facts").inner_text()
        assert "REFUTED" in facts
        assert "none: an assumption is refuted" in facts
        text = section.inner_text()
        assert "and REFUTED by the data: do not rely on it." in text
        assert "meets the requirement" not in text
        assert "but these are numbers of a refuted model" in text
        assert (
            "at 2 fresh starts of the spot check rollouts violate the specification, and at 1 fresh start the" in text
        )
        assert any(each["label"].startswith("refuted ") for each in watch.page.evaluate(LEVELS)["levels"])
        for start in ([2.5, 1.5], [1.0, 2.0]):
            assert watch.page.evaluate(CROSS, start) == [213, 94, 0]
        worst = section.locator(".worst li").first
        assert "-0.9" in worst.inner_text()
        assert "16 of 16 rollouts below 0" in worst.inner_text()
        assert worst.locator("button").get_attribute("data-select") == "spot_check:7"
        counted = watch.page.locator("#counterexamples p").first.inner_text()
        assert counted.startswith("17 rollouts of 794 violated the specification")
        assert "0 of the 480 for the bounds, and 17 after the campaign" in counted


def test_a_bound_beyond_the_requirement_does_not_hide_a_violation(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.charted()
    card = VerdictCard("VIOLATED", "", "Margin.", ("A start fails.",), (), "", "probable", (), "", "")
    with opened(browser, tmp_path, replace(report, verdict=card)) as watch:
        text = watch.page.locator("section.problem").first.inner_text()
        assert "but the verdict is VIOLATED" in text
        assert "meets the requirement" not in text


def test_disturbances_have_shares_curves_and_the_failing_rollouts(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.disturbed()) as watch:
        shares = watch.page.locator("figure.sensitivity .shares").inner_text().split("\n")
        assert [each.strip() for each in shares if each.strip()] == [
            "gust",
            "95 %, sd 0.103 rad",
            "fault",
            "2.6 %, sd 0.017 rad",
        ]
        curve = watch.page.locator("figure.sensitivity .effect svg").first.get_attribute("aria-label")
        assert curve == "part of the control against gust (m/s): from 0.02 to -0.32 rad"
        caption = watch.page.locator("figure.sensitivity .caption").inner_text()
        assert "Together it is 97.6 % of the variance; a standard deviation of 0.0192 rad is left." in caption
        canvas = watch.page.locator("#disturbed-0")
        assert (canvas.get_attribute("data-rollouts"), canvas.get_attribute("data-marked")) == ("40", "2")
        assert watch.page.evaluate(RED, "disturbed-0") > 0
        caption = watch.page.locator("figure.disturbed .caption").inner_text()
        assert "by its gust and fault, the two disturbances that matter most" in caption
        assert "rollouts that violate the specification, as 2 of 100,000 do." in caption
        assert "The picture has 40 of them: the worst ones, and an even choice of the others." in caption
        sentence = watch.page.locator("figure.disturbed > p").first.inner_text()
        assert sentence == (
            "Worst rollout nominal_robustness.0.true.1, robustness -0.04 rad: gust = 9.5 m/s (2.9 sd), fault = 1 "
            "(probability 0.125)."
        )
        watch.page.locator("figure.disturbed button").click()
        assert watch.page.locator("#test").get_attribute("data-test") == "0"
        heads = watch.page.locator("#test table.rollouts").first.locator("th").all_inner_texts()
        assert heads[2:5] == ["Robustness (rad)", "Disturbances", "Seed"]
        assert "gust = 9.5 m/s (2.9 sd)" in watch.page.locator("#test table.rollouts").first.inner_text()


def test_without_a_control_shares_are_of_rollouts(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.disturbed(control=False)
    charts = report.problems[0].charts
    found = charts.disturbances
    assert found is not None
    assert found.scatter is not None
    calm = replace(found.scatter, axes=(0,), at=found.scatter.at[:1], violations=0)
    problem = replace(report.problems[0], charts=replace(charts, disturbances=replace(found, scatter=calm)))
    with opened(browser, tmp_path, replace(report, problems=(problem,))) as watch:
        figure = watch.page.locator("figure.sensitivity")
        assert "sd" not in figure.locator(".shares").inner_text()
        assert "up to 1 % may be chance" in figure.locator(".legend").inner_text()
        assert "of 4,096 rollouts that a disturbance explains by itself" in figure.locator(".caption").inner_text()
        caption = watch.page.locator("figure.disturbed .caption").inner_text()
        assert "by its gust and its robustness" in caption
        assert "the 2 worst of 100,000 rollouts, none of which violates the specification" in caption


def test_a_system_without_disturbances_has_no_picture_of_them(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.charted()) as watch:
        assert watch.page.locator("figure.sensitivity, figure.disturbed").count() == 0
        assert "Disturbances" not in watch.page.locator("#test table.rollouts").first.inner_text()
