"""Environments of Gymnasium as systems under test: one step of the environment is one sample.

| symbol | name      | meaning                                                        | shape | unit      |
|--------|-----------|----------------------------------------------------------------|-------|-----------|
| x      | `start`   | the parameters, by their names                                 |       | of each   |
| h      | `step`    | time of one step of the environment                            | ()    | s         |
|        | `row`     | the recorded numbers of one sample: observation, reward, info  | (n,)  | of each   |

A parameter is set where its name is found: an argument of the function `reset` beside the policy; else an attribute of
the environment, before and after its reset; else a key of its `config`, or an option, for its reset.
"""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from numbers import Real
from pathlib import Path
from typing import Any, SupportsFloat, TypeGuard

import numpy as np

from ...schemas.errors import DefinitionError, SimulationError, meant, shortened
from ...schemas.file.config import CampaignConfig
from ...schemas.file.space import SystemChoice
from ...schemas.system import ENDED, OptionValue, SystemSpec, Variant, timed_columns
from ...schemas.system_check import Acts
from ...schemas.trajectory.trajectory import Trajectory
from ..faults import fault_text, missing
from .base import Floats, Progress, SystemUnderTest, checked_options
from .declared import DeclaredFiles, WithSpec, declared_files
from .described import (
    DescribedSystem,
    blaming,
    check_horizon,
    check_whole,
    fixed_option,
    name_of,
    of_campaign,
    placed,
    space_parameters,
    steps_within,
)
from .files import code_beside, import_beside
from .fingerprint import versions_of
from .policy import Policy, load_policy

MAX_STEPS = 10_000_000
SEED_BITS = 32
"""Of a seed: environments in C take no larger ones."""
TRIED = 20
"""Steps in which a parameter that is an option has to show an effect."""


