"""The parameters of a box: one for each range, and one for each knot of an input signal."""

from collections.abc import Iterator

from ..rollout import MAX_PARAMETERS
from .signals import SignalShape
from .space import Box, Space


def signal_shapes(space: Space) -> tuple[SignalShape, ...]:
    """Return the input signals of a space, in its order; a list of starts has none."""
    return tuple(each for _, each in _named_shapes(space)) if isinstance(space, dict) else ()


def parameter_ranges(space: Box) -> Box:
    """Return the range of each parameter: the knots of an input signal have that of the signal.

    >>> from perfbound.schemas.file.space import Range
    >>> box = {"u": Range(low=0.0, high=1.0, signal="linear", knots=2), "v": Range(low=0.0, high=5.0)}
    >>> {name: each.high for name, each in parameter_ranges(box).items()}
    {'u_0': 1.0, 'u_1': 1.0, 'v': 5.0}
    """
    names = {name: shape.names for name, shape in _named_shapes(space)}
    knot = {"signal": None, "knots": None}
    return {
        parameter: each.model_copy(update=knot) if name in names else each
        for name, each in space.items()
        for parameter in names.get(name, (name,))
    }


def check_signals(space: Space, horizon: float) -> None:
    """Refuse input signals of rollouts without duration, and more knots than a start has room for.

    Raises:
        ValueError: one line with the key and the remedy.

    """
    if isinstance(space, dict) and (count := len(parameter_ranges(space))) > MAX_PARAMETERS:
        raise ValueError(f"space: {count} parameters with their knots are more than the {MAX_PARAMETERS} allowed")
    for shape in signal_shapes(space) if horizon == 0 else ():
        raise ValueError(
            f"space.{shape.name}.signal: an input over time needs rollouts longer than 0 s; give horizon, or remove "
            "signal and knots"
        )


def _named_shapes(space: Box) -> Iterator[tuple[str, SignalShape]]:
    for name, each in space.items():
        if each.signal is not None and each.knots is not None:
            yield name, SignalShape(name=name, kind=each.signal, knots=each.knots)
