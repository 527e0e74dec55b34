"""The report of a campaign: one page under a strict policy, the counterexamples, and figures."""

import base64
import csv
import hashlib
import html
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from perfbound.orchestrator.cli import report
from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.report import html as document
from perfbound.orchestrator.report import write
from perfbound.orchestrator.report.data.page import Axis, ReportData, Surface, to_json
from perfbound.orchestrator.report.data.rollouts import Rollout
from perfbound.orchestrator.report.figures import figures
from perfbound.orchestrator.report.rollout import nominal
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.result.facts import Header
from perfbound.schemas.system import SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.workers.systems import load_system
from tests.end_to_end.report import example_reports
from tests.fakes.finished import a_list, a_pair, contents, finish, insert, play

HOSTILE = (
    "</script ><!--<script></script><script>alert(1)</script>{{STORY}}{{CSP}}/*PAGE*/ $x$ \\frac \x00\x1b\u2028"
    + "x" * 10_000
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, no_disk: None) -> Path:
    """Return a finished campaign."""
    directory = tmp_path_factory.mktemp("pair")
    finish(play(directory, a_pair("paper")), directory)
    return directory


@pytest.fixture
def story(finished: Path) -> ReportData:
    return write.collected(finished)


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have none drawn; that takes a second."""
    monkeypatch.setattr("perfbound.orchestrator.report.figures.figures", lambda _: iter(()))


class Parsed(HTMLParser):
    """The inline parts of a page as a browser parses them."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.parts: list[tuple[str, dict[str, str | None], str]] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = text
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag in {"script", "style", "title"}:
            self.parts.append((tag, dict(attrs), ""))

    def handle_data(self, data: str) -> None:
        if self.parts and self.tags[-1] == self.parts[-1][:2]:
            tag, attributes, text = self.parts[-1]
            self.parts[-1] = (tag, attributes, text + data)

    def handle_endtag(self, tag: str) -> None:
        self.tags.append(("/" + tag, {}))

    def inline(self, tag: str) -> list[str]:
        return [text for name, attributes, text in self.parts if name == tag and not attributes]

    @property
    def story(self) -> Any:
        text = re.split(r"</script[\s/>]", self.text.partition(' id="story">')[2])[0]  # html.parser wants the > at once
        assert "<!--" not in text
        return json.loads(text)

    @property
    def policy(self) -> dict[str, list[str]]:
        (meta,) = (attributes for tag, attributes in self.tags if tag == "meta" and "http-equiv" in attributes)
        assert meta["http-equiv"] == "Content-Security-Policy"
        words = [directive.split() for directive in (meta["content"] or "").split(";")]
        return {name: allowed for name, *allowed in words}


def hashes(texts: list[str]) -> list[str]:
    digests = [hashlib.sha256(text.encode()).digest() for text in texts]
    return [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]


# The page


@pytest.mark.parametrize("make", [document.standalone_page, document.served_page])
def test_nothing_runs_but_what_the_policy_names(story: ReportData, make: Any) -> None:
    page = make(story.name, to_json(story))
    parsed, live = Parsed(page.html), make is document.served_page
    assert len(parsed.inline("script")) == 2
    assert len(parsed.inline("style")) == 1
    assert parsed.policy == {
        "default-src": ["'none'"],
        "script-src": hashes(parsed.inline("script")),
        "style-src": hashes(parsed.inline("style")),
        "img-src": ["data:"],
        "base-uri": ["'none'"],
        "form-action": ["'none'"],
    } | ({"connect-src": ["'self'"]} if live else {})
    assert html.escape(page.policy, quote=False) in page.html
    assert ("body", {"data-live": "events"} if live else {}) in parsed.tags


def test_the_page_needs_nothing_from_elsewhere(story: ReportData) -> None:
    parsed = Parsed(document.standalone_page(story.name, to_json(story)).html)
    for tag, attributes in parsed.tags:
        assert tag != "script" or "src" not in attributes
        assert tag != "link" or attributes["href"] == "data:,"
    assert parsed.story == json.loads(to_json(story))


