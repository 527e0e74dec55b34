"""The policies of environments, and controllers: a function or class in a file, or a model of Stable-Baselines3."""

import importlib
import inspect
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from ...schemas.errors import DefinitionError, meant
from ..faults import NOT_OF_SYSTEMS, fault_text
from .files import loaded_code
from .fingerprint import file_sha256, versions_of

ALGORITHMS = ("stable_baselines3", "sb3_contrib")
"""Packages in which an algorithm is looked for."""

Act = Callable[..., Any]


class Policy(NamedTuple):
    """What acts in an environment, and what its identity consists of."""

    act: Act
    """From an observation to an action, or from a model and its data."""
    reset: Callable[[], object] | None
    """Called before each rollout, of a policy with a memory."""
    start: Callable[..., Any] | None
    """The function `reset` of its file, which starts a rollout: of an environment `reset(env, *, seed, NAME, ...)`."""
    path: Path
    digests: dict[str, str]
    versions: dict[str, str]


def load_policy(reference: str, folder: Path, arguments: str = "observation") -> Policy:
    """Return the policy FILE.py:NAME or FILE.zip:ALGORITHM, relative to `folder`; `arguments` are those of a function.

    Raises:
        DefinitionError: it is not there, cannot be loaded, or cannot be called.

    """
    text, _, name = reference.rpartition(":")
    path = folder / text
    return _of_code(path, name, arguments) if path.suffix == ".py" else _of_model(path, text, name)


def _of_code(path: Path, name: str, arguments: str) -> Policy:
    code = loaded_code(path)
    found = getattr(code.module, name, None)
    if found is None:
        known = [each for each, value in vars(code.module).items() if callable(value)]
        hint = meant(name, known)
        raise DefinitionError(f"{path}: {hint}there is no function {name!r} in it; write def {name}({arguments}): ...")
    if inspect.isclass(found):
        try:
            found = found()
        except NOT_OF_SYSTEMS:
            raise
        except BaseException as error:  # noqa: BLE001  (any: untrusted code)
            raise DefinitionError(f"{path}: {name}() without arguments: {fault_text(error)}") from None
    if not callable(found):
        raise DefinitionError(f"{path}: {name} cannot be called; give it def __call__(self, {arguments}): ...")
    _check_arguments(found, f"{path}: {name}", arguments)
    start = getattr(code.module, "reset", None)
    return Policy(found, getattr(found, "reset", None), start, path, code.digests, code.versions)


def _check_arguments(found: Callable[..., Any], place: str, arguments: str) -> None:
    """Refuse a function that takes other arguments, where Python knows them."""
    with suppress(ValueError):  # of some that are not written in Python
        try:
            inspect.signature(found).bind(*arguments.split(", "))
        except TypeError as error:
            raise DefinitionError(f"{place} is called with ({arguments}): {error}") from None


def _of_model(path: Path, text: str, name: str) -> Policy:
    if not path.is_file():
        raise DefinitionError(f"{path}: there is no such model; save one with model.save({path.stem!r})")
    for package in ALGORITHMS:
        try:
            algorithm = getattr(importlib.import_module(package), name, None)
        except ImportError:
            continue
        if algorithm is not None:
            break
    else:
        raise DefinitionError(
            f"{path}: no algorithm {name!r} of {' or '.join(ALGORITHMS)} is installed here: pip install "
            "stable-baselines3, and name the algorithm that made the model, such as PPO"
        )
    # On the CPU, and in one thread: a sum in another order has other last digits.
    importlib.import_module("torch").set_num_threads(1)
    try:
        model = algorithm.load(path, device="cpu")
    except NOT_OF_SYSTEMS:
        raise
    except BaseException as error:  # noqa: BLE001  (any: a file of anybody)
        raise DefinitionError(
            f"{path}: it cannot be loaded as a model of {name} ({fault_text(error)}); name the algorithm that saved "
            "it, or save it again"
        ) from None

    def act(observation: Any) -> Any:
        return model.predict(observation, deterministic=True)[0]

    return Policy(act, None, None, path, {text: file_sha256(path)}, versions_of((), {package, "torch"}))
