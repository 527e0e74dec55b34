"""The checks of a campaign against its system under test: parameters, columns, options, horizon."""

import re
from collections.abc import Iterator

from ..errors import CampaignError, DefinitionError, meant, nearest_name
from ..system import SCORED, Parameter, SystemSpec
from ..values import FORMULA_WORDS
from .config import CampaignConfig
from .disturbance import Disturbance
from .drawn_claims import drawn_claims, fewest_samples
from .method_spaces import draws_starts
from .objectives import rolled_out
from .parameters import Range, signal_shapes
from .parts import parts_of
from .problem_models import KernelProblem, Problem, RigorousProblem
from .signals import SignalShape
from .space import Scenarios, StartTable

WORD = re.compile(r"[a-z][a-z0-9_]*")
SEARCHED_SCORE = 5.0
"""Standard deviations within which a search chooses: beyond, a failure is rarer than one in a million rollouts."""
MOST_SCORE = 6.0
"""Standard deviations that a bounded disturbance reaches at most: a probability beyond is below any known law's."""


def as_in_campaign(spec: SystemSpec, config: CampaignConfig | None) -> SystemSpec:
    """Return a system as a campaign knows it.

    With its knots and its bounded disturbances as parameters, and with the laws of its disturbances.
    """
    if config is None:
        return spec.spread()
    ranges = config.space if isinstance(config.space, dict) else {}
    if sought := searched(config):
        added = {law.name: searched_range(config.disturbances.get(law.name, law), law) for law in spec.disturbances}
    else:
        added = {
            law.name: Parameter(name=law.name, unit=each.unit or law.unit, low=each.low, high=each.high)
            for law in spec.disturbances
            if (each := ranges.get(law.name)) is not None
        }
    return spec.spread(_shapes(config, spec), config.disturbances, added, drawn=sought)


def _shapes(config: CampaignConfig, spec: SystemSpec) -> list[SignalShape]:
    """Return the input signals: one that a formula or a problem names is a column, if the system returns none such."""
    texts = [config.formula or "", *(each.formula for each in config.specifications)]
    named = {word for text in texts for word in WORD.findall(text)} - FORMULA_WORDS
    gaps = [config.gap, *(problem.gap for problem in config.problems)]
    named |= {gap.column for gap in gaps if gap is not None and gap.column is not None}
    named |= {problem.column for problem in config.problems if problem.column is not None}
    named -= {column.name for column in spec.declared.columns}
    return [
        shape.model_copy(update={"recorded": True}) if shape.name in named else shape
        for shape in signal_shapes(config.space)
    ]


def searched(config: CampaignConfig) -> bool:
    """Whether a search chooses the disturbances of its tests."""
    return config.falsify is not None and config.falsify.over == "disturbances"


def searched_range(law: Disturbance, declared: Disturbance) -> Parameter:
    """Return a disturbance as a parameter of a search: its scores, or its choices."""
    if law.choices is not None:
        return Parameter(name=declared.name, unit=declared.unit, low=min(law.choices), high=max(law.choices))
    return Parameter(name=declared.name, unit=SCORED, low=-SEARCHED_SCORE, high=SEARCHED_SCORE)


