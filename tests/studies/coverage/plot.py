"""The power of the audit as a figure."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tests.studies.coverage.records import Chunk
from tests.studies.coverage.rigorous import Audit

CURVES = {  # (label, colour, line): colours that a colour-blind reader can distinguish
    "bound": ("bound wrong", "#0072B2", "o-"),
    "refuted": ("B refuted", "#009E73", "s-"),
    "unnoticed": ("bound wrong and nothing refuted", "#D55E00", "^-"),
}


def power_curve(found: Sequence[tuple[Audit, Chunk]], target: Path) -> None:
    """Write the shares of campaigns against how much too small B is, one panel a noise scale."""
    scales = sorted({row.noise_scale for row, _ in found}, reverse=True)
    figure = Figure(figsize=(8.0, 3.4), dpi=110, layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(scales), sharey=True))
    for ax, scale in zip(axes, scales, strict=True):
        rows = [(row, chunk) for row, chunk in found if row.noise_scale == scale and row.small_r == 1.0]
        _panel(ax, sorted(rows, key=lambda pair: pair[0].small_b), scale)
    axes[0].set_ylabel("share of campaigns [%]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    target.parent.mkdir(exist_ok=True)
    figure.savefig(target)


def _panel(ax: Axes, rows: Sequence[tuple[Audit, Chunk]], scale: float) -> None:
    factors = [row.small_b for row, _ in rows]
    for name, (label, colour, line) in CURVES.items():
        shares = [100.0 * float(np.mean(chunk[name])) for _, chunk in rows]
        ax.plot(factors, shares, line, color=colour, label=label, markersize=4, clip_on=False)
    ax.set_xscale("log")
    ax.set_xticks(factors, [f"{factor:g}" for factor in factors], fontsize=8)
    ax.minorticks_off()
    ax.set_ylim(0.0, 100.0)
    ax.grid(alpha=0.3)
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_xlabel("B too small by a factor of")
    ax.set_title(f"noise R = {scale:g} a rollout (B = 1 is right)", fontsize=10)
