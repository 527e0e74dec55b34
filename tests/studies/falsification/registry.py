"""All benchmarks: those of every module in `models` that has `BENCHMARKS`."""

import importlib
import pkgutil
from functools import cache

from tests.studies.falsification import models
from tests.studies.falsification.benchmark import Benchmark


@cache
def benchmarks() -> tuple[Benchmark, ...]:
    """Return the benchmarks, by module and in the order of each module."""
    modules = sorted(module.name for module in pkgutil.iter_modules(models.__path__))
    loaded = (importlib.import_module(f"{models.__name__}.{name}") for name in modules)
    return tuple(each for module in loaded for each in getattr(module, "BENCHMARKS", ()))


def benchmark(name: str, instance: int) -> Benchmark:
    """Return the benchmark of a name.

    Raises:
        KeyError: there is none.

    """
    try:
        return next(each for each in benchmarks() if (each.name, each.instance) == (name, instance))
    except StopIteration:
        names = ", ".join(dict.fromkeys(each.name for each in benchmarks()))
        raise KeyError(f"{name}, instance {instance}: no such benchmark; choose one of {names}") from None
