"""The documentation names files, commands and options that exist."""

import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from perfbound.orchestrator.cli.group import cli
from perfbound.workers.cli import serve

ROOT = Path(__file__).parents[3]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")
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


def test_the_layers_of_the_architecture_page_are_those_that_are_checked() -> None:
    """By name and order: the page has one layer a line."""
    rules = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]["layers"]
    block = re.search(
        r"each line may import the lines below it:\n\n((?: {4}.*\n)+)", (ROOT / "docs/architecture.md").read_text()
    )
    assert block is not None
    shown = [re.split(r"\s{3,}", line.strip())[0].split(", ") for line in block[1].splitlines()]
    assert shown == [re.split(" [:|] ", layer) for layer in rules]
