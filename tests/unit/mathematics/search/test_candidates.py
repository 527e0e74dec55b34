"""Points among which a search chooses."""

from itertools import pairwise

import numpy as np

from perfbound.orchestrator.mathematics.gp.kernels import Floats
from perfbound.orchestrator.mathematics.search.candidates import WORST, Inputs, choices_among


def mixtures(signals: list[range]) -> Floats:
    """Return the candidates that have some parameters of one start and the others of another one."""
    starts = np.array([[0.2] * 24, [0.7] * 24])
    found = choices_among(np.random.default_rng(1), starts, Inputs(24, signals))
    assert np.all((found >= 0.0) & (found <= 1.0))
    mixed: Floats = found[np.all((found == 0.2) | (found == 0.7), axis=1) & (np.ptp(found, axis=1) > 0)]
    return mixed


def test_some_candidates_are_mixtures_of_two_starts() -> None:
    assert len(np.unique(mixtures([]), axis=0)) > 30


def test_a_while_of_an_input_comes_from_one_start() -> None:
    def changes(points: Floats) -> float:
        return float(np.mean([sum(a != b for a, b in pairwise(point)) for point in points.tolist()]))

    assert changes(mixtures([range(24)])) < 0.75 * changes(mixtures([]))


def test_of_one_start_there_are_candidates_too() -> None:
    found = choices_among(np.random.default_rng(1), np.full((1, 3), 0.5), Inputs(3))
    assert found.shape[1] == 3
    assert len(np.unique(found, axis=0)) > 400


def test_the_worst_starts_alone_have_candidates_around_them() -> None:
    starts = np.linspace(0.1, 0.9, 12)[:, None] * np.ones(5)
    found = [len(choices_among(np.random.default_rng(1), starts[:count], Inputs(5))) for count in (1, WORST, 12)]
    assert found[0] < found[1] == found[2]
