"""The failures of a campaign as a pytest file and a table of scenarios."""

import json
import math
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ....schemas.amounts import counted, some_of
from ....schemas.errors import CampaignError, PerfboundError, meant
from ....schemas.file.config import CampaignConfig
from ....schemas.file.reader import load_campaign
from ....schemas.requests import RequestTemplate
from ....schemas.result.facts import Header
from ....schemas.system import differences
from ...certificate.verify.stages import Report
from ...certificate.words.refutation_text import margin_words
from ...fleet.children.rollouts import ChildSystem
from ...report.rollout.load import number_words
from ...run.session import system_of
from ...store.export import whole
from ...store.export_tables import robustness_unit
from ...store.read import stored_header
from .failures import Failure, Failures, alike, failures_of
from .minimise import Movable, minimised, simulated
from .outcome import Judge, Specification, at
from .scenarios import scenario_table

TESTS_FILE = '''"""Failing rollouts of the campaign {campaign!r}; written by `perfbound export --regression`.

A test passes where its scenario meets the specification now, and else says whether it fails as in the campaign or
otherwise. `1-worst` is the worst failure of the first kind, `1-nearest` the nearest one to the nominal start of it
that was found. The system and its options are those of the campaign file when the tests run.
"""

from pathlib import Path

import perfbound as pb
import pytest

HERE = Path(__file__).parent
SCENARIOS = pb.Scenarios(
    HERE / {table},
    campaign=HERE / {file},
    specification={specification},
    horizon={horizon!r},
)


@pytest.mark.parametrize("name", SCENARIOS.names)
def test_no_longer_fails(name: str) -> None:
    found = SCENARIOS.replay(name)
    if not found.fixed:
        pytest.fail(str(found), pytrace=False)
'''


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is exported."""

    campaign: Path
    """The campaign file whose system the tests replay."""
    groups: int
    """Of near failures, at most: those with the worst ones."""
    tests: int
    """Rollouts with which each is moved, at most."""
    nominal: Mapping[str, float]
    """Values of parameters, where those of the campaign are other ones."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of failure."""

    worst: Failure
    nearest: Failure
    """Equal to the worst one where that could not be moved."""


def export_regression(directory: Path, folder: Path, wanted: Wanted, report: Report) -> list[str]:
    """Write the table and the tests of the failures of a campaign into a folder; return lines on them.

    Raises:
        PerfboundError: nothing fails, the rollouts cannot be made again here, or nothing can be written.
        Stopped: a signal arrived.

    """
    header, given = stored_header(directory), load_campaign(wanted.campaign)
    system, specification = _system(directory, header, wanted.campaign, given), specification_of(header, directory)
    movable = Movable(header, _checked(header, wanted.nominal))
    judge = Judge(specification, header.spec, header.config.beyond)
    found = failures_of(directory, header, judge, partial(report, "failures read"))
    worst, most = [group[0] for group in found.groups[: wanted.groups]], wanted.tests * wanted.groups
    moved = minimised(
        worst,
        movable,
        partial(simulated, system, judge),
        tests=wanted.tests,
        report=lambda done: report("rollouts", done, most),
    )
    kinds = _kinds(header, worst, moved)
    named = [
        (f"{number}-{what}", failure)
        for number, kind in enumerate(kinds, 1)
        for what, failure in (("worst", kind.worst), ("nearest", kind.nearest))
        if what == "worst" or failure != kind.worst
    ]
    # Not by the campaign: several runs of it may have tests beside each other.
    name = re.sub(r"\W+", "_", directory.resolve().name, flags=re.ASCII)
    table, tests = folder / f"{name}_failures.csv", folder / f"test_{name}_failures.py"
    with whole(directory, [table, tests]) as (rows, text):
        rows.write(scenario_table(header, named))
        text.write(_tests_file(header, table, wanted.campaign, specification).encode())
    left, every = len(found.groups) - len(worst), f"--groups {len(found.groups)} looks at all"
    return [
        *_lines(directory, header, found, kinds, movable),
        *([f"{counted(left, 'group')} of near failures left out, the milder ones: {every}"] if left else []),
        *differing_options(header, wanted.campaign, given),
        f"{table}  {counted(len(named), 'scenario')}",
        f"{tests}  to run it: pytest {shlex.quote(str(tests))}",
    ]


def _kinds(header: Header, worst: Sequence[Failure], moved: Sequence[Failure]) -> list[Kind]:
    """Return the kinds of failures: two that are near each other once they are moved are of one."""
    kinds = [Kind(*pair) for pair in zip(worst, moved, strict=True)]
    of_one = [
        [kind for kind in kinds if kind.nearest in group] for group in alike(header, [each.nearest for each in kinds])
    ]
    # Groups begin with the worst failure, and so do kinds.
    return sorted((group[0] for group in of_one), key=kinds.index)