class Environment:
    """An environment that was made once, with its policy: it runs episodes."""

    def __init__(self, env: Any, policy: Policy, names: Sequence[str], where: str) -> None:
        self.env, self._policy, self._where, self._parameters = env, policy, where, tuple(names)
        if policy.start is not None:
            self._check_start(policy.start)
        self.observed = tuple(_names(env.observation_space))
        """The names of the numbers of an observation."""
        self._setters = {name: self._setter(name) for name in names}
        self.outside = ""
        """The first action of the last episode outside the limits of the environment, in words."""

    def _check_start(self, start: Callable[..., Any]) -> None:
        """Refuse a function `reset` that does not take what it is called with, where Python knows it."""
        with suppress(ValueError):  # of some that are not written in Python
            try:
                inspect.signature(start).bind(self.env, seed=0, **dict.fromkeys(self._parameters, 0.0))
            except TypeError as error:
                raise DefinitionError(
                    f"{self._policy.path}: reset is called with every parameter, {self._arguments}: {error}"
                ) from None

    @property
    def _arguments(self) -> str:
        return f"reset(env, *, seed, {', '.join(self._parameters)})"

    def _setter(self, name: str) -> str:
        """Return where a parameter is set; refuse an attribute that is no number."""
        if self._policy.start is not None:
            return "start"
        base = self.env.unwrapped
        if not hasattr(base, name):
            return "config" if name in _config(base) else "option"
        if not _is_number(value := getattr(base, name)):
            raise DefinitionError(
                f"{self._where}: space: {name} is an attribute of the environment, and {type(value).__name__} "
                f"and no number; {self._write_reset()}"
            )
        return "attribute"

    @property
    def whole(self) -> Iterator[str]:
        """Yield the names of the parameters that are set as integers."""
        base = self.env.unwrapped
        for name, kind in self._setters.items():
            if _is_whole(getattr(base, name) if kind == "attribute" else _config(base).get(name)):
                yield name

    def seen(self, observation: Any) -> list[float]:
        """Return the numbers of an observation, in the order of `observed`."""
        return list(_numbers(self.env.observation_space, observation))

    def check_effect(self, lows: Mapping[str, float], highs: Mapping[str, float]) -> None:
        """Refuse an option that changes nothing, which is one that the environment does not read.

        Raises:
            DefinitionError: with its name.

        """
        options = [name for name, kind in self._setters.items() if kind == "option"]
        before = self._first_steps(lows) if options else np.empty(0)
        for name in options:
            if np.array_equal(before, self._first_steps({**lows, name: highs[name]}), equal_nan=True):
                base = self.env.unwrapped
                near = meant(name, [each for each in vars(base) if _is_number(getattr(base, each))])
                raise DefinitionError(
                    f"{self._where}: space: {near}the environment has no attribute {name}, and "
                    f"reset(options={{{name!r}: ...}}) changes nothing in {TRIED} steps; {self._write_reset()}"
                )

    def _first_steps(self, start: Mapping[str, float]) -> Floats:
        """Return the observations and rewards of the first steps, with one seed."""
        return np.array([[*self.seen(seen), reward] for seen, reward, *_ in self.episode(start, 0, TRIED)])

    def episode(
        self, start: Mapping[str, float], seed: int, steps: int
    ) -> Iterator[tuple[Any, float, bool, Mapping[str, Any]]]:
        """Yield observation, reward, whether the episode has ended, and info: at 0 and after every step."""
        observation, info = self._begun(start, seed)
        self.outside = ""
        if self._policy.reset is not None:
            self._policy.reset()
        ended = False
        yield observation, 0.0, ended, info
        for _ in range(steps):
            action = self._checked(self._policy.act(observation))
            try:
                # A limit of steps is none here: the horizon is.
                observation, reward, terminated, _truncated, info = self.env.step(action)
            except Exception as error:
                if not ended:
                    raise
                raise SimulationError(
                    f"after the end of its episode the environment cannot be stepped on: {fault_text(error)}; say what "
                    'an early end means: after_end = "hold" or "fail"'
                ) from None
            ended = ended or bool(terminated)
            yield observation, float(reward), ended, info

    def _checked(self, action: Any) -> Any:
        """Return an action, if it is one: many environments take the first number of another array, or NaN."""
        space = self.env.action_space
        if hasattr(space, "low"):  # within its limits or not, which many an environment clips
            found = np.asarray(action)
            fits = found.shape == space.shape and found.dtype.kind in "fiub" and bool(np.isfinite(found).all())
            if fits and not self.outside and _beyond(space, found):
                self.outside = f"{self._policy.path.name} returned {shortened(repr(action))}, outside {space}"
        else:
            fits = space.contains(action)
        if not fits:
            shaped = f"; return an array of the shape {space.shape}" if hasattr(space, "low") else ""
            raise SimulationError(
                f"{self._policy.path.name} returned {shortened(repr(action))}, and an action is one of {space}{shaped}"
            )
        return action

    def _begun(self, start: Mapping[str, float], seed: int) -> tuple[Any, Mapping[str, Any]]:
        env, base = self.env, self.env.unwrapped
        # Some environments draw an action at their reset, and no seed of theirs reaches this.
        env.action_space.seed(seed)
        of = {kind: {n: v for n, v in start.items() if self._setters[n] == kind} for kind in self._setters.values()}
        if self._policy.start is not None:
            found = self._policy.start(env, seed=seed, **start)
            if not (isinstance(found, tuple) and len(found) == 2):
                raise SimulationError(
                    f"{self._policy.path}: reset returns {type(found).__name__}, not observation and info, as "
                    "env.reset(seed=seed) does"
                )
            return found
        options: dict[str, Any] = dict(of.get("option", {}))
        if config := of.get("config"):
            known = _config(base)
            options["config"] = {name: _like(known[name], value) for name, value in config.items()}
        attributes = {name: _like(getattr(base, name), value) for name, value in of.get("attribute", {}).items()}
        # Before the reset, too: what it observes may follow from them, and is none of the rollout before.
        for name, value in attributes.items():
            setattr(base, name, value)
        observation, info = env.reset(seed=seed, options=options or None)
        for name, value in attributes.items():
            setattr(base, name, value)
        return observation, info

    def _write_reset(self) -> str:
        path, wanted = self._policy.path, f"a function {self._arguments} that starts an episode"
        if path.suffix == ".py":
            return f"write {wanted} in {path.name}"
        return f"write {wanted} in a policy.py, with a class that loads {path.name}, and files = [{path.name!r}]"


