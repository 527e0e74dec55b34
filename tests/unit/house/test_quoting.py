"""Commands that are printed for users can be copied: what stands for a path or a name in them is quoted."""

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate.words.format import resume_command
from perfbound.orchestrator.cli import entry  # noqa: F401  (it adds the commands)
from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.store.lock import campaign_lock
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.file.reader import load_campaign
from tests.architecture import source

COMMAND = re.compile(rf"perfbound(?:-worker| (?:{'|'.join(cli.commands)})) [^`;:]*$")
"""The beginning of a command, up to a value in it."""
WORDS = {"PLACES[shell]", "roles[0]", "shell", "wish.question"}
"""Values in such lines that are words of perfbound."""
HOSTILE = "a b; touch hacked $(id) 'x'"


def values(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the values that stand in a command in an f-string, each with its line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = ""
            for part in node.values:
                if isinstance(part, ast.Constant):
                    text += str(part.value)
                elif isinstance(part, ast.FormattedValue):
                    if COMMAND.search(text):
                        yield node.lineno, ast.unparse(part.value)
                    text += "{}"


def quoted(tree: ast.AST) -> set[str]:
    """Return the names of a module that are given a quoted text."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and "shlex." in ast.unparse(node.value):
            for target in node.targets:
                found |= {each.id for each in ast.walk(target) if isinstance(each, ast.Name)}
    return found


@pytest.mark.parametrize("module", sorted(source.modules()))
def test_values_in_commands_are_quoted(module: str) -> None:
    tree = source.modules()[module]
    allowed = WORDS | quoted(tree)
    assert not [(line, value) for line, value in values(tree) if "shlex." not in value and value not in allowed]


def test_an_unquoted_value_would_be_found() -> None:
    tree = ast.parse('f"{path}: watch it with `perfbound status {path}`; {remedy}"')
    assert [value for _, value in values(tree)] == ["path"]


@pytest.mark.integration
def test_a_directory_with_a_hostile_name(tmp_path: Path) -> None:
    directory = tmp_path / HOSTILE
    directory.mkdir()
    assert shlex.split(resume_command(directory))[2:] == [str(directory)]
    with campaign_lock(directory), pytest.raises(PerfboundError) as refused, campaign_lock(directory):
        pass
    for verb in ("status", "stop"):
        (line,) = re.findall(f"`(perfbound {verb} .*?)`", str(refused.value))
        assert shlex.split(line) == ["perfbound", verb, str(directory)]


def test_a_system_that_is_given_as_campaign_file(tmp_path: Path) -> None:
    path = tmp_path / f"{HOSTILE}.py:cars"
    with pytest.raises(PerfboundError) as refused:
        load_campaign(path)
    assert shlex.split(str(refused.value).partition("write a campaign file: ")[2]) == ["perfbound", "init", str(path)]
