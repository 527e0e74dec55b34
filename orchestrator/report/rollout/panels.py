"""The picture of one rollout: a small panel for every column over time; apart, since matplotlib loads for a second."""

import textwrap

from matplotlib.axes import Axes

from ....schemas.amounts import some_of
from ....schemas.rollout import RolloutRequest
from ....schemas.system import SystemSpec
from ....schemas.trajectory.trajectory import Trajectory
from .. import style
from ..style import BLUE, THICK

PANEL = 0.85
"""Height of a panel in inches."""
PER_STACK = 10
"""Panels above one another; further ones are beside them."""
MOST = 40
"""Panels of a picture."""
LABEL = -0.15
"""Place of a label left of its panel, in widths of the panel: as far as tick labels reach."""
CHARACTERS = 62
"""Of a line of the title."""


def drawn_rollout(spec: SystemSpec, request: RolloutRequest, trajectory: Trajectory) -> bytes:
    """Return a PNG with the columns of `spec` over time, one panel each; equal rollouts give equal bytes."""
    shown, t = spec.columns[1 : MOST + 1], trajectory.samples[:, 0]
    stacks = -(-len(shown) // PER_STACK)
    rows = -(-len(shown) // stacks)
    title = textwrap.fill(_rollout_title(spec, request, len(shown)), CHARACTERS * stacks)
    with style.new_figure(PANEL * rows + 0.5 + 0.12 * title.count("\n")) as figure:
        figure.set_figwidth(style.WIDTH * stacks)
        figure.suptitle(title, fontsize=8)
        grid = figure.subplots(rows, stacks, sharex=True, squeeze=False)
        panels: list[Axes] = list(grid.T.flat)
        for axes, column in zip(panels, shown, strict=False):
            axes.plot(t, trajectory.column(column.name), "-" if len(t) > 1 else "o", color=BLUE, linewidth=THICK, ms=3)
            axes.set_ylabel(style.with_unit(column.name, column.unit))
            axes.spines[["top", "right"]].set_visible(False)
            axes.margins(x=0.01)
            axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
            # A place of its own: aligning the labels of n panels costs n^2 times.
            axes.yaxis.set_label_coords(LABEL, 0.5)
        for axes in panels[len(shown) :]:
            axes.set_visible(False)
        for axes in grid[-1]:
            axes.set_xlabel("t / s")
            if len(t) == 1:
                axes.set_xticks(t)
    return style.png(figure)


def _rollout_title(spec: SystemSpec, request: RolloutRequest, shown: int) -> str:
    start = some_of(
        [
            f"{each.name} = {value:g} {style.plain_text(each.unit)}".removesuffix(" 1").rstrip()
            for each, value in zip(spec.own_parameters, request.x, strict=True)
        ]
    )
    some = "" if shown == len(spec.columns) - 1 else f"; {shown} of {len(spec.columns) - 1} columns"
    drawn = f"; {style.plain_text(request.disturbance_words(spec))}" if request.disturbances else ""
    return f"{spec.name}, {request.variant}: {start}{drawn}; seed {request.seed}{some}"
