"""The pictures of the starts and of the worst test in a real browser: any number of parameters, any two of them."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser

from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report import example_reports
from tests.end_to_end.report.browser import Watched
from tests.end_to_end.report.test_page import opened

browser = chromium.browser

LINE = "(test) => mapModels.get(document.getElementById('parallel-0')).dots.find((dot) => dot.rows[0] === test)?.path"


def choose(watch: Watched, place: int, axis: int) -> None:
    watch.page.select_option(f"#problem-0 select[data-axis='{place}']", str(axis))


def chosen(watch: Watched) -> str | None:
    """Return the axes of the map; the two boxes show the same."""
    boxes = watch.page.locator("#problem-0 select").evaluate_all("all => all.map(each => each.value).join()")
    assert boxes == watch.page.locator("#map-0").get_attribute("data-axes")
    return str(boxes)


def test_every_two_parameters_have_their_plane(browser: Browser, tmp_path: Path) -> None:
    """The mean at a node is its digits; the plane goes through x = 2, y = 1, z = 0."""
    value = """() => {
        const { nodes, scale } = mapModels.get(document.getElementById("map-0"));
        return nodes.map((node, n) => [node, scale.values[n]]);
    }"""
    pixel = """([x, y]) => {
        const canvas = document.getElementById("map-0"), { toX, toY } = mapModels.get(canvas);
        return [...canvas.getContext("2d").getImageData(toX(x) + 12, toY(y) + 12, 1, 1).data].slice(0, 3);
    }"""
    with opened(browser, tmp_path, example_reports.cube()) as watch:
        for first, second in itertools.permutations(range(3), 2):
            choose(watch, 0, first)
            choose(watch, 1, second)
            assert chosen(watch) == f"{first},{second}"
            found = watch.page.evaluate(value)
            means = sorted(mean for _, mean in found)
            for (x, y, z), mean in found:
                assert mean == 100 * x + 10 * y + z
                # Twelve pixels beside it: the hatching and the tests are elsewhere.
                start = (x, y, z)
                share = (mean - means[0]) / (means[-1] - means[0])
                wanted = watch.page.evaluate("viridis", share)
                assert watch.page.evaluate(pixel, [start[first], start[second]]) == wanted
            (third,) = {0, 1, 2} - {first, second}
            assert f"observed: {'xyz'[third]} = {(2, 1, 0)[third]} m" in watch.page.locator("#problem-0").inner_text()


def test_the_axes_of_a_map_are_never_the_same(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.cube()) as watch:
        assert chosen(watch) == "0,1"
        choose(watch, 0, 1)
        assert chosen(watch) == "1,0"
        choose(watch, 1, 1)
        assert chosen(watch) == "0,1"
        names = watch.page.locator("#problem-0 select").evaluate_all("all => all.map(each => each.ariaLabel)")
        assert names == ["Horizontal axis", "Vertical axis"]


def test_tests_beside_the_plane_are_faint(browser: Browser, tmp_path: Path) -> None:
    """Tests 0 and 2 differ in z alone: one dot of the plane x and y, whose tests are told apart by z."""
    beside = "() => mapModels.get(document.getElementById('map-0')).dots.map((dot) => [dot.rows.join(), dot.off])"
    with opened(browser, tmp_path, example_reports.cube()) as watch:
        found = dict(watch.page.evaluate(beside))
        assert {rows: off for rows, off in found.items() if "0" in rows.split(",")} == {
            next(rows for rows in found if set(rows.split(",")) == {"0", "2"}): False
        }
        assert [found[rows] for rows in ("1", "3", "4", "5")] == [True, False, False, True]


def test_a_line_is_pointed_at_and_selected(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.cube()) as watch:
        canvas, section = watch.page.locator("#parallel-0"), watch.page.locator("#test")
        assert canvas.get_attribute("data-lines") == "6"
        (x0, y0), (x1, y1), _ = watch.page.evaluate(LINE, 4)
        spot: Any = {"x": x0 + (x1 - x0) / 4, "y": y0 + (y1 - y0) / 4}
        canvas.hover(position=spot)
        text = watch.page.locator("#read-parallel-0").inner_text()
        assert text.startswith("test 4 observed ")
        assert text.endswith("at x = 0 m, y = 3 m, z = 0 m")
        pointed = "mapModels.get(document.getElementById('map-0')).dots.find((dot) => dot.pointed).rows[0]"
        assert watch.page.evaluate(pointed) == 4, "the map marks the same test"
        canvas.click(position=spot)
        assert section.get_attribute("data-test") == "4"


def test_lines_are_reached_with_the_keyboard_the_worst_first(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.cube()
    y = report.problems[0].tests.y
    second = sorted(range(len(y)), key=lambda test: (y[test] or 0.0, test))[1]
    with opened(browser, tmp_path, report) as watch:
        watch.page.focus("#parallel-0")
        for key in ("ArrowRight", "ArrowRight", "Enter"):
            watch.page.keyboard.press(key)
        assert watch.page.locator("#test").get_attribute("data-test") == str(second)


@pytest.mark.parametrize("width", [1280, 700, 360])
@pytest.mark.parametrize("parameters", [3, 4, 6, 12, 100])
def test_long_names_fit_and_differ(browser: Browser, tmp_path: Path, width: int, parameters: int) -> None:
    names = """() => {
        const { axes, names } = mapModels.get(document.getElementById("parallel-0"));
        return axes.map((axis) => [fitted(axis, names), measured(fitted(axis, names)) <= names]);
    }"""
    with opened(browser, tmp_path, example_reports.many(parameters), width=width) as watch:
        assert watch.overflow() == 0
        found = watch.page.evaluate(names)
        assert len({text for text, _ in found}) == parameters
        assert all(fits for _, fits in found)


def test_of_many_tests_some_lines_are_drawn_and_the_page_says_so(browser: Browser, tmp_path: Path) -> None:
    tests = 3000
    report = example_reports.many(3, tests)
    rows = "mapModels.get(document.getElementById('parallel-0')).dots.map((dot) => dot.rows[0])"
    with opened(browser, tmp_path, report) as watch:
        found, y = watch.page.evaluate(rows), report.problems[0].tests.y
        assert len(set(found)) == 1000
        order = sorted(range(tests), key=lambda test: y[test] or 0.0)
        assert found[:500] == order[:500]
        assert set(found) & set(order[-10:]), "also of the best ones"
        assert "1,000 of 3,000 starts are drawn: the worst 500" in watch.page.locator("#problem-0").inner_text()
        assert watch.page.evaluate("mapModels.get(document.getElementById('map-0')).dots.length") == tests


def test_the_knots_of_a_long_input_are_read_as_one(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.many(200)
    axes = tuple(replace(axis, signal="push" if k >= 5 else "") for k, axis in enumerate(report.axes))
    with opened(browser, tmp_path, replace(report, axes=axes)) as watch:
        text = watch.page.locator("body").inner_text()
        assert "push over time (195 parameters)" in text
        assert "parameter_of_a_long_name_0100" not in text
        assert watch.page.locator("#problem-0 select[data-axis='0'] option").count() == 5
        lines = watch.page.evaluate(
            "mapModels.get(document.getElementById('parallel-0')).dots.map((d) => d.path.length)"
        )
        assert set(lines) == {5}


def test_drawn_starts_have_the_colours_of_their_robustness(browser: Browser, tmp_path: Path) -> None:
    """Half of the tests have either half of the colours; the least robustness is the strongest."""
    colours = """(name) => {
        const { dots } = mapModels.get(document.getElementById(name));
        return Object.fromEntries(dots.map((dot) => [dot.rows[0], dot.colour]));
    }"""
    report = example_reports.many(4)
    order = sorted(range(30), key=lambda test: report.problems[0].tests.y[test] or 0.0)
    with opened(browser, tmp_path, report) as watch:
        for name in ("map-0", "parallel-0"):
            found = watch.page.evaluate(colours, name)
            strong, middle, weak = (found[str(order[k])] for k in (0, 15, -1))
            assert strong == watch.page.evaluate("mixed(theme().strong, theme().strong, 0)")
            assert middle == watch.page.evaluate("mixed(theme().strong, theme().weak, 0.5)")
            assert weak == watch.page.evaluate("mixed(theme().weak, theme().weak, 0)")
        legend = watch.page.locator("#problem-0 .legend", has_text="observed: ").first.inner_text()
        assert "observed: -1.067 (worst), 0.9333 (middle), 1.433 m (best)" in legend


def test_the_inputs_of_the_worst_test_are_drawn_with_their_knots(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, tmp_path, example_reports.small()) as watch:
        figure = watch.page.locator("#test figure").first
        assert "Input push (N) against time" in figure.inner_text()
        assert "2 knots, each held until the next one" in figure.inner_text()
        data = watch.page.evaluate("charts.get(document.getElementById('inputs-0')).plot.data.map((each) => [...each])")
        assert data == [[0, 0.9999, 1, 2], [0.5, 0.5, -1, -1], [0.5, None, -1, None]]
        low, high = watch.page.evaluate(
            "(({ min, max }) => [min, max])(charts.get(document.getElementById('inputs-0')).plot.scales.y)"
        )
        assert low < -2.0 < 2.0 < high


def test_the_counterexample_comes_first(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.ended_by_counterexample(example_reports.calm(), test=0)
    report = replace(report, closing_rollouts={"shrink": 1, "recheck": 2})
    with opened(browser, tmp_path, report) as watch:
        text = watch.page.locator("#verdict").inner_text()
        assert text.index("Test 0 violates the specification.") < text.index("with probability at least")
        assert report.counterexamples[0].command in text
        section = watch.page.locator("#test")
        assert section.get_attribute("data-test") == "0", "selected at first, although another test is worse"
        watch.page.click('[data-test="sim_gap:0"]')
        watch.page.click("#counterexample [data-select]")
        assert [section.get_attribute(f"data-{name}") for name in ("problem", "test")] == ["nominal_robustness", "0"]
        table = watch.page.locator("#counterexamples")
        assert (
            "2 rollouts of 25 violated the specification (robustness below 0): 1 of the 24 for the bounds, and 1 after"
            in table.inner_text()
        )
        assert table.locator("button[data-select]").count() == 2, "also of a check after the campaign"
