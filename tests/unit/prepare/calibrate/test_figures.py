"""The pictures of a calibration: every start is where its numbers are."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from perfbound.orchestrator.prepare.calibrate.figures import _draw_noise


def test_noise_is_drawn_at_the_mean_of_each_start() -> None:
    rng = np.random.default_rng(1)
    values, again = rng.normal(size=(30, 4)), rng.normal(2.0, 1.0, size=(3, 16))
    measured = SimpleNamespace(noisy=True, values=values, at_noisiest=again)
    axes = Figure().subplots()
    found: Any = SimpleNamespace(measured=measured, keys={})
    _draw_noise(axes, found)
    lines = {str(line.get_label()): np.array(line.get_xydata()) for line in axes.get_lines()}
    for label, drawn in (("each start", values), ("noisiest, again", again)):
        assert np.array_equal(lines[label], np.column_stack([drawn.mean(axis=1), drawn.std(axis=1, ddof=1)]))