class EnvironmentSystem(DescribedSystem):
    """An environment with its policy."""

    def __init__(self, spec: SystemSpec, environment: Environment, step: float, recorded: Sequence[str]) -> None:
        super().__init__(spec)
        self._environment, self._step = environment, step
        self._recorded = recorded
        """The name in the environment of each own column, without the time."""

    def rollout(
        self,
        x: Sequence[Any],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
    ) -> Trajectory:
        """Run an episode.

        Raises:
            SimulationError: an argument is outside the spec, or the environment fails.
            Cancelled: raised by `progress`.

        """
        checked_options(self._spec, x, variant=variant, horizon=horizon, options=options)
        steps = steps_within(horizon, self._step, self._spec.name)
        names = (each.name for each in self._spec.parameters)
        episode = self._environment.episode(dict(zip(names, map(float, x), strict=True)), seed, steps)
        rows = list[list[Any]]()
        for number, (observation, reward, ended, info) in enumerate(episode):
            rows.append(self._row(number, observation, reward, ended, info))
            if ended and self._spec.after_end is not None:
                break
            progress(number)
        # What only a step gives is at 0 what it is after the first one.
        rows[0] = [after if here is None else here for here, after in zip(rows[0], rows[1], strict=True)]
        return Trajectory(self._spec.own_columns, np.array(rows, dtype=np.float64))

    def acted(self) -> Acts:
        """Return whether an action of the last rollout was outside the limits of the environment."""
        return Acts(outside=self._environment.outside)

    def _row(self, number: int, observation: Any, reward: float, ended: bool, info: Mapping[str, Any]) -> list[Any]:
        environment = self._environment
        known: dict[str, Any] = dict(zip(environment.observed, environment.seen(observation), strict=True))
        known |= {"reward": reward, ENDED.name: float(ended)}
        row: list[Any] = [number * self._step]
        for name in self._recorded:
            value = known.get(name, info.get(name))
            if value is None and number:
                raise SimulationError(f"{self._spec.name}: info has no number {name!r} after step {number}")
            row.append(None if value is None else float(value))
        return row


def _beyond(space: Any, action: Any) -> bool:
    """Whether a number of an action is beyond its limits, in their precision: 0.7 is not above that of float32."""
    numbers = action.astype(space.dtype) if space.dtype.kind == "f" else action
    return bool(((numbers < space.low) | (numbers > space.high)).any())


def load_environment(file: Path, config: CampaignConfig) -> SystemUnderTest:
    """Return the environment of a campaign, read from `file`.

    Raises:
        DefinitionError: Gymnasium or the environment is not installed, it cannot be made, a name in the file is none,
            or nothing says how long a step is.

    """
    choice, folder = config.system, file.absolute().parent
    assert choice.gymnasium is not None, "of an environment"
    assert choice.policy is not None, "required by an environment"
    try:
        import gymnasium  # noqa: PLC0415  (an extra)
    except ImportError:
        raise DefinitionError(f"{file}: system.gymnasium: gymnasium is not installed; {missing('gymnasium')}") from None
    # It says at every rollout that an episode has ended, which is what `ended` is for.
    gymnasium.logger.min_level = gymnasium.logger.ERROR
    where, environment_id = str(file), choice.gymnasium
    with placed(f"{where}: system.policy"):
        policy = load_policy(choice.policy, folder)
    given = {name: _argument(value) for name, value in choice.options.items()}
    # A misspelt key of the file is an argument that the environment does not take.
    hints = (of_campaign(name) or meant(name, SystemChoice.model_fields) for name in given)
    with blaming(f"{where}: system.gymnasium: {next(filter(None, hints), '')}{environment_id}"):
        import_beside(environment_id.rpartition(":")[0], folder)
        # Without checks that print.
        env = gymnasium.make(environment_id, disable_env_checker=True, **given)
    parameters = tuple(space_parameters(config, where))
    environment = Environment(env, policy, [each.name for each in parameters], where)
    check_whole(environment.whole, config, where, "environment")
    says = _step_of(env.unwrapped)
    if choice.step and says and abs(choice.step - says[0]) > 1e-9 * says[0]:
        raise DefinitionError(
            f"{where}: system.step: {environment_id} says itself that a step lasts {says[0]:g} s ({says[1]}), not "
            f"{choice.step:g} s; remove this key"
        )
    step = says[0] if says else choice.step
    if step is None:
        raise DefinitionError(
            f"{where}: system.step: {environment_id} does not say how long a step is; give its s, or step = 1.0 to "
            "count steps"
        )
    check_horizon(config.horizon, step, where)
    lows, highs = ({each.name: getattr(each, end) for each in parameters} for end in ("low", "high"))
    with blaming(f"{where}: {environment_id} with {choice.policy}", f"{where}: system.policy"):
        environment.check_effect(lows, highs)
        columns = _columns(environment, lows, choice.columns, where)
    if choice.after_end is None:  # stepped on beyond the end of an episode, `ended` is a column of its own
        columns[ENDED.name] = (ENDED.name, ENDED.unit)
    with placed(f"{where}: system"):
        files = DeclaredFiles(
            {each: path for each, path in declared_files(choice.files or (), folder).items() if path != policy.path}
            | ({policy.path.name: policy.path} if policy.path.suffix == ".zip" else {})
        )
        spec = SystemSpec(
            name=name_of(re.sub(".*[:/]", "", environment_id), "environment"),
            doc=f"{environment_id} of Gymnasium, with {choice.policy}",
            parameters=parameters,
            columns=timed_columns({name: unit for name, (_, unit) in columns.items()}, choice.after_end),
            options=tuple(fixed_option(name, value) for name, value in sorted(choice.options.items())),
            variants=("nominal",),
            noisy=() if choice.noisy in {False, ()} else ("nominal",),
            timed=True,
            max_horizon=step * MAX_STEPS,
            default_horizon=config.horizon,
            seed_bits=SEED_BITS,
            code=policy.digests | code_beside(folder, type(env.unwrapped).__module__) | files.digests,
            versions=policy.versions | versions_of((), {"gymnasium", type(env.unwrapped).__module__}),
            after_end=choice.after_end,
        )
    return WithSpec(EnvironmentSystem(spec, environment, step, [name for name, _ in columns.values()]), files)


