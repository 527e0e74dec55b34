"""The options of a live page are the same in every command that serves one."""

import click
import pytest

from perfbound.orchestrator.cli.group import cli

COMMANDS = ("run", "orchestrate", "resume", "web")
OPTIONS = {"--web", "--web-token", "--web-tls-certificate", "--web-tls-key", "--insecure"}


def options(command: str) -> dict[str, click.Parameter]:
    return {option: each for each in cli.commands[command].params for option in each.opts}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_with_a_page_has_all_of_them(command: str) -> None:
    assert options(command).keys() >= OPTIONS


def test_no_other_command_serves_a_page_and_none_takes_the_token_as_an_option() -> None:
    assert {name for name in cli.commands if "--web" in options(name)} == set(COMMANDS)
    for command in COMMANDS:
        flag = options(command)["--web-token"]
        assert isinstance(flag, click.Option)
        assert flag.is_flag, "other users read command lines"
