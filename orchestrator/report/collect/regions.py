"""The regions of a finished campaign for the page: slices through the box as rasters, and the largest boxes."""

import hashlib
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from ....schemas.errors import EvidenceError
from ....schemas.result.certificate import Predicate
from ...campaign.plan import ProblemPlan
from ...certificate import files as certificate_files
from ...certificate.regions import boxes_of
from ...certificate.words.region_text import region_sentences
from ...mathematics.bounds.rigorous.cells import Integers
from ...mathematics.bounds.rigorous.regions import SAFE, STATUSES, UNDECIDED, UNSAFE, Regions
from ...mathematics.gp.kernels import Floats
from ...mathematics.gp.lattice import Lattice
from ...store import files
from ..data.page import RegionBox, RegionMap, RegionSlice

PIXELS = {1: 512, 2: 128}
"""Largest number of pixels along each side of a slice, by its dimension."""
MOST_SLICES = 6
"""Pairs of parameters that are drawn."""
LARGEST = 5
"""Boxes of each certified status in the table."""


def region_map(directory: Path, plan: ProblemPlan, predicate: Predicate, worst: Sequence[float]) -> RegionMap | None:
    """Return the regions of a campaign, in slices through the start `worst`; None without regions.

    Of a table that is missing, or not the one that the certificate names, the shares remain.
    """
    found, box = predicate.regions, plan.candidates
    if found is None or not isinstance(box, Lattice):
        return None
    boxes = _table_of(directory, found.sha256, box)
    return RegionMap(
        safe=found.safe,
        unsafe=found.unsafe,
        undecided=found.undecided,
        sentences=region_sentences(predicate),
        slices=() if boxes is None else _slices(boxes, box, np.array(worst)),
        largest=() if boxes is None else _largest(boxes),
    )


def _table_of(directory: Path, sha256: str, box: Lattice) -> Regions | None:
    try:
        data = files.contents(directory / certificate_files.REGIONS, certificate_files.MAX_REGIONS)
        return boxes_of(data.decode(), box) if hashlib.sha256(data).hexdigest() == sha256 else None
    except (EvidenceError, ValueError):
        return None


def _slices(boxes: Regions, box: Lattice, worst: Floats) -> tuple[RegionSlice, ...]:
    pairs: list[tuple[int, ...]] = [*combinations(range(box.dimension), 2)] or [(0,)]
    found = []
    for axes in pairs[:MOST_SLICES]:
        raster = _raster(boxes, box, axes, worst)
        text = "".join(map(str, raster.ravel().tolist()))
        found.append(RegionSlice(axes, raster.shape, text, tuple(worst.tolist())))
    return tuple(found)


def _raster(boxes: Regions, box: Lattice, axes: tuple[int, ...], through: Floats) -> Integers:
    """Return the status of each pixel of a slice, last axis fastest; a pixel of several is undecided."""
    others = [axis for axis in range(box.dimension) if axis not in axes]
    inside = (boxes.low <= through) & ((through < boxes.high) | (boxes.high == np.array(box.high)))
    cut = np.all(inside[:, others], axis=1)
    low, width = np.array(box.low)[list(axes)], (np.array(box.high) - np.array(box.low))[list(axes)]
    first, last = ((ends[cut][:, axes] - low) / width for ends in (boxes.low, boxes.high))
    # Boxes are halves of halves: on this many pixels each side of every box is a whole number of them.
    sides = np.rint(1.0 / (last - first).min(axis=0)).astype(np.intp)
    raster = np.full(tuple(sides.tolist()), UNDECIDED)
    for a, b, status in zip(np.rint(first * sides), np.rint(last * sides), boxes.status[cut], strict=True):
        raster[tuple(slice(int(i), int(j)) for i, j in zip(a, b, strict=True))] = status
    most = PIXELS[len(axes)]
    for axis, side in enumerate(raster.shape):
        if side > most:
            parts = np.split(np.moveaxis(raster, axis, 0), most)
            least, largest = (np.stack([pick(each, axis=0) for each in parts]) for pick in (np.min, np.max))
            raster = np.moveaxis(np.where(least == largest, least, UNDECIDED), 0, axis)
    return raster


def _largest(boxes: Regions) -> tuple[RegionBox, ...]:
    found = []
    for status in (SAFE, UNSAFE):
        numbers = np.flatnonzero(boxes.status == status)
        order = numbers[np.argsort(-boxes.share[numbers], kind="stable")][:LARGEST]
        for k in order:
            low, high = tuple(boxes.low[k].tolist()), tuple(boxes.high[k].tolist())
            found.append(RegionBox(STATUSES[status], low, high, float(boxes.share[k])))
    return tuple(found)
