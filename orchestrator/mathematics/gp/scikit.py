"""scikit-learn's Matern kernel, imported without `scipy.stats`.

scikit-learn imports all of `scipy.stats`, of which its kernel uses nothing, and which takes half a second of CPU. A
stand-in takes its place meanwhile; what uses `scipy.stats` later, scikit-learn or others, gets it in full.
"""

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from types import ModuleType
from typing import Any

LATE = "scipy.stats"
FUNCTIONS = ("rankdata",)
"""What scikit-learn takes from it by name while it is imported; any other name imports it at once."""


class StandIn(ModuleType):
    """A module that imports the one of its name when something of it is used."""

    def __getattr__(self, name: str) -> Any:
        """Return a function that imports the module when it is called, or what the module has under this name."""
        if name.startswith("__"):
            raise AttributeError(name)
        return self._late(name) if name in FUNCTIONS else getattr(self._imported(), name)

    def _late(self, name: str) -> Callable[..., Any]:
        def late(*values: Any, **options: Any) -> Any:
            return getattr(self._imported(), name)(*values, **options)

        return late

    def _imported(self) -> ModuleType:
        _withdraw(self)
        return importlib.import_module(self.__name__)


def _withdraw(stand_in: StandIn) -> None:
    if sys.modules.get(stand_in.__name__) is stand_in:
        sys.modules.pop(stand_in.__name__, None)


@contextmanager
def _stand_in_for(name: str) -> Iterator[None]:
    """Have a stand-in for a module that is not imported yet."""
    stand_in = StandIn(name)
    sys.modules.setdefault(name, stand_in)
    try:
        yield
    finally:
        _withdraw(stand_in)


@cache
def scikit_matern() -> Callable[..., Any]:
    """Return the class `sklearn.gaussian_process.kernels.Matern`; its first import takes most of a second."""
    with _stand_in_for(LATE), suppress(ImportError):  # another scikit-learn may need more of it than this stand-in has
        return _import_matern()
    return _import_matern()


def _import_matern() -> Callable[..., Any]:
    from sklearn.gaussian_process.kernels import Matern  # noqa: PLC0415

    return Matern  # type: ignore[no-any-return]
