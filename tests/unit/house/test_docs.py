"""The documentation names files, commands and options that exist."""

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import perfbound
from perfbound.orchestrator.cli.group import cli
from perfbound.schemas.draws.laws import inverse
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.toml_text import toml_file
from perfbound.workers.cli import serve

ROOT = Path(__file__).parents[3]
PAGES = sorted(
    [*(ROOT / "docs").rglob("*.md"), *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "DECISIONS"))]
)
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")
LOADED = re.compile(r"<(?:script|img|iframe|link)[^>]* (?:src|href)=[\"']?(?:https?:)?//")
"""An element that makes a browser load something from another host."""
PATH = re.compile(r"`((?:deploy|docs|orchestrator|perfbound|schemas|tests|workers)/[\w./-]*)`")
COMMAND = re.compile(r"^ {4}(perfbound(?:-worker)? (?:.*\\\n)*.*)|`(perfbound(?:-worker)? [^`]*)`", re.MULTILINE)


def commands(text: str) -> Iterator[list[str]]:
    """Yield the words of every command line in a page."""
    for line, inline in COMMAND.findall(text):
        yield shlex.split((line or inline).replace("\\\n", " "), comments=True)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page: Path) -> None:
    for link in LINK.findall(page.read_text()):
        assert (page.parent / link).exists(), link


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_and_options_exist(page: Path) -> None:
    for program, *words in commands(page.read_text()):
        command: click.Command = serve if program == "perfbound-worker" else cli
        while isinstance(command, click.Group) and words:
            found = command.get_command(click.Context(command), words.pop(0))
            assert found is not None, page
            command = found
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        assert {word.split("=")[0] for word in words if word.startswith("--")} <= known, (program, words)


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "README.md").read_text()
    linked = {(ROOT / "docs" / link).resolve() for link in LINK.findall(index)}
    assert {page for page in PAGES if page.name != "README.md"} <= linked


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    listed = set(re.findall(r"- [^:\n]+: (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    assert {str(page.relative_to(ROOT / "docs")) for page in PAGES if page.is_relative_to(ROOT / "docs")} <= listed


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_paths_exist(page: Path) -> None:
    """In backquotes, from the root of the repository: folders end with a slash."""
    for path in PATH.findall(page.read_text()):
        assert (ROOT / path).exists(), path


def test_pages_quote_one_run_of_the_segway() -> None:
    """All of them quote `runs/segway`; its numbers follow from the seed in the campaign file."""
    pages = {name: (ROOT / name).read_text() for name in NAMES}
    quoted = [
        r"Margin at least ([\d.]+) rad",
        r"(\d of [\d,]+ rollouts violate the specification; the worst [\d.]+ rad)",
        r"replay runs/segway (true_risk\S+)",
        r"runs/segway +SHOWN +>= ([\d.]+) rad",
    ]
    found = [{(name, value) for name, text in pages.items() for value in re.findall(each, text)} for each in quoted]
    assert [{value for _, value in each} for each in found if len({value for _, value in each}) != 1] == [], found
    margins = {value for _, value in found[0] | found[3]}
    assert len(margins) == 1, margins


def test_the_tree_of_the_architecture_page_is_the_layers_that_are_checked() -> None:
    """By name and order: one room per line of the tree."""
    rules = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]["layers"]
    tree = (ROOT / "docs/architecture.md").read_text().partition("```text\n")[2].partition("```")[0]
    assert re.findall(r"^  (\w+)/", tree, re.MULTILINE) == [room for layer in rules for room in layer.split(" | ")]


def test_the_function_of_the_docs_is_the_shipped_example() -> None:
    page, example = (ROOT / "docs/own-system.md").read_text(), ROOT / "deploy/examples/cars"
    for name, kind in (("cars.py", "python"), ("cars.toml", "toml")):
        assert f"```{kind}\n{(example / name).read_text()}```" in page, name


@pytest.mark.parametrize("page", ["own-system", "simulators", "stl", "constants"])
def test_parts_of_campaign_files_are_allowed(page: str) -> None:
    """Each part is read with a system that has its parameters and columns."""
    base: dict[str, Any] = {"system": {"name": "s"}, "clip": [-1, 1], "horizon": 15, "max_tests": 59}
    base |= {"claims": [{"quantity": "mean"}], "space": {"z": [0, 1]}, "specification": "always (z >= 0)"}
    parts = re.findall(r"```toml\n(.*?)```", (ROOT / f"docs/{page}.md").read_text(), re.DOTALL)
    for part in parts:
        # The page of formulas lists several.
        for each in part.splitlines() if part.count("specification =") > 1 else [part]:
            given = tomllib.loads(each)
            file = given if "prior_mean" in given else base | given
            assert parse_campaign(toml_file(file).encode(), "part.toml", lambda _: b"0,1\n").specification, each


def test_the_laws_of_the_docs_are_those_of_numpy() -> None:
    """By the median of many draws."""
    page = (ROOT / "docs/own-system.md").read_text()
    rows = re.findall(r"^ *\| (`.*?rng\..*) \| (`pb\..*) \|$", page, re.MULTILINE)
    pairs = [
        pair
        for drawn, declared in rows
        for pair in zip(re.findall(r"`(.*?)`", drawn), re.findall(r"`(pb\..*?)`", declared), strict=True)
    ]
    assert len(pairs) == 8
    for drawn, declared in pairs:
        call = drawn[:-1] + (", size=20_001)" if drawn.endswith(")") else "")
        sample = np.asarray(eval(call, {"rng": np.random.default_rng(1)}))
        law = eval(declared, {"pb": perfbound})
        shares = np.linspace(0.11, 0.89, 9)
        assert np.quantile(sample, shares) == pytest.approx(inverse(law)(shares), rel=0.03, abs=0.06), declared


def test_the_system_of_the_docs_keeps_the_contract() -> None:
    code = re.findall(r"```python\n(.*?)```", (ROOT / "docs/own-system.md").read_text(), re.DOTALL)[-1]
    names: dict[str, Any] = {}
    exec(code, names)
    system = names["Decay"]()
    arguments = {"seed": 7, "horizon": 10.0, "options": {}, "progress": lambda _step: None}
    nominal, true, again = (
        system.rollout([1.0], variant=variant, **arguments) for variant in ("nominal", "true", "true")
    )
    assert nominal.columns == tuple(column.name for column in system.spec.columns)
    assert (nominal.samples[0, 0], nominal.samples[-1, 0]) == (0.0, 10.0)
    assert (true.samples == again.samples).all()
    assert not (true.samples == nominal.samples).all()
    assert system.visual(true) is None


@pytest.mark.integration
@pytest.mark.rest
@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="mkdocs is not installed: make docs")
def test_the_site_builds_is_searchable_and_loads_nothing_from_outside(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    names = {page.relative_to(ROOT / "docs") for page in PAGES if page.is_relative_to(ROOT / "docs")}
    for name in names:
        html = (
            tmp_path / name.with_name("index.html" if name.name == "README.md" else f"{name.stem}.html")
        ).read_text()
        assert not LOADED.search(html), name
    found = {entry["location"] for entry in json.loads((tmp_path / "search/search_index.json").read_text())["docs"]}
    assert {"tutorial.html", "library.html#perfbound.systems.SystemUnderTest.rollout"} <= found
