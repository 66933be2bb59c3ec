"""Plain choice of what a picture draws."""

from __future__ import annotations

import itertools

import numpy as np


def coarsest_level(error, most):
    """Return the last level of the first run whose error (levels,) is at most `most`."""
    fits = list(itertools.takewhile(lambda e: e <= most, error))
    return max(len(fits) - 1, 0)


def tile_in_view(low, high, eye, axes, bounds, near):
    """Return whether no side of the view has all eight corners of a box outside."""
    corners = np.array(list(itertools.product(*zip(low, high, strict=True)))) - eye
    x, y, z = (corners @ axes).T
    left, right, upper, lower = bounds
    outside = [z < near, x < left * z, x > right * z, y < upper * z, y > lower * z]
    return not any(side.all() for side in outside)


def distance_of_box(low, high, eye):
    """Return how far a point is from a box."""
    return float(np.linalg.norm(np.clip(eye, low, high) - eye))


def cell_corners(z, ground):
    """Return the elevations over `ground` at the corners SW, SE, NW and NE of each cell."""
    wider = np.pad(z, ((0, 1), (0, 1)), mode="edge") - ground
    return np.stack([wider[:-1, :-1], wider[:-1, 1:], wider[1:, :-1], wider[1:, 1:]], axis=-1)


def least_map(points, hit, height, width):
    """Return the least depth of the points of each texel, 1 where there is none."""
    out = np.ones((height, width), np.float32)
    for column, row, depth in points[hit]:
        out[int(row), int(column)] = min(out[int(row), int(column)], depth)
    return out
