"""Slices through regions: every pixel has the status of its whole area, or is undecided."""

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds.rigorous.regions import SAFE, UNDECIDED, UNSAFE, Regions
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.report.collect import regions
from perfbound.orchestrator.report.collect.regions import LARGEST


def boxes(*rows: tuple[tuple[float, ...], tuple[float, ...], int]) -> Regions:
    low, high = (np.array([row[k] for row in rows]) for k in (0, 1))
    return Regions(low, high, np.array([row[2] for row in rows]), np.prod((high - low) / 4.0, axis=1))


QUARTERS = boxes(((0.0, 0.0), (2.0, 4.0), SAFE), ((2.0, 0.0), (4.0, 2.0), UNSAFE), ((2.0, 2.0), (4.0, 4.0), UNDECIDED))


def test_the_pixels_of_two_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    box = Lattice((0.0, 0.0), (4.0, 4.0), 3)
    (found,) = regions._slices(QUARTERS, box, np.array([1.0, 1.0]))
    assert (found.axes, found.shape, found.cells) == ((0, 1), (2, 2), "0012")
    # With one pixel for all, several statuses are in it.
    monkeypatch.setitem(regions.PIXELS, 2, 1)
    assert regions._slices(QUARTERS, box, np.array([1.0, 1.0]))[0].cells == "2"


def test_the_only_parameter() -> None:
    line = boxes(((0.0,), (1.0,), SAFE), ((1.0,), (2.0,), UNDECIDED), ((2.0,), (4.0,), UNSAFE))
    (found,) = regions._slices(line, Lattice((0.0,), (4.0,), 3), np.array([4.0]))
    assert (found.axes, found.shape, found.cells) == ((0,), (4,), "0211")


@pytest.mark.parametrize(("worst", "cells"), [(0.5, "0"), (2.0, "1"), (4.0, "1")])
def test_a_slice_of_three_parameters_goes_through_the_worst_start(worst: float, cells: str) -> None:
    """An edge belongs to the box above it, the last one to the box below it."""
    cube = boxes(((0.0, 0.0, 0.0), (4.0, 4.0, 2.0), SAFE), ((0.0, 0.0, 2.0), (4.0, 4.0, 4.0), UNSAFE))
    found = regions._slices(cube, Lattice((0.0,) * 3, (4.0,) * 3, 3), np.array([1.0, 1.0, worst]))
    assert [each.axes for each in found] == [(0, 1), (0, 2), (1, 2)]
    assert [each.cells for each in found] == [cells, "01", "01"]
    assert found[0].through == (1.0, 1.0, worst)


def test_the_largest_boxes_of_each_certified_status_come_first() -> None:
    found = regions._largest(QUARTERS)
    assert [(each.status, each.share) for each in found] == [("safe", 0.5), ("unsafe", 0.25)]
    many = boxes(*(((float(k), 0.0), (k + 1.0, 4.0), SAFE) for k in range(LARGEST + 2)))
    assert len(regions._largest(many)) == LARGEST
