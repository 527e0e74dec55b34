"""All checks of a campaign against its system: `schemas.file.against_system`, and those of the parsed formula."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from ...schemas.amounts import amount
from ...schemas.batch import MOST_NUMBERS, largest_batch
from ...schemas.errors import CampaignError, check_all, meant
from ...schemas.file.against_system import as_in_campaign, check_against
from ...schemas.file.config import CampaignConfig
from ...schemas.file.keys import CampaignKeys
from ...schemas.file.logs import driven_column
from ...schemas.file.method_spaces import candidates, draws_starts
from ...schemas.file.objectives import rolled_out
from ...schemas.file.parameters import parameter_ranges
from ...schemas.file.parts import parts_of
from ...schemas.file.problem_models import KrigingProblem, PaperProblem, Problem, RigorousProblem
from ...schemas.file.space import space_kind
from ...schemas.ranges import MAX_FILE_BYTES
from ...schemas.system import SystemSpec
from ..mathematics.bounds.cost import BLOCKS, LARGEST_MEMORY, LARGEST_PLAN, MethodSize, most
from ..mathematics.bounds.kriging.design import GRID_PARAMETERS, points_per_parameter
from ..mathematics.gp.kernels import Matern
from ..mathematics.search.goal import without_scale
from ..mathematics.stl.horizon import check_horizon
from ..mathematics.stl.parser import Formula, FormulaError, columns, parse_formula
from ..mathematics.stl.text import excerpt
from .objectives import LARGEST
from .plan import is_controlled
from .starts import check_distributions, check_where


def check(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Refuse a campaign, read from `source`, that its system cannot run or whose claim would not follow.

    Raises:
        CampaignError: a line for each fault, with the source, the key and the remedy.

    """
    if config.system.name not in ("", spec.name):
        raise CampaignError(f"{source}: system.name: is {config.system.name!r}, the system here is {spec.name!r}")
    checks: list[Callable[[], None]] = [
        partial(check_against, config, spec, source),
        partial(_check_specification, config, spec, source),
        partial(_check_keep, config, spec, source),
        partial(_check_tolerance, config, spec, source),
    ]
    if isinstance(config.space, dict) and space_kind(config.space) == "distributions":
        checks.append(partial(check_distributions, config.space, source))
    if isinstance(config.space, dict) and config.where is not None:
        checks.append(partial(check_where, config.space, config.where, source))
    check_all(*checks)