def _system(directory: Path, header: Header, campaign: Path, config: CampaignConfig) -> ChildSystem:
    """Return the system of the campaign file, which has to be the one of the run directory."""
    spec = header.spec
    if spec.repeated != "anywhere" or spec.batch_is_the_unit:
        what = "one by one" if spec.repeated == "anywhere" else "again"
        raise PerfboundError(f"{directory}: rollouts of {spec.name} cannot be simulated {what}; nothing was exported")
    here = system_of(config, campaign, config.system.reference(campaign))
    if here.digest != spec.digest:
        raise CampaignError(
            f"{campaign}: its system is another one than that of {directory}: "
            f"{'; '.join(differences(spec, here)[:3]) or 'another name'}; export with the sources of the campaign, "
            "and fix them after that"
        )
    return ChildSystem(str(campaign), spec, header.config.deadline, math.inf)


def specification_of(header: Header, directory: Path) -> Specification:
    """Return the formula of a campaign, or that of each requirement by its id, or by its name.

    Raises:
        PerfboundError: the campaign has none.

    """
    config = header.config
    if config.formula is None:
        raise PerfboundError(f"{directory}: the campaign has no specification that a rollout could violate")
    each = config.specifications
    if not each:
        return config.formula
    names = [one.id or one.name for one in each]
    if len(set(names)) < len(names):
        names = [one.name for one in each]
    return {name: one.formula for name, one in zip(names, each, strict=True)}


def _checked(header: Header, nominal: Mapping[str, float]) -> Mapping[str, float]:
    known = {each.name: each for each in header.spec.own_parameters}
    for name, value in nominal.items():
        if name not in known:
            raise PerfboundError(f"--nominal {name}: {meant(name, known)}the parameters are {', '.join(known)}")
        if not known[name].low <= value <= known[name].high:
            raise PerfboundError(f"--nominal {name}={value:g}: it is not in {known[name].range_words}")
    return nominal


def _tests_file(header: Header, table: Path, campaign: Path, specification: Specification) -> str:
    return TESTS_FILE.format(
        campaign=header.config.name,
        table=_quoted(table.name),
        file=_quoted(os.path.relpath(campaign.absolute(), table.parent.absolute())),
        specification=_literal(specification),
        horizon=header.config.horizon,
    )


def _literal(specification: Specification) -> str:
    if isinstance(specification, str):
        return _quoted(specification)
    inside = "".join(f"        {_quoted(name)}: {_quoted(formula)},\n" for name, formula in specification.items())
    return f"{{\n{inside}    }}"


def _quoted(text: str) -> str:
    """Return a text as a literal of Python, which a string of JSON is."""
    return json.dumps(text, ensure_ascii=False)


def differing_options(header: Header, campaign: Path, config: CampaignConfig) -> list[str]:
    """Return a line on the options in which a campaign file, whose content is `config`, differs from the run."""
    there = RequestTemplate.of(header.spec, config.system.options, horizon=config.horizon, visual=False).options
    unlike = [
        f"{name} = {there[name]}, and {value} in the run"
        for name, value in header.template.options.items()
        if there.get(name) != value
    ]
    return [f"{campaign} has {'; '.join(unlike)}: the tests replay what is in the file"] if unlike else []


def _lines(directory: Path, header: Header, found: Failures, kinds: Sequence[Kind], movable: Movable) -> list[str]:
    """Return a line on the failures, and two on each kind."""
    rollouts = counted(found.rollouts, "rollout")
    verb = "violates" if found.rollouts == 1 else "violate"
    lines = [f"{directory}: {rollouts} {verb} the specification; {counted(len(kinds), 'kind')} of failure"]
    unit = robustness_unit(header.config, header.spec)
    for number, kind in enumerate(kinds, 1):
        outcome = kind.worst.outcome
        what = some_of(list(outcome.violated))
        lines.append(f"{number}  {what}: worst robustness {margin_words(outcome.robustness, unit)}{at(outcome.moment)}")
        if kind.nearest != kind.worst:
            where = "the nominal start itself, " if movable.is_nominal(kind.nearest) else ""
            lines.append(f"   nearest {where}{_start_words(header, kind.nearest)}, {_of(kind.nearest, unit)}")
    return lines


def _of(failure: Failure, unit: str) -> str:
    return f"robustness {margin_words(failure.outcome.robustness, unit)}{at(failure.outcome.moment)}"


def _start_words(header: Header, failure: Failure) -> str:
    spec = header.spec
    numbers = [(each.name, each.unit, value) for each, value in zip(spec.own_parameters, failure.x, strict=False)]
    if failure.disturbances:
        numbers += [
            (law.name, law.unit, value) for law, value in zip(spec.disturbances, failure.disturbances, strict=True)
        ]
    return number_words(numbers)
