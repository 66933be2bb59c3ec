# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for the highest terrain in each direction."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def raise_to_terrain(angle, reach, heights, distances, observer, radius):
    """Raise elevation angles to those of the terrain, one direction at a time.

    `angle` (n,), rad, is raised in place where a height is seen at a larger angle, and `reach`
    (n,), m, becomes the arc length to the last known height. `heights` (n, m), m, are above a
    sphere of `radius`, m, at arc lengths `distances` (m,), m, from the observer, whose height is
    `observer`, m. NaN is an unknown height.
    """
    for i in range(heights.shape[0]):
        steepest = np.tan(angle[i])
        for j in range(heights.shape[1]):
            z = heights[i, j]
            if np.isnan(z):
                continue
            arc = distances[j] / radius
            half = np.sin(0.5 * arc)
            # (R + z) cos(arc) - (R + observer) without the difference of two radii.
            up = z - observer - 2.0 * (radius + z) * half * half
            steepest = max(steepest, up / ((radius + z) * np.sin(arc)))
            reach[i] = distances[j]
        angle[i] = np.arctan(steepest)