def check_new(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Refuse what `check` refuses, and what campaigns that have begun may have: too large a size, and a clip that hides
    violations.

    Raises:
        CampaignError: a line for each fault, with the source, the key and the remedy.

    """
    check_all(
        partial(check, config, spec, source),
        partial(_check_new_clip, config, source),
        partial(check_sizes, config, source),
        partial(_check_batch, config, spec, source),
    )


def _check_keep(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Refuse a campaign that would drop the samples from which it reads disturbances."""
    reads = bool(spec.reported) and any(
        is_controlled(config, spec, problem, rolled_out(problem.name, spec)) for problem in config.problems
    )
    if config.keep != "all" and reads:
        raise CampaignError(
            f"{source}: keep: {config.keep!r} drops samples, in which {spec.name} reports its disturbances; remove "
            'this key, or choose control = "off"'
        )


def _check_batch(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Refuse batches whose requests would be too large, or whose files, as far as the system declares their size."""
    disturbances = len(spec.disturbances)
    if config.batch * disturbances > MOST_NUMBERS // 2:
        raise CampaignError(
            f"{source}: batch: {config.batch:,} rollouts with {disturbances:,} disturbances each are more numbers than "
            f"a request has room for; choose at most {MOST_NUMBERS // 2 // disturbances:,}"
        )
    each = spec.trajectory_bytes or 0
    most = max(largest_batch(each), 1)
    if config.batch > most:
        raise CampaignError(
            f"{source}: batch: {config.batch} trajectories of {amount(each)} are {amount(each * config.batch)}, and a "
            f"file has at most {amount(MAX_FILE_BYTES)}; choose at most {most}"
        )


def _check_new_clip(config: CampaignConfig, source: str) -> None:
    """Refuse a clip beyond what a campaign records, or one that hides violations."""
    if config.clip is not None and max(map(abs, config.clip)) > LARGEST:
        raise CampaignError(
            f"{source}: clip: {list(config.clip)} is beyond {LARGEST:g}; give a range of the robustness"
        )
    # Robustness is recorded clipped, and a violation is one below 0.
    if config.formula is not None and config.clip is not None and config.clip[0] >= 0:
        raise CampaignError(
            f"{source}: clip: its lower end {config.clip[0]:g} hides violations, which have a robustness below 0; "
            "choose one below 0"
        )


def _check_specification(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    known, truncates = as_in_campaign(spec, config).units, config.beyond == "truncate"
    # A horizon that is missing has a line already.
    horizon = spec.max_horizon if config.horizon == 0 and spec.timed else config.horizon
    # One by one first, so that an error names the requirement.
    faults = []
    for each in config.specifications:
        try:
            tree = parse_formula(each.formula, known)
            if not truncates:
                check_horizon(tree, horizon)
        except FormulaError as error:
            faults.append(f"{source}: specifications.{each.name}: {error}")
    if faults:
        raise CampaignError(*faults)
    if config.formula is None:
        return
    try:
        formula = parse_formula(config.formula, known)
        if not truncates:
            check_horizon(formula, horizon)
        _check_gap(config, known, columns(formula), source)
    except FormulaError as error:
        raise CampaignError(f"{source}: specification: {error}") from None
    if config.falsify is not None and config.falsify.scale is not None:
        check_scale(config.falsify.scale, formula, source)


def check_scale(scale: Mapping[str, float], formula: Formula, source: str) -> None:
    """Refuse a scale of columns that the formula does not read, or of none of a predicate.

    Raises:
        CampaignError: one line with the source and the column.

    """
    read = sorted(columns(formula))
    if unknown := next((name for name in scale if name not in read), ""):
        near = meant(unknown, read)
        raise CampaignError(
            f"{source}: falsify.scale.{unknown}: no predicate reads this column; {near}these are read: "
            f"{', '.join(read)}"
        )
    if (predicate := without_scale(formula, scale)) is not None:
        missing = ", ".join(sorted(columns(predicate)))
        raise CampaignError(f"{source}: falsify.scale: `{excerpt(predicate)}` has none; give that of {missing}")


def _check_gap(config: CampaignConfig, known: Collection[str], read: frozenset[str], source: str) -> None:
    """Refuse a gap in one column where the robustness depends on others."""
    for problem in config.problems:
        gap = config.gap_of(problem)
        # The composition needs |rho(s) - rho(z)| <= L * gap: a gap in one column bounds nothing that others change.
        # An unknown column has a line already.
        if gap is not None and gap.kind == "signal_sup" and gap.column in known and read != {gap.column}:
            raise CampaignError(
                f"{source}: gap.column: {gap.column!r} does not bound the robustness: the specification reads "
                f'{", ".join(sorted(read)) or "no column"}; use kind = "predicate_sup", which fits every specification'
            )


# What the methods of a campaign take, before any of it is allocated


def method_sizes(config: CampaignConfig, tests: Mapping[str, int] | None = None) -> list[tuple[Problem, MethodSize]]:
    """Return each problem with the sizes of its method; with several requirements once for each of them.

    `tests` replaces the budget of problems by their names.
    """
    return [
        (problem, _method_size(each, problem, (tests or {}).get(problem.name)))
        for each in parts_of(config) or (config,)
        for problem in each.problems
    ]


def _method_size(config: CampaignKeys, problem: Problem, tests: int | None) -> MethodSize:
    starts, resolution, box = config.starts_of(problem), config.resolution_of(problem), isinstance(config.space, dict)
    parameters = len(parameter_ranges(config.space)) if isinstance(config.space, dict) else len(config.space.rows[0])
    tests = tests or config.max_tests_of(problem)
    return MethodSize(
        problem.method,
        parameters,
        0 if draws_starts(problem.method) else candidates(config.space, resolution, starts),
        tests,
        config.window_of(problem),
        listed=starts is not None or not box,
        refined=isinstance(problem, PaperProblem) and problem.refine,
        per_axis=_points(config, problem, parameters, tests) if isinstance(problem, KrigingProblem) else 0,
    )


def _points(config: CampaignKeys, problem: KrigingProblem, parameters: int, tests: int) -> int:
    if parameters > GRID_PARAMETERS:  # the points of more are scattered
        return 0
    default = points_per_parameter(parameters, tests, config.replicates_of(problem))
    return problem.points or min(default, config.resolution_of(problem))


def check_sizes(config: CampaignConfig, source: str, tests: Mapping[str, int] | None = None) -> None:
    """Refuse a campaign whose methods may take more memory than is allowed, or plan their weights for too long.

    `tests` as of `method_sizes`.

    Raises:
        CampaignError: a line for each problem that is too large, with the key, what it takes, and smaller sizes.

    """
    found = method_sizes(config, tests)
    share = (LARGEST_MEMORY - BLOCKS) / max(1, len(found))
    too_much = sum(size.memory for _, size in found) + BLOCKS > LARGEST_MEMORY
    lines: dict[str, str] = {}
    for problem, size in found:
        where, parts = f"{source}: problems.{problem.name}", sum(each.name == problem.name for each, _ in found)
        if too_much and size.memory > share:
            several = "" if parts == 1 else f" for {parts} requirements"
            lines[problem.name] = (
                f"{where}.max_tests: {size.tests:,} tests{several} and {size.candidates:,} candidates may take "
                f"{amount(parts * size.memory)}, and the methods of a campaign at most {amount(LARGEST_MEMORY)}; "
                f"{_smaller(config, problem, size, lambda each: each.memory <= share, tests_alone=tests is not None)}"
            )
        elif size.method == "kriging" and size.operations > LARGEST_PLAN:
            lines[problem.name] = (
                f"{where}.points: {size.per_axis} for each of {size.parameters} parameters, with {size.candidates:,} "
                f"nodes, take {size.seconds / 3600:.2g} h for one plan of their weights, and the orchestrator does "
                "nothing else meanwhile; "
                f"{_smaller(config, problem, size, lambda each: each.operations <= LARGEST_PLAN)}"
            )
    if lines:
        raise CampaignError(*lines.values())


def _smaller(
    config: CampaignKeys,
    problem: Problem,
    size: MethodSize,
    fits: Callable[[MethodSize], bool],
    *,
    tests_alone: bool = False,
) -> str:
    """Return the ways in which a method gets small enough, each a key with its value."""
    resolution, ways = config.resolution_of(problem), []
    if isinstance(problem, KrigingProblem):
        points = most(size.per_axis, lambda number: fits(replace(size, per_axis=number)))
        ways += [f"points = {points}"] if points > 1 else []
    elif tests := most(size.tests, lambda number: fits(replace(size, tests=number))):
        ways.append(f"max_tests = {_two_digits_down(tests)}")
    if tests_alone:  # the other sizes of a campaign that has begun are fixed
        return f"give {' or '.join(ways) or 'no more tests'}"
    if size.listed:
        starts = most(size.candidates, lambda number: fits(replace(size, candidates=number)))
        ways += [f"candidates = {_two_digits_down(starts)}"] if isinstance(config.space, dict) and starts > 1 else []
    else:
        nodes = most(resolution, lambda number: fits(replace(size, candidates=number**size.parameters)))
        ways += [f"resolution = {nodes}"] if nodes > 1 and nodes >= size.per_axis else []
    return f"give {' or '.join(ways)}" if ways else "choose fewer requirements"


def _two_digits_down(number: int) -> int:
    """Return a number rounded down to two digits.

    >>> _two_digits_down(3412), _two_digits_down(87)
    (3400, 87)
    """
    step: int = 10 ** max(0, len(str(number)) - 2)
    return number // step * step


def _check_tolerance(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Refuse a tolerance of a start that a bound does not count.

    Formula: |J(x') - J(x)| <= B ||k(x', .) - k(x, .)|| = B sqrt(2 - 2 k(x', x)) for J - m0 of norm B, so that what is
    observed at x' within the tolerance of x is that at x but for this number, which `misspecification` takes.

    Raises:
        CampaignError: one line with the source, the key and the remedy.

    """
    tolerance = config.system.tolerance
    if tolerance is None:
        return
    names, columns = [each.name for each in spec.parameters], {each.name for each in spec.columns}
    for name in tolerance:
        if name not in names or driven_column(name) not in columns:
            raise CampaignError(
                f"{source}: system.tolerance.{name}: the rig has the parameters {', '.join(names)}; name one of them"
            )
    for part in parts_of(config) or (config,):
        for problem in part.problems:
            if isinstance(problem, KrigingProblem | PaperProblem):
                raise CampaignError(
                    f"{source}: method: of a rig with a tolerance choose 'sample' or 'scenario', or 'rigorous' with "
                    f"`misspecification`; {problem.method!r} takes each rollout as one of the start that was asked for"
                )
            if not isinstance(problem, RigorousProblem):
                continue
            length = problem.kernel.length_scale
            apart = [
                tolerance.get(name, 0.0) / (length[name] if isinstance(length, dict) else length) for name in names
            ]
            correlation = float(Matern(problem.kernel.nu, 1.0)(np.array([np.linalg.norm(apart)]))[0])
            beside = problem.rkhs_norm * float(np.sqrt(max(2.0 - 2.0 * correlation, 0.0)))
            if problem.misspecification < beside:
                needed = float(np.nextafter(beside, np.inf))
                raise CampaignError(
                    f"{source}: misspecification: between a start that was asked for and one within the tolerance, a "
                    f"function of norm B may differ by {beside:.3g}; give misspecification = {_above(needed):g}, a "
                    "smaller tolerance, or method 'sample'"
                )


def _above(value: float) -> float:
    """Return a short number that is at least so large."""
    digits = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(f"{np.ceil(value / digits) * digits:.3g}") if value > 0 else 0.0