def check_against(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Check the parameters, columns, options and horizon of a campaign.

    Raises:
        CampaignError: a line for each fault, with the file, the key and the allowed values.

    """
    if faults := _faults(config, spec):
        raise CampaignError(*(f"{source}: {fault}" for fault in faults))


def _faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    kinds = (
        _signal_faults,
        _disturbance_faults,
        _space_faults,
        _kernel_faults,
        _option_faults,
        _rollout_faults,
        _nominal_faults,
    )
    return [fault for faults in kinds for fault in faults(config, spec)]


def _signal_faults(config: CampaignConfig, spec: SystemSpec) -> Iterator[str]:
    shapes, declared = signal_shapes(config.space), spec.declared
    taken = [each.name for each in declared.parameters if each.signal]
    if not isinstance(config.space, dict):
        key = "scenarios" if isinstance(config.space, Scenarios) else "table"
        yield from (
            f"space.{key}: {spec.name} takes {name} as an input over time, which no list has; give a range per "
            f'parameter, and {name} = {{ signal = "pchip", knots = 5, low = ..., high = ... }}'
            for name in taken
        )
        return
    given = {each.name for each in shapes}
    for parameter in declared.parameters:
        name = parameter.name
        if parameter.signal and name in config.space and name not in given:
            yield (
                f"space.{name}.signal: this key is required: {spec.name} takes {name} as an input over time; give "
                "'pchip', 'linear' or 'constant', and knots"
            )
        elif name in given and not parameter.signal:
            yield (
                f"space.{name}.signal: {spec.name} takes {name} as a number; remove signal and knots, or declare it "
                "in the system: Parameter(..., signal=True)"
            )
    # The identity of a system does not depend on the knots: those of a stored one must be those of the campaign.
    if spec.signals and spec.signals != declared.spread(_shapes(config, spec)).signals:
        yield f"space: its input signals are not those of the stored {spec.name}; restore the database from a copy"


def _disturbance_faults(config: CampaignConfig, spec: SystemSpec) -> Iterator[str]:
    known = {each.name: each for each in spec.declared.disturbances}
    for name, law in config.disturbances.items():
        if name not in known:
            listed = f"{spec.name} has {', '.join(known)}" if known else f"{spec.name} declares none"
            yield f"disturbances.{name}: unknown disturbance; {meant(name, known)}{listed}"
        elif law.unit not in ("", known[name].unit):
            yield f"disturbances.{name}.unit: {law.unit!r} is not allowed: {spec.name} takes {known[name].unit!r}"
    laws = as_in_campaign(spec.declared, config).disturbances
    if config.control == "on":
        faults = map(_law_fault, spec.reported)
        yield from (f"reported.{fault}" for fault in faults if fault is not None)
    if searched(config) and not (laws and set(rolled_out(config.problems[0].name, spec)) & set(spec.declared.noisy)):
        yield f"falsify.over: no variant of {spec.name} that is simulated here has disturbances; remove this key"
    for law in laws:
        if (fault := _law_fault(law)) is not None:
            yield f"disturbances.{fault}"
        elif isinstance(config.space, dict) and law.name in config.space:
            yield from _bounded_faults(config, spec.declared, law, config.space[law.name])


def _law_fault(law: Disturbance) -> str | None:
    """Return what is wrong with the numbers of a law."""
    from ..draws.laws import check_law  # noqa: PLC0415  (late: scipy, and numpy for a system without any)

    try:
        check_law(law)
    except DefinitionError as error:
        return str(error)
    return None


def _bounded_faults(config: CampaignConfig, spec: SystemSpec, law: Disturbance, given: Range) -> Iterator[str]:
    """Yield what is wrong with the range of a disturbance."""
    where = f"space.{law.name}"
    drawing = [problem.method for problem in config.problems if draws_starts(problem.method)]
    if drawing:
        yield (
            f"{where}: method {drawing[0]!r} draws disturbances from their laws; remove this range, or choose "
            "'rigorous', 'kriging' or 'scenario' for a claim about every value in it"
        )
    elif law.choices is not None:
        yield (
            f"{where}: the law of {law.name} has choices, of which a range has no others; remove it here, or make it a "
            "parameter of the system"
        )
    elif given.signal is not None:
        yield f"{where}.signal: {law.name} is a disturbance, one number of a rollout; remove signal and knots"
    elif not any(set(rolled_out(problem.name, spec)) & set(spec.noisy) for problem in config.problems):
        # In the others each disturbance has its median, whatever the start.
        yield f"{where}: no variant that is simulated here has disturbances; remove this range"
    elif given.unit == SCORED:
        if not -MOST_SCORE <= given.low <= given.high <= MOST_SCORE:
            yield f"{where}: [{given.low:g}, {given.high:g}] sd is not allowed: allowed are at most {MOST_SCORE:g} sd"
    elif given.unit not in ("", law.unit):
        yield f"{where}.unit: {given.unit!r} is not allowed: {spec.name} takes {law.unit!r}, or 'sd' for scores"
    elif not (law.low is None or law.low <= given.low) or not (law.high is None or given.high <= law.high):
        yield f"{where}: [{given.low:g}, {given.high:g}] goes beyond the values of its law: {law.words}"


def _space_faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    if not isinstance(config.space, dict):
        return list(_row_faults(config.space, spec))
    known = {parameter.name: parameter for parameter in spec.declared.parameters}
    disturbances = {each.name for each in spec.disturbances}
    unknown = [name for name in config.space if name not in known and name not in disturbances]
    faults = [
        f"space.{name}: unknown parameter; {meant(name, [*known, *disturbances])}{spec.name} has {', '.join(known)}"
        for name in unknown
    ]
    misspelt = {nearest_name(name, known) for name in unknown}
    faults += [
        f"space.{name}: this parameter of {spec.name} is required"
        for name in known
        if name not in config.space and name not in misspelt
    ]
    for name, box in config.space.items():
        parameter = known.get(name)
        if parameter is None:
            continue
        if not parameter.low <= box.low <= box.high <= parameter.high:
            faults.append(
                f"space.{name}: [{box.low:g}, {box.high:g}] goes beyond {parameter.range_words}, the range of "
                f"{spec.name}"
            )
        if box.unit not in ("", parameter.unit):
            faults.append(f"space.{name}.unit: {box.unit!r} is not allowed: {spec.name} takes {parameter.unit!r}")
    return faults


def _row_faults(space: Scenarios | StartTable, spec: SystemSpec) -> Iterator[str]:
    names = [parameter.name for parameter in spec.parameters]
    key, entry = ("space.scenarios", "entry") if isinstance(space, Scenarios) else ("space.table", "row")
    for name, column in zip(names, space.header or names, strict=False):
        # Any other words are a comment; a name in the column of another parameter exchanges their values.
        if column != name and column in names:
            yield (
                f"{key}: the header has {column} in the column of {name}; sort the columns as {spec.name} takes them: "
                f"{', '.join(names)}"
            )
            return
    for number, row in enumerate(space.rows):
        if len(row) != len(names):
            yield f"{key}: {entry} {number} is {list(row)}; {spec.name} takes {', '.join(names)}"
            return
        for parameter, value in zip(spec.parameters, row, strict=True):
            if not parameter.low <= value <= parameter.high:
                yield (
                    f"{key}: {entry} {number}, {parameter.name} = {value:g} goes beyond "
                    f"{parameter.range_words}, the range of {spec.name}"
                )


def _kernel_faults(config: CampaignConfig, spec: SystemSpec) -> Iterator[str]:
    # Other parameters have lines already, and length scales that follow from them would repeat their names.
    declared = as_in_campaign(spec.declared, config)
    required = {*(each.name for each in spec.declared.parameters), *declared.as_parameters}
    if isinstance(config.space, dict) and config.space.keys() != required:
        return
    parameters = declared.parameters
    names = {parameter.name for parameter in parameters}
    for where, problem in _having(config, "kernel"):
        lengths = problem.kernel.length_scale if isinstance(problem, KernelProblem) else None
        if isinstance(lengths, dict) and lengths.keys() != names:
            given = ", ".join(lengths)
            wanted = ", ".join(parameter.name for parameter in parameters)
            yield f"{where}.length_scale: has {given}; give one number for each parameter of {spec.name}: {wanted}"


def _having(config: CampaignConfig, key: str) -> Iterator[tuple[str, Problem]]:
    """Yield each problem, and that of each requirement with its own value of a key, with the place of the key."""
    for problem in config.problems:
        yield f"problems.{problem.name}.{key}", problem
    for requirement, part in zip(config.specifications, parts_of(config), strict=False):
        if key in requirement.constants:
            yield f"specifications.{requirement.name}.{key}", part.problems[0]


def _option_faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    known = {option.name: option for option in spec.options}
    faults = []
    for name, value in config.system.options.items():
        option = known.get(name)
        if option is None:
            faults.append(f"system.{name}: {_unknown_option(name, spec)}")
        elif option.choices:
            if value not in option.choices:
                faults.append(f"system.{name}: {value!r} is not allowed: choose from {', '.join(option.choices)}")
        elif not isinstance(value, int | float) or not _in_limits(value, option.low, option.high):
            faults.append(f"system.{name}: {value!r} is not allowed: allowed is {option.allowed_numbers}")
    return faults


def _unknown_option(name: str, spec: SystemSpec) -> str:
    """Return why a key of `[system]` is no option of its system, and what to do."""
    if name in CampaignConfig.model_fields:
        return f"put the key `{name}` of the campaign above the first [table]"
    known = [option.name for option in spec.options]
    if not known:
        return f"unknown key; {spec.name} has no options, which a function takes as keywords with a default"
    return f"unknown key; {meant(name, known)}allowed for {spec.name} are {', '.join(['name', *known])}"


def _in_limits(value: float, low: float | None, high: float | None) -> bool:
    return (low is None or low <= value) and (high is None or value <= high)


def _claim_faults(config: CampaignConfig, problem: Problem, *, noisy: bool) -> Iterator[str]:
    """Yield what a claim about most starts lacks: where values are noisy it is one of means, else one of a quantile."""
    for claim in config.claims_of(problem):
        if claim.asked.quantity != "share_of_starts":
            continue
        where, tests = f"claims.{drawn_claims(config.claims).index(claim.asked)}", config.max_tests_of(problem)
        if (noisy or config.at_every_moment) and config.clip is None:
            yield f"clip: required by {where}, the bound of a mean: give [low, high]"
        elif not noisy and tests < (least := fewest_samples(claim)):
            yield f"max_tests: {where} needs at least {least} samples, not {tests}"


def _nominal_faults(config: CampaignConfig, spec: SystemSpec) -> Iterator[str]:
    known = {parameter.name: parameter for parameter in as_in_campaign(spec, config).parameters}
    for name, value in (config.falsify.nominal if config.falsify else {}).items():
        if name not in known:
            yield f"falsify.nominal.{name}: unknown parameter; {meant(name, known)}{spec.name} has {', '.join(known)}"
        elif not known[name].low <= value <= known[name].high:
            yield (f"falsify.nominal.{name}: {value:g} goes beyond {known[name].range_words}, the range of {spec.name}")


def _rollout_faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    # Where every disturbance is bounded, no variant may be noisy.
    spec, faults = as_in_campaign(spec, config), []
    columns = [column.name for column in spec.columns]
    if spec.repeated == "nowhere" and config.recheck > 0:
        faults.append(f"recheck: {config.recheck} is not allowed: no rollout of {spec.name} can be repeated; give 0")
    if config.horizon > spec.max_horizon:
        faults.append(f"horizon: {config.horizon:g} s is more than the {spec.max_horizon:g} s of {spec.name}")
    if config.horizon == 0 and spec.timed:
        faults.append(f"horizon: this key is required: {spec.name} takes the duration of a rollout, in s")
    for problem in config.problems:
        variants = set(rolled_out(problem.name, spec))
        missing = variants - set(spec.variants)
        if missing:
            faults.append(f"problems.{problem.name}: {spec.name} has no variant {', '.join(sorted(missing))}")
        noisy = variants & set(spec.noisy)
        faults += _claim_faults(config, problem, noisy=bool(noisy))
        gap = config.gap_of(problem)
        if gap is not None and gap.kind != "robustness" and spec.after_end == "fail":
            faults.append(
                f"problems.{problem.name}.gap.kind: {gap.kind!r} bounds no difference of rollouts of {spec.name}, of "
                'which one may end early and fail; use kind = "robustness", or after_end = "hold"'
            )
    for where, problem in _having(config, "noise_scale"):
        noisy = set(rolled_out(problem.name, spec)) & set(spec.noisy)
        if isinstance(problem, RigorousProblem) and problem.noise_scale == 0 and noisy:
            faults.append(
                f"{where}: 0 has no meaning for the {' and '.join(sorted(noisy))} variant "
                f"of {spec.name}, whose rollouts depend on the seed: allowed is 'derived' or a number > 0"
            )
    chosen = {"gap.column": config.gap.column if config.gap else None}
    for problem in config.problems:
        chosen[f"problems.{problem.name}.gap.column"] = problem.gap.column if problem.gap else None
        chosen[f"problems.{problem.name}.column"] = problem.column
    for key, column in chosen.items():
        if column is not None and column not in columns:
            faults.append(f"{key}: no column {column!r}; {meant(column, columns)}{spec.name} has {', '.join(columns)}")
    return faults
