"""Which keys of a campaign go together: every rule that two of them or more have to keep."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from .composition import PAIR, ComposedClaim, Rule, composed_claims
from .drawn_claims import SAMPLED, UP_TO_CHANCE, ClaimRequest, DrawnClaim, drawn_claims, fewest_samples
from .keys import CampaignKeys
from .logs import RecordedTest
from .method_spaces import (
    LATTICE_PARAMETERS,
    check_lattice,
    check_region,
    check_space,
    check_starts,
    check_unlisted,
    draws_starts,
)
from .objectives import CLAIMS, OBJECTIVES, OF_ROBUSTNESS, ProblemName, Sense, any_of
from .parameters import Range, check_signals, parameter_ranges
from .parts import parts_of
from .problem_models import KrigingProblem, Problem, RigorousProblem, SampleProblem
from .space import Scenarios, space_kind

ORDERED = {"quantile", "next_rollout"}
"""Quantities that are bounded by one of the values, so that few samples have no bound at all."""


class InconsistentKeysError(ValueError):
    """Keys that do not go together; `lines` has one for each fault, with the key and the remedy."""

    def __init__(self, lines: Sequence[str]) -> None:
        self.lines = tuple(lines)
        super().__init__("\n".join(lines))


def check_consistent(config: CampaignKeys) -> None:
    """Refuse keys that do not go together.

    Raises:
        InconsistentKeysError: a line for each fault, with the key and the remedy.

    """
    # A rule may rely on those of the steps before its own.
    for step in (_rules_of_keys, _rules_of_problems, _rules_of_claims):
        faults: dict[str, str] = {}
        for check in step(config):
            try:
                check()
            except ValueError as error:
                # Several rules may need one key: it is given once.
                faults.setdefault(str(error).partition(":")[0], str(error))
        if faults:
            raise InconsistentKeysError(tuple(faults.values()))


def _rules_of_keys(config: CampaignKeys) -> Iterator[Callable[[], None]]:
    """Yield the rules of single keys, on which those of several keys rely."""
    yield partial(_check_repeated, config)
    yield partial(_check_keep, config)
    yield partial(_check_clip_order, config)
    yield partial(_check_required, config)
    yield partial(check_signals, config.space, config.horizon)
    yield partial(_check_recorded, config)


def _rules_of_problems(config: CampaignKeys) -> Iterator[Callable[[], None]]:
    """Yield the rules of each problem."""
    for problem in config.problems:
        yield partial(_check_objective, config, problem)
        yield partial(_check_method, config, problem)


def _rules_of_claims(config: CampaignKeys) -> Iterator[Callable[[], None]]:
    """Yield the rules of all problems together, and of what is claimed."""
    if config.may_end_early:
        yield partial(_check_until_counterexample, config, config.problems[0])
    if config.anytime:
        yield partial(_check_anytime, config)
    if config.falsify is not None and config.falsify.over == "disturbances":
        yield partial(_check_over, config, config.problems[0])
    if config.falsify is not None and config.falsify.scale is not None:
        yield partial(_check_scale, config)
    if config.on_refuted == "stop":
        yield partial(_check_on_refuted, config)
    if config.regions:
        yield partial(check_regions, config)
    yield partial(check_composition, config)
    if config.specifications:
        yield partial(_check_specifications, config)
    yield partial(_check_beyond, config)
    yield partial(_check_claims, config)
    yield partial(_check_required_side, config)


def _check_repeated(config: CampaignKeys) -> None:
    names = [problem.name for problem in config.problems]
    for repeated in {name for name in names if names.count(name) > 1}:
        raise ValueError(f"problems: {repeated!r} appears twice; list every problem at most once")


def _check_keep(config: CampaignKeys) -> None:
    """Refuse to reduce rollouts to their robustness where that is not all that a test, or a bound, needs of them."""
    if config.keep == "all":
        return
    if config.batch == 1:
        raise ValueError("keep: what is left of rollouts is packed by batch; give `batch` above 1, or remove this key")
    for problem in config.problems:
        if OBJECTIVES[problem.name].measured != "robustness" or problem.method == "paper" or config.specifications:
            raise ValueError(
                "keep: only where a test needs the robustness of its rollouts alone, so not with several "
                "specifications, a gap, a column or method 'paper'; remove this key"
            )


def _check_required(config: CampaignKeys) -> None:
    """Refuse a margin that no clipped value can have; the default one is that of campaigns from before it existed."""
    if config.required_margin and config.clip is not None and config.required_margin >= config.clip[1]:
        raise ValueError(
            f"required_margin: {config.required_margin:g} is not below the upper clip {config.clip[1]:g}, which no "
            "clipped robustness exceeds; choose a wider clip"
        )


def _check_required_side(config: CampaignKeys) -> None:
    """Refuse a requirement that the verdict would pass over: that of a bound from the other side."""
    if _first_sense(config) == "min":
        key, side, instead, given = "required_at_most", "below", "required_margin", config.required_at_most is not None
    else:
        key, side, instead, given = "required_margin", "above", "required_at_most", config.required_margin != 0
        _check_probability(config)
    if given:
        raise ValueError(f"{key}: the first claim is a bound from {side}; remove this key, or give {instead}")


def _check_probability(config: CampaignKeys) -> None:
    """Refuse a probability that every system keeps, or none: one in percent, mostly."""
    most, claims = config.required_at_most, [claim for each in config.problems for claim in config.claims_of(each)]
    if most is None or 0.0 < most < 1.0 or not claims or claims[0].asked.quantity != "failure_probability":
        return
    percent = f"; {most:g} % is {most / 100:g}" if 1.0 <= most < 100.0 else ""
    raise ValueError(f"required_at_most: {most:g} is no probability between 0 and 1{percent}")


def _first_sense(config: CampaignKeys) -> Sense:
    """Return the side of the first claim, that of a minimum or of a maximum."""
    composed = composed_claims(config.claims)
    rule, name = (composed[0].rule, composed[0].problems[0]) if composed else (config.composition, None)
    if rule != "single":  # about a robustness risk
        return "min"
    problem = next((each for each in config.problems if each.name == name), config.problems[0])
    return config.sense_of(problem)


def _check_clip_order(config: CampaignKeys) -> None:
    if config.clip is not None and not config.clip[0] < config.clip[1]:
        raise ValueError(f"clip: {list(config.clip)} must be [low, high] with low < high")


def _check_objective(config: CampaignKeys, problem: Problem) -> None:
    objective = OBJECTIVES[problem.name]
    if objective.measured != "column":
        if config.formula is None:
            raise ValueError(f"specification: required by problem {problem.name!r}")
        if config.clip is None:
            _check_unclipped(problem)
    if config.horizon == 0 and not objective.static:
        raise ValueError(f"horizon: problem {problem.name!r} needs a rollout longer than 0 s")
    if objective.measured == "gap" and config.gap_of(problem) is None:
        raise ValueError('gap: required by problem \'sim_gap\', e.g. { kind = "signal_sup", column = "phi" }')


def _check_anytime(config: CampaignKeys) -> None:
    if not any(isinstance(problem, SampleProblem) for problem in config.problems):
        raise ValueError(
            "anytime: only for method 'sample'; the bounds of 'rigorous' and 'scenario' hold after every test anyway; "
            "remove this key"
        )


def _check_until_counterexample(config: CampaignKeys, problem: Problem) -> None:
    if config.until_counterexample and config.falsify is not None and config.falsify.until != "counterexample":
        raise ValueError(
            f"until_counterexample: falsify.until = {config.falsify.until!r} ends later; remove one of them"
        )
    if len(config.problems) > 1 or problem.name not in OF_ROBUSTNESS:
        raise ValueError(
            f"until_counterexample: only for one problem, {any_of(OF_ROBUSTNESS)}; remove this key, or the other "
            "problems"
        )
    if problem.method == "paper":
        raise ValueError(
            "until_counterexample: method 'paper' has no bound at a test that depends on the outcomes; choose "
            "'rigorous' or 'scenario'"
        )
    if config.clip is not None and config.clip[0] >= 0:
        raise ValueError(
            f"clip: {list(config.clip)} must begin below 0 with until_counterexample, or it hides every violation"
        )


def _check_scale(config: CampaignKeys) -> None:
    """Refuse a scale of the parts of a specification where no parts are recorded."""
    if config.batch > 1:
        raise ValueError("falsify.scale: not with batch, of which only the robustness is recorded; remove one of them")


def _check_over(config: CampaignKeys, problem: Problem) -> None:
    """Refuse a search over disturbances whose tests would enter a bound: there they are no sample of their law."""
    if problem.method != "sample":
        raise ValueError(
            f"falsify.over: not for method {problem.method!r}, whose bound takes every test of a search; choose method "
            "'sample', or give disturbances ranges under [space], such as gust = \"within 3 sd\""
        )
    if not isinstance(config.space, dict):
        raise ValueError("falsify.over: a table of starts has no disturbances; give a range per parameter instead")
    if config.replicates_of(problem) > 1:
        raise ValueError(
            "falsify.over: each test has its own disturbances, and so one rollout; remove replicates, or `over`"
        )
    for number, asked in enumerate(drawn_claims(config.claims)):
        if asked.quantity == "share_of_starts":
            raise ValueError(
                f"claims.{number}: an expected robustness needs several rollouts of a start, and with falsify.over "
                "each has disturbances of its own; remove one of the two"
            )


def _check_on_refuted(config: CampaignKeys) -> None:
    """Refuse a stop that depends on outcomes where a bound holds after a number of tests that is fixed beforehand."""
    fixed = [each for each in config.problems if each.method not in ("rigorous", "scenario")]
    if fixed:
        raise ValueError(
            f"on_refuted: 'stop' is not for method {fixed[0].method!r}, whose bound holds at a number of tests that no "
            "outcome decides; remove this key, or choose 'rigorous' or 'scenario'"
        )


def _check_unclipped(problem: Problem) -> None:
    """Refuse a robustness without a range where a mean, or a difference, has to be bounded."""
    if not OBJECTIVES[problem.name].static:
        raise ValueError(f"clip: required by problem {problem.name!r}")
    if isinstance(problem, SampleProblem):
        return  # its claims decide: most of them are about values of any range
    # Without noise an observation is the value itself, and no mean of a bounded variable.
    if not isinstance(problem, RigorousProblem) or problem.noise_scale != 0:
        raise ValueError(
            f"clip: required by problem {problem.name!r} with noise; give [low, high], or choose method 'rigorous' "
            "with noise_scale = 0 for rollouts that do not depend on the seed"
        )


def _check_method(config: CampaignKeys, problem: Problem) -> None:
    where = f"problems.{problem.name}"
    if config.candidates is not None:
        check_starts(problem.method, config.space, config.candidates)
    check_space(problem.method, config.space, where)
    if isinstance(config.space, dict) and config.starts_of(problem) is None and not draws_starts(problem.method):
        check_unlisted(problem.name, problem.method, where, region=config.where is not None)
        resolution = config.resolution_of(problem)
        check_lattice(problem.name, problem.method, config.space, resolution, where, regions=config.regions)
    if config.where is not None:
        check_region(problem.method, config.space)
    if isinstance(problem, KrigingProblem):
        _check_design(config, problem, where)
    if problem.method == "paper":
        if OBJECTIVES[problem.name].risk and config.replicates_of(problem) < 2:
            raise ValueError(f"{where}.replicates: a standard deviation needs at least 2 rollouts a test")
        if config.window_of(problem) != 1:
            raise ValueError(f"{where}.window: Algorithm 1 is sequential, method 'paper' allows 1 only")
        if config.max_tests_of(problem) < 2:
            raise ValueError(f"{where}.max_tests: method 'paper' gives no bound before the second test")


def _check_design(config: CampaignKeys, problem: KrigingProblem, where: str) -> None:
    """Refuse what a design cannot be planned for."""
    if config.falsify is not None:
        raise ValueError(
            "falsify: method 'kriging' plans every start beforehand; remove this key, or choose 'rigorous'"
        )
    if problem.points is None or not isinstance(config.space, dict):
        return
    resolution = config.resolution_of(problem)
    if len(parameter_ranges(config.space)) > LATTICE_PARAMETERS:
        raise ValueError(
            f"{where}.points: only for at most {LATTICE_PARAMETERS} parameters, whose starts are a grid; remove it"
        )
    if problem.points > resolution:
        raise ValueError(f"{where}.points: {problem.points} is more than the {resolution} nodes per parameter")


def _check_beyond(config: CampaignKeys) -> None:
    if config.beyond != "refuse" and config.formula is None:
        raise ValueError("beyond: is about the windows of a specification, and there is none; remove this key")


def _check_specifications(config: CampaignKeys) -> None:
    names = [each.name for each in config.specifications]
    for repeated in {name for name in names if names.count(name) > 1}:
        raise ValueError(f"specifications: {repeated!r} appears twice; give each its own name")
    if config.specification is not None:
        raise ValueError("specification: not allowed beside specifications; give it a name there")
    problem = config.problems[0]
    join = "join them with `and` in `specification`"
    if len(config.problems) > 1 or problem.name not in OF_ROBUSTNESS:
        raise ValueError(f"specifications: only for one problem, {any_of(OF_ROBUSTNESS)}; {join}")
    if problem.method == "paper":
        raise ValueError(f"specifications: Algorithm 1 chooses every test by its own bound; {join}")
    if config.regions:
        raise ValueError(f"regions: divides the box by one specification; {join}, or remove this key")
    for each in config.specifications:
        if isinstance(problem, SampleProblem) and each.constants:
            key = next(iter(each.constants))
            raise ValueError(f"specifications.{each.name}.{key}: has no meaning in method 'sample'; remove this key")
    for part in parts_of(config):
        _check_objective(part, part.problems[0])


def _check_claims(config: CampaignKeys) -> None:
    sampled = [problem for problem in config.problems if isinstance(problem, SampleProblem)]
    drawn = drawn_claims(config.claims)
    if drawn and not sampled:
        raise ValueError("claims: only method 'sample' claims anything of drawn starts; choose it, or remove this")
    for number, asked in enumerate(drawn):
        _check_asked(config, f"claims.{number}", asked, sampled[0])
        if asked in drawn[:number]:
            raise ValueError(f"claims.{number}: is there twice; list every claim once")
    for problem in sampled:
        for claim in config.claims_of(problem):
            _check_number(config, claim, problem)
    if sampled and config.clip is not None and config.clip[0] >= 0:
        raise ValueError(f"clip: {list(config.clip)} must begin below 0, or it hides every violation")


def _check_asked(config: CampaignKeys, where: str, claim: ClaimRequest, problem: SampleProblem) -> None:
    if config.clip is None and SAMPLED[claim.quantity].clip:
        raise ValueError(f"clip: required by {where}, the bound of a mean: give [low, high]")
    if problem.jointly and (claim.delta or claim.quantity in UP_TO_CHANCE):
        raise ValueError(f"jointly: {where} has a failure probability of its own; remove one of the two")
    if not config.at_every_moment:
        return
    # The number of samples depends on the outcomes.
    cause = next(key for key in ("anytime", "until_counterexample", "falsify") if getattr(config, key))
    if claim.quantity in UP_TO_CHANCE:
        raise ValueError(
            f"{where}.quantity: {claim.quantity!r} needs a number of samples that is fixed beforehand; remove this "
            f"claim, or {cause}"
        )
    if claim.quantity in ORDERED and config.clip is None:
        raise ValueError(f"clip: required by {where} with {cause}: give [low, high]")


def _check_number(config: CampaignKeys, claim: DrawnClaim, problem: SampleProblem) -> None:
    # A bound that is valid after every sample begins at the clip.
    if claim.asked.quantity not in ORDERED or config.at_every_moment:
        return
    least, tests = fewest_samples(claim), config.max_tests_of(problem)
    if tests < least:
        number = drawn_claims(config.claims).index(claim.asked)
        raise ValueError(
            f"max_tests: claims.{number} needs at least {least} samples, not {tests}; raise it or the level"
        )


def check_composition(config: CampaignKeys) -> None:
    """Refuse a rule that the problems or their methods have no bound for.

    Raises:
        ValueError: one line with the key and the remedy.

    """
    composed = composed_claims(config.claims)
    if composed:
        if len(composed) < len(config.claims):
            raise ValueError("claims: of drawn starts, or by a rule, not both in one campaign")
        if config.specifications or any(problem.method == "sample" for problem in config.problems):
            raise ValueError("claims: a rule is for methods that bound a worst start, and for one specification")
        if config.composition != "single":
            raise ValueError("composition: is short for one entry of [[claims]]; remove one of the two")
        _check_composed(config, composed)
        return
    names = tuple(problem.name for problem in config.problems)
    if config.composition == "single":
        if len(names) != 1:
            raise ValueError("composition: 'single' is for one problem; allowed here: 'product', 'sum'")
        _check_single(names, "composition")
        return
    if not set(PAIR) <= set(names):
        raise ValueError(f"composition: {config.composition!r} needs the problems {' and '.join(map(repr, PAIR))}")
    _check_rule(config, config.composition, "composition")


def _check_composed(config: CampaignKeys, composed: Sequence[ComposedClaim]) -> None:
    names = [problem.name for problem in config.problems]
    for number, claim in enumerate(composed):
        where = f"claims.{number}"
        if claim in composed[:number]:
            raise ValueError(f"{where}: is there twice; list every claim once")
        for name in claim.problems:
            if name not in names:
                raise ValueError(f"{where}.problems: no problem {name!r} here; choose of {', '.join(names)}")
        if claim.rule == "single":
            if len(claim.problems) != 1:
                raise ValueError(f"{where}.problems: rule 'single' is for one problem")
            _check_single(claim.problems, f"{where}.rule")
        elif claim.problems != PAIR:
            pair = " and ".join(PAIR)
            raise ValueError(f"{where}.problems: rule {claim.rule!r} is for {pair}; name both, or take rule 'single'")
        else:
            _check_rule(config, claim.rule, f"{where}.rule")
    for name in names:
        if all(name not in claim.problems for claim in composed):
            raise ValueError(f"claims: none uses the problem {name!r}; add one, or remove the problem")


def _check_single(names: tuple[ProblemName, ...], where: str) -> None:
    if set(names) & set(PAIR):
        raise ValueError(f"{where}: 'single' makes a claim of {any_of(CLAIMS)} only")


def _check_rule(config: CampaignKeys, rule: Rule, where: str) -> None:
    pair: list[Problem] = [problem for problem in config.problems if problem.name in PAIR]
    methods = {problem.method for problem in pair}
    if rule == "product" and methods != {"paper"}:
        raise ValueError(f"{where}: 'product' is for method 'paper'; 'sum' holds for every method")
    if rule == "pointwise" and methods != {"rigorous"}:
        raise ValueError(f"{where}: {rule!r} needs method 'rigorous' in both problems")
    if rule == "bhatia-davis" and "paper" in methods:
        raise ValueError(f"{where}: {rule!r} is not for method 'paper'; choose 'rigorous' in both problems")
    if rule == "pointwise" and len({config.resolution_of(problem) for problem in pair}) != 1:
        raise ValueError(f"{where}: 'pointwise' needs one resolution for both problems")


def check_regions(config: CampaignKeys) -> None:
    """Refuse a campaign whose box cannot be divided into regions.

    Raises:
        ValueError: one line with the key and the remedy.

    """
    first, clip = config.problems[0], config.clip
    if len(config.problems) > 1 or first.name not in OF_ROBUSTNESS:
        raise ValueError(
            f"regions: only for one problem, {any_of(OF_ROBUSTNESS)}; remove this key, or the other problems"
        )
    # Only this method has one band that is true at all starts at once, and between the nodes.
    if first.method != "rigorous":
        raise ValueError(
            f"regions: method {first.method!r} has no band that holds at all starts of a box at once; choose 'rigorous'"
        )
    if space_kind(config.space) != "box":
        raise ValueError("regions: a list of starts has no regions; give low and high per parameter under [space]")
    if config.where is not None or config.starts_of(first) is not None:
        given = " and ".join(f"`{key}`" for key in ("where", "candidates") if getattr(config, key) is not None)
        raise ValueError(f"regions: only a whole box with a lattice is divided; remove {given}")
    if clip is not None and not clip[0] < 0 < clip[1]:
        raise ValueError(f"clip: {list(clip)} must contain 0 inside with regions, or it decides the sign everywhere")


def _check_recorded(config: CampaignKeys) -> None:
    """Refuse imported tests where something else than the logs would have to decide which tests there are.

    Raises:
        ValueError: the key, and what it cannot be.

    """
    tests = config.recorded
    if not tests:
        return
    if config.system.kind != "rig":
        raise ValueError('recorded: logs are imported for a rig alone; give [system] rig = "NAME"')
    for problem in config.problems:
        if problem.method != "sample":
            raise ValueError(
                f"method: {problem.method!r} chooses its starts, and logs have theirs; "
                'give method = "sample", or ask for the tests by ask_tell'
            )
        size = config.max_tests_of(problem)
        if size != len(tests):
            raise ValueError(
                f"max_tests: {size:,} is not allowed: there are {len(tests):,} logs, and to leave some out would be a "
                "choice; remove this key"
            )
    for key in ("falsify", "until_counterexample", "anytime"):
        if getattr(config, key):
            raise ValueError(f"{key}: all logs are there before the first one is read; remove this key")
    if config.replicates != 1:
        raise ValueError("replicates: a log is one rollout; remove this key")
    if isinstance(config.space, dict):
        for number, each in enumerate(tests, start=1):
            _check_start(each, number, parameter_ranges(config.space))
    elif isinstance(config.space, Scenarios):
        raise ValueError("space.scenarios: the starts of logs follow a law; give ranges, or a table of starts")


def _check_start(test: RecordedTest, number: int, ranges: Mapping[str, Range]) -> None:
    if test.start.keys() != ranges.keys():
        raise ValueError(f"recorded: {test.log}: {', '.join(test.start)} in place of {', '.join(ranges)}")
    for name, box in ranges.items():
        value = test.start[name]
        if not box.low <= value <= box.high:
            raise ValueError(
                f"space.{name}: test {number}, {test.log}, was driven from {value:g}, outside [{box.low:g}, "
                f"{box.high:g}]; a start that the law does not have shows that it is another law"
            )