def _columns(
    environment: Environment, start: Mapping[str, float], chosen: Mapping[str, str] | None, where: str
) -> dict[str, tuple[str, str]]:
    """Return the own columns by their names: what each is called in the environment, and its unit."""
    *_, (_, _, _, info) = environment.episode(start, 0, 1)
    observed = environment.observed
    scalars = [str(name) for name, value in info.items() if _is_number(value) or isinstance(value, bool | np.bool_)]
    known = [*observed, "reward", *(name for name in scalars if re.fullmatch("[a-z][a-z0-9_]*", name))]
    if chosen is None:
        return {name: (name, "") for name in known}
    own = [name for name in chosen if name not in known]
    if own and len(own) != len(observed):
        hint = meant(own[0], known)
        raise DefinitionError(
            f"{where}: system.columns: {hint}{own[0]!r} is none of {', '.join(known)}; other names are those of all "
            f"{len(observed)} numbers of the observation, in their order"
        )
    names = dict(zip(own, observed, strict=False))
    return {name: (names.get(name, name), unit) for name, unit in chosen.items()}


def _names(space: Any, prefix: str = "") -> Iterator[str]:
    """Yield the names of the numbers of an observation: obs_0, obs_1, ..., or of a dict by its keys."""
    parts = getattr(space, "spaces", None)
    if isinstance(parts, Mapping):
        for key, part in parts.items():
            yield from _names(part, f"{prefix}{re.sub('[^a-z0-9]+', '_', str(key).lower())}_")
    elif parts is not None:
        for k, part in enumerate(parts):
            yield from _names(part, f"{prefix or 'obs_'}{k}_")
    elif space.shape is None:
        raise DefinitionError(f"an observation of {type(space).__name__} is no number")
    else:
        for k in range(int(np.prod(space.shape))):
            yield f"{prefix or 'obs_'}{k}"


def _numbers(space: Any, observation: Any) -> Iterator[float]:
    """Yield the numbers of an observation, in the order of `_names`."""
    parts = getattr(space, "spaces", None)
    if isinstance(parts, Mapping):
        for key, part in parts.items():
            yield from _numbers(part, observation[key])
    elif parts is not None:
        for part, each in zip(parts, observation, strict=True):
            yield from _numbers(part, each)
    else:
        yield from np.asarray(observation, dtype=np.float64).ravel().tolist()


def _step_of(base: Any) -> tuple[float, str] | None:
    """Return the seconds of a step, and where an environment says them; None where it does not."""
    for name in ("dt", "tau"):
        if _is_number(value := getattr(base, name, None)) and float(value) > 0.0:
            return float(value), name
    name = "policy_frequency"
    frequency = _config(base).get(name)
    return (1.0 / float(frequency), name) if _is_number(frequency) and float(frequency) > 0.0 else None


def _config(base: Any) -> Mapping[str, Any]:
    found = getattr(base, "config", None)
    return found if isinstance(found, Mapping) else {}


def _is_number(value: object) -> TypeGuard[SupportsFloat]:
    return isinstance(value, Real | np.number) and not isinstance(value, bool | np.bool_)


def _is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _like(before: object, value: float) -> float:
    """Return a value as an integer where there was one."""
    return round(value) if _is_whole(before) else value


def _argument(value: OptionValue) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value