def test_hostile_text_is_text_in_the_page(story: ReportData) -> None:
    worker = replace(story.workers[0], name=HOSTILE, host=HOSTILE)
    hostile = replace(story, name=HOSTILE, doc=HOSTILE, workers=(worker,), now=HOSTILE)
    page, calm = document.standalone_page(HOSTILE, to_json(hostile)), document.standalone_page("", to_json(story))
    parsed = Parsed(page.html)
    assert page.policy == calm.policy
    assert [tag for tag, _ in parsed.tags] == [tag for tag, _ in Parsed(calm.html).tags]
    assert parsed.story["workers"][0]["name"] == HOSTILE
    assert parsed.inline("title") == [HOSTILE.replace("\r", "\n")]
    assert parsed.inline("script") == Parsed(calm.html).inline("script")


# The files


@pytest.mark.rest
def test_a_report_is_the_same_whenever_it_is_written(finished: Path, story: ReportData) -> None:
    def written(told: ReportData) -> dict[Path, bytes]:
        paths = (*write.write_page(finished, told), *write.write_figures(finished, told))
        return {path: path.read_bytes() for path in paths}

    first, again = written(story), written(write.collected(finished))
    assert first == again
    names = [str(path.relative_to(finished)) for path in first]
    kinds = [f"figures/{name}-{kind}" for name in ("nominal_robustness", "sim_gap") for kind in ("map", "decay")]
    assert names == [
        "report.html",
        "counterexamples.csv",
        *(f"{kind}.{end}" for kind in kinds for end in ("svg", "png")),
    ]
    assert len(first[finished / "report.html"]) < 500_000
    assert Parsed(first[finished / "report.html"].decode()).story == json.loads(to_json(write.relocatable(story)))
    for path, data in first.items():
        assert path.suffix != ".svg" or not re.search(rb"\d\d:\d\d:\d\d|dc:date", data)
    assert not list(finished.rglob("*.partial"))


@pytest.mark.usefixtures("no_figures")
def test_all_counterexamples_stand_in_the_table(finished: Path, story: ReportData) -> None:
    _, path, *_ = write.write_page(finished, story)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == story.violations > 0
    found = [float(next(value for name, value in row.items() if name.startswith("robustness"))) for row in rows]
    assert sorted(found) == [rollout.robustness for rollout in story.counterexamples]


@pytest.mark.usefixtures("no_figures")
def test_a_report_leaves_the_evidence_as_it_is(finished: Path, story: ReportData) -> None:
    before = contents(finished)
    write.write_page(finished, story)
    after = contents(finished)
    kept = [name for name in before if name.startswith("trajectories") or name in (DATABASE, "certificate.json")]
    assert [before[name] for name in kept] == [after[name] for name in kept]
    assert {name for name in after if name.startswith(DATABASE)} == {DATABASE}


def drawn(story: ReportData) -> dict[str, bytes]:
    return dict(figures(story))


def test_a_problem_without_tests_has_no_figures(story: ReportData) -> None:
    nothing = tuple(replace(each, surfaces=(), tests=replace(each.tests, distance=())) for each in story.problems)
    assert drawn(replace(story, problems=nothing)) == {}


@pytest.mark.rest
def test_one_parameter_is_drawn_as_a_band(story: ReportData) -> None:
    problem, points = story.problems[0], tuple((float(k),) for k in (2, 0, 1))
    for shape, starts in (((3,), ()), (None, points)):
        band = Surface((0,), (), shape, starts, (1.0, 2.0, 3.0), (0.0, None, 2.0), (None,) * 3, (False, True, False))
        tests = replace(problem.tests, x=tuple((0.5,) for _ in problem.tests.x))
        flat = replace(
            story, axes=(Axis("d", "m", 0.0, 2.0),), problems=(replace(problem, surfaces=(band,), tests=tests),)
        )
        assert list(drawn(flat)) == [
            f"{problem.name}-{kind}" for kind in ("map.svg", "map.png", "decay.svg", "decay.png")
        ]


