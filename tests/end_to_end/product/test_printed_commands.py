"""Every command that a run, its status, its report and its refusals print works as it is copied from there."""

import re
import shlex
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
CAMPAIGNS = {
    "an end by a violation": "falsify = {}\nmax_tests = 60\n",
    "a bound": "max_tests = 20\nclaims = [{ quantity = 'failure_probability' }]\nrequired_at_most = 0.5\n",
    "a claim of a kernel": 'method = "rigorous"\nalpha = 3\nrkhs_norm = 60\nnoise_scale = 2.1\nclip = [-30, 60]\n'
    "kernel = { length_scale = { gap = 30, speed = 20 } }\nmax_tests = 6\nspot_check = 5\n",
}
COMMON = """specification = "always (distance >= 2)"
horizon = 8
{keys}[system]
python = "cars.py:cars"
[space]
gap = [5, 50]
speed = [10, 30]
"""
LINE = re.compile(r".*?(?:   |: )(perfbound .*)")
INSIDE = re.compile(r"`(perfbound [^`]+)`")
NEEDS_A_PERSON = {"open"}


def commands(text: str) -> set[str]:
    """Return the commands of lines that begin with one behind a word in front, or that stand between backticks."""
    rows = [match[1].strip() for line in text.splitlines() if (match := LINE.fullmatch(line))]
    # A word in capitals stands for something.
    return {each for each in (*rows, *INSIDE.findall(text)) if not re.search(r"\b[A-Z]{2,}\b", each)}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_commands_work_as_they_are_printed(started: Processes, name: str) -> None:
    folder = started.folder / "a folder with blanks"
    folder.mkdir()
    (folder / "cars.py").write_bytes((EXAMPLES / "cars" / "cars.py").read_bytes())
    (folder / "cars.toml").write_text(COMMON.format(keys=CAMPAIGNS[name]))
    # From elsewhere, by a path that needs quotes.
    ended = started.run("perfbound", "run", "a folder with blanks/cars.toml", "--out", "my runs/cars", "--workers", "1")
    assert ended.code == 0, ended.err
    told = [ended.out, started.run("perfbound", "show", "my runs/cars").out]
    told.append(started.run("perfbound", "status", "my runs/cars").out)
    again = started.run("perfbound", "run", "a folder with blanks/cars.toml", "--out", "my runs/cars")
    assert again.code == 1
    told.append(again.err)
    directory = started.folder / "my runs" / "cars"
    story = (directory / "report.html").read_text().partition('id="story">')[2].partition("</script>")[0]
    of_page = commands("\n".join(f"report   {each}" for each in re.findall(r'"(perfbound [^"]*)"', story)))
    found = set().union(*map(commands, told))
    assert len(found) >= 3, found
    assert any("verify" in each for each in found), found
    # The page says that its commands are for the directory that it lies in.
    for command, place in [
        *((each, started.folder) for each in sorted(found)),
        *((each, directory) for each in of_page),
    ]:
        program, *arguments = shlex.split(command)
        if arguments[0] in NEEDS_A_PERSON:
            continue
        done = started.start(program, *arguments, prefix=("env", f"--chdir={place}")).wait()
        assert done.code == 0, f"{command}\n{done.err}"
