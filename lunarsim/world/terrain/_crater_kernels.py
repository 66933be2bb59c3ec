# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled addition of crater profiles to a grid of elevations."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange


@kernel(parallel=True)
def add_crater_profiles(z, x0, y0, p, x, y, diameter, freshness, depth, rim_height, reach):
    """Add the height profiles of fresh or eroded craters to a grid of elevations.

    `z` (rows, cols) are elevations, m, changed in place; its first point is (x0, y0) and its
    spacing `p`, m. `x`, `y`, `diameter` (m) and `freshness` (0 erased, 1 new) describe the craters
    (n,). `depth` and `rim_height` are those of a fresh crater over its diameter, and `reach` is the
    outer radius of a profile in crater radii. The profile is that of `craters.crater_profile`.
    """
    rows, cols = z.shape
    for i in prange(rows):
        py = y0 + i * p
        for n in range(x.size):
            radius = 0.5 * diameter[n]
            dy = py - y[n]
            span = (reach * radius) ** 2 - dy * dy
            if span <= 0.0:
                continue
            half = np.sqrt(span)
            j0 = max(int(np.ceil((x[n] - half - x0) / p)), 0)
            j1 = min(int(np.floor((x[n] + half - x0) / p)), cols - 1)
            f = freshness[n]
            rim = rim_height * diameter[n] * f * f
            for j in range(j0, j1 + 1):
                dx = x0 + j * p - x[n]
                q = (dx * dx + dy * dy) / (radius * radius)
                if q < 1.0:
                    z[i, j] += rim + depth * diameter[n] * f * (q - 1.0)
                else:
                    s = np.sqrt(q)
                    fade = max((reach - s) / (reach - 1.0), 0.0)
                    z[i, j] += rim / (q * s) * fade * fade * (3.0 - 2.0 * fade)


@kernel(parallel=True)
def add_degraded_profiles(z, x0, y0, p, x, y, radius, depth, root_age, profiles, reach):
    """Add tabulated height profiles of degraded craters to a grid of elevations.

    `z` (rows, cols) are elevations, m, changed in place; its first point is (x0, y0) and its
    spacing `p`, m. `x`, `y`, `radius` and fresh `depth` (n,), m, describe the craters; `root_age`
    (n,) is the square root of their relative age, from 0 to 1. `profiles` (ages, radii) are heights
    over the fresh depth, at uniform steps of `root_age` and of the distance up to `reach` crater
    radii.
    """
    rows, cols = z.shape
    ages, radii = profiles.shape
    for i in prange(rows):
        py = y0 + i * p
        for n in range(x.size):
            dy = py - y[n]
            span = (reach * radius[n]) ** 2 - dy * dy
            if span <= 0.0:
                continue
            half = np.sqrt(span)
            j0 = max(int(np.ceil((x[n] - half - x0) / p)), 0)
            j1 = min(int(np.floor((x[n] + half - x0) / p)), cols - 1)
            u = root_age[n] * (ages - 1)
            a = min(int(u), ages - 2)
            u -= a
            for j in range(j0, j1 + 1):
                dx = x0 + j * p - x[n]
                v = np.sqrt(dx * dx + dy * dy) / (radius[n] * reach) * (radii - 1)
                b = min(int(v), radii - 2)
                v -= b
                young = profiles[a, b] + v * (profiles[a, b + 1] - profiles[a, b])
                old = profiles[a + 1, b] + v * (profiles[a + 1, b + 1] - profiles[a + 1, b])
                z[i, j] += depth[n] * (young + u * (old - young))
