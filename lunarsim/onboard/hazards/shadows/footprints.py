"""Aggregate values of single cells over the footprint of the lander."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.typing import BoolArray

# Minimum observed fraction of a footprint. Terrain in the shadow of a rock is never observed, so
# without an allowance no cell near a rock would count; the remainder has the prior probability.
MIN_OBSERVED_FRACTION = 0.9
# Subdivisions of a cell's side to compute its fraction within a disc.
_SUBDIVISIONS = 8


def disc_mean(layer: NDArray[Any], radius: float, outside: float) -> NDArray[np.float32]:
    """Return the mean of a map layer over a disc centred on each cell (rows, cols).

    Cells at the rim count with their fraction within the disc.

    Parameters
    ----------
    layer
        Layer (rows, cols).
    radius
        Radius of the disc, cells.
    outside
        Value of the layer beyond its edge.
    """
    half = max(int(np.ceil(radius - 0.5)), 0)
    at = (np.arange((2 * half + 1) * _SUBDIVISIONS) + 0.5) / _SUBDIVISIONS - half - 0.5
    inside = (at[:, None] ** 2 + at**2 < radius**2).astype(np.float32)
    side = 2 * half + 1
    disc = inside.reshape(side, _SUBDIVISIONS, side, _SUBDIVISIONS).sum((1, 3))
    disc /= max(float(disc.sum()), 1.0)
    wide = cv2.copyMakeBorder(
        np.asarray(layer, np.float32) - np.float32(outside),
        half, half, half, half, cv2.BORDER_CONSTANT, value=0.0,
    )  # fmt: skip
    mean = cv2.filter2D(wide, cv2.CV_32F, disc, borderType=cv2.BORDER_CONSTANT)
    rows, cols = layer.shape
    return np.asarray(mean[half : half + rows, half : half + cols] + np.float32(outside))


def footprint_observed(observed: BoolArray, radius: float) -> BoolArray:
    """Return the cells around which the footprint counts as observed (rows, cols).

    `observed` (rows, cols) marks the observed cells. A footprint counts if it does not leave the
    map and its centre cell and a minimum of 90 % of its area are observed. `radius` is that of the
    footprint, cells; 0: only the cell itself counts.
    """
    if radius <= 0.0:
        return observed
    share = disc_mean(observed, radius, 0.0)
    half = int(np.ceil(radius))
    is_inside = np.zeros_like(observed)
    if 2 * half < min(observed.shape):
        is_inside[half : observed.shape[0] - half, half : observed.shape[1] - half] = True
    return np.asarray(is_inside & observed & (share >= MIN_OBSERVED_FRACTION))