@pytest.mark.rest
def test_a_strange_unit_is_drawn_as_it_is_written(story: ReportData) -> None:
    strange = tuple(replace(axis, unit=HOSTILE) for axis in story.axes)
    report = drawn(replace(story, axes=strange, problems=story.problems[:1]))
    assert b"\x00" not in report[f"{story.problems[0].name}-map.svg"]


@pytest.mark.rest
def test_listed_starts_are_drawn(tmp_path: Path, no_disk: None) -> None:
    finish(play(tmp_path, a_list()), tmp_path)
    paths = write.write_figures(tmp_path, write.collected(tmp_path))
    assert [path.name for path in paths] == [
        f"true_risk-{kind}" for kind in ("map.svg", "map.png", "decay.svg", "decay.png")
    ]


# Nominal curves


def test_a_nominal_curve_is_simulated_where_true_ones_are_alone(
    tmp_path: Path, no_disk: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    finish(play(tmp_path, a_list()), tmp_path)
    story, asked = write.collected(tmp_path), list[tuple[float, ...]]()

    def simulated(_: Header, rollout: Rollout) -> Trajectory:
        asked.append(rollout.x)
        return Trajectory(("t", "value"), np.array([[0.0, 0.25], [0.1, 0.5]]))

    monkeypatch.setattr(nominal, "_simulated", simulated)
    monkeypatch.setattr(nominal, "system_specs", lambda: {"test-function": load_system("test-function").spec})
    scenes = nominal.with_nominal(tmp_path, story).scenes
    assert [scene.traces[1:] for scene in scenes] == [scene.traces for scene in story.scenes]
    assert {(scene.traces[0].label, scene.traces[0].values) for scene in scenes} == {(nominal.LABEL, (0.25, 0.5))}
    assert sorted(asked) == sorted({scene.rollouts[0].x for scene in scenes}), "every start once"


def test_another_system_than_that_of_the_campaign_is_not_simulated(
    tmp_path: Path, no_disk: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    finish(play(tmp_path, a_list()), tmp_path)
    story, spec = write.collected(tmp_path), load_system("test-function").spec
    newer = SystemSpec.model_validate({**spec.model_dump(), "doc": "newer"})
    monkeypatch.setattr(nominal, "system_specs", lambda: {spec.name: newer})
    scene = nominal.with_nominal(tmp_path, story).scenes[0]
    assert [replace(scene.traces[0], label=""), *scene.traces[1:]] == [
        replace(story.scenes[0].traces[0], label=""),
        *story.scenes[0].traces[1:],
    ]
    assert "no nominal curve: test-function is not installed here as it was" in scene.traces[0].label


def test_pairs_need_no_simulation(finished: Path, story: ReportData, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nominal, "system_specs", lambda: pytest.fail("no caller needs it"))
    assert nominal.with_nominal(finished, story) is story


# The command


@pytest.mark.usefixtures("no_figures")
def test_the_command_prints_the_files_or_the_story(finished: Path, story: ReportData) -> None:
    before = contents(finished)
    printed = CliRunner().invoke(cli, ["report", str(finished), "--json"], catch_exceptions=False)
    assert json.loads(printed.stdout) == json.loads(to_json(story))
    assert contents(finished) == before
    printed = CliRunner().invoke(cli, ["report", str(finished)], catch_exceptions=False)
    assert printed.stdout.splitlines() == [str(path) for path in write.write_page(finished, story)]
    assert printed.stderr == ""


@pytest.mark.usefixtures("no_figures")
def test_the_report_of_a_campaign_that_is_not_finished_says_so(tmp_path: Path, no_disk: None) -> None:
    stage = play(tmp_path, a_pair("rigorous"), over_soon())
    stage.journal.close()
    printed = CliRunner().invoke(cli, ["report", str(tmp_path)], catch_exceptions=False)
    assert printed.exit_code == 0
    page = Parsed((tmp_path / "report.html").read_text()).story
    assert page["state"] == "stopped"
    assert page["claims"] == []
    assert page["resume"] == "perfbound resume ."
    assert str(tmp_path) not in (tmp_path / "report.html").read_text(), "a report may be moved"


def over_soon() -> Any:
    turns = iter(range(100))
    return lambda: next(turns) > 2


@pytest.mark.usefixtures("no_figures")
def test_a_finished_campaign_gets_its_page_silently(finished: Path, story: ReportData, capsys: Any) -> None:
    for path in write.write_page(finished, story):
        path.unlink()
    report.draw(finished)
    assert (finished / "report.html").is_file()
    assert capsys.readouterr() == ("", "")


def test_a_report_that_fails_is_one_line_and_no_error(
    finished: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    said = list[str]()
    monkeypatch.setattr(report, "_print_stderr", said.append)
    monkeypatch.setattr(write, "write_page", lambda *_: 1 / 0)
    report.draw(finished)
    (line,) = said
    assert "division by zero" in line
    assert f"perfbound report {finished}" in line


@pytest.mark.usefixtures("no_figures")
def test_counterexamples_with_a_hostile_path_harm_no_file(tmp_path: Path, no_disk: None) -> None:
    finish(play(tmp_path / "run", a_pair("paper")), tmp_path / "run")
    row: dict[str, Any] = {"problem": "sim_gap", "test": 0, "variant": "true", "replicate": 9, "seed": 1}
    row |= {"sha256": "0" * 64, "size": 1, "path": "../../x", "robustness": -0.05, "by_tolerance": 0}
    row |= {"block": 0, "violations": 1}
    insert(tmp_path / "run", "rollouts", seq=10**6, **row)
    for path in write.write_page(tmp_path / "run", write.collected(tmp_path / "run")):
        assert path.is_relative_to(tmp_path / "run")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.rest
def test_more_parameters_have_lines_and_planes_and_inputs_a_picture() -> None:
    cube, many = example_reports.cube(), example_reports.many(12, 700)
    assert set(drawn(cube)) == {
        f"nominal_robustness-{kind}.{form}" for kind in ("map", "inputs", "tests", "decay") for form in ("svg", "png")
    }
    assert {name for name in drawn(many) if name.endswith("svg")} == {
        f"nominal_robustness-{kind}.svg" for kind in ("histogram", "tests")
    }
    moved = replace(cube.problems[0].surfaces[0], through=(2.0, 1.0, 3.0))
    elsewhere = replace(cube, problems=(replace(cube.problems[0], surfaces=(moved,)),))
    name = "nominal_robustness-map.svg"
    assert drawn(elsewhere)[name] != drawn(cube)[name], "the title names the plane"


@pytest.mark.rest
def test_lines_of_tests_without_a_value_are_drawn() -> None:
    cube = example_reports.cube()
    tests = replace(cube.problems[0].tests, y=(None,) * 6)
    none = replace(cube, problems=(replace(cube.problems[0], tests=tests),))
    assert "nominal_robustness-tests.svg" in drawn(none)


@pytest.mark.parametrize(
    ("command", "moved"),
    [
        ("replay runs/a r.0 --system own/cp.py:cartpole", "replay . r.0 --system ../../own/cp.py:cartpole"),
        ("replay runs/a r.0 --system 'my cars.toml'", "replay . r.0 --system '../../my cars.toml'"),
        ("replay /runs/a r.0 --system /own/cp.py:cartpole", "replay . r.0 --system /own/cp.py:cartpole"),
        ("replay runs/a r.0", "replay . r.0"),
    ],
)
def test_a_command_of_a_report_works_in_the_run_directory(command: str, moved: str) -> None:
    assert write._in_its_directory(f"perfbound {command}") == f"perfbound {moved}"
