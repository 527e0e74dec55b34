"""The completion scripts, in the shells that are here."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from perfbound.orchestrator import cli as commands
from perfbound.orchestrator.cli.group import cli

BIN = Path(sys.executable).parent
SHELLS = sorted(commands.manual.PLACES)


def script(shell: str) -> str:
    made = CliRunner().invoke(cli, ["completion", shell])
    assert (made.exit_code, made.stderr) == (0, "")
    return made.stdout


@pytest.mark.integration
@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_has_one_line_how_to_install_it(shell: str) -> None:
    lines = script(shell).splitlines()
    assert lines[-1].startswith(f"# To install: perfbound completion {shell} > ")
    assert lines[-1].partition("install: ")[2] in str(commands.manual.completion.help)
    assert shell != "zsh" or lines[0] == "#compdef perfbound"


@pytest.mark.integration
@pytest.mark.parametrize("shell", SHELLS)
def test_a_shell_that_is_here_reads_the_script(shell: str, tmp_path: Path) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    (tmp_path / "script").write_text(script(shell))
    subprocess.run([shell, "-n", tmp_path / "script"], check=True, capture_output=True)


@pytest.mark.integration
@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["res"], {"resume"}),
        (["run", "--st"], {"--strict"}),
        (["completion", "z"], {"zsh"}),
        (["run", "c.toml", "--log", ""], {"text", "json"}),
    ],
)
def test_bash_completes(words: list[str], found: set[str], tmp_path: Path) -> None:
    (tmp_path / "script").write_text(script("bash"))
    line = " ".join(f"'{word}'" for word in ["perfbound", *words])
    program = (
        f"source {tmp_path}/script; COMP_WORDS=({line}); COMP_CWORD={len(words)}; _perfbound_completion perfbound; "
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    path = f"{BIN}{os.pathsep}{os.environ['PATH']}"
    ended = subprocess.run(
        ["bash", "-c", program], env={**os.environ, "PATH": path}, capture_output=True, text=True, check=True
    )
    assert set(ended.stdout.split()) == found, ended.stderr
