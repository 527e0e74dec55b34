"""The ranges of the parameters that a campaign's starts are in."""

from ....schemas.file.parameters import parameter_ranges
from ....schemas.result.facts import Header

MOST_READ = 12
"""Parameters of one input over time that are read one by one."""


def long_inputs(header: Header) -> dict[str, str]:
    """Return the parameters of inputs over time that are read as a curve, each with the name of its input."""
    return {name: each.name for each in header.spec.signals if len(each.names) > MOST_READ for name in each.names}


def ranges(header: Header) -> dict[str, tuple[float, float]]:
    """Return the least and the greatest value of each parameter, in the order of the system."""
    space, parameters = header.config.space, header.spec.parameters
    if isinstance(space, dict):
        boxes = parameter_ranges(space)
        # A disturbance that a search chooses has the range of the search.
        return {each.name: ((box := boxes.get(each.name, each)).low, box.high) for each in parameters}
    columns = zip(*space.rows, strict=True)
    return {each.name: (min(values), max(values)) for each, values in zip(parameters, columns, strict=True)}
