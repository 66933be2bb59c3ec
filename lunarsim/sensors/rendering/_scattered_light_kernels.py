# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled computation of light scattered from terrain to terrain."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.typing import Array, BoolArray


@kernel(inline=True, inner=True)
def interpolate(values: Array, row: float, column: float) -> float:
    """Interpolate an array bilinearly at a fractional row and column."""
    a, b = min(int(row), values.shape[0] - 2), min(int(column), values.shape[1] - 2)
    v, u = row - a, column - b
    south = (1.0 - u) * values[a, b] + u * values[a, b + 1]
    north = (1.0 - u) * values[a + 1, b] + u * values[a + 1, b + 1]
    return float((1.0 - v) * south + v * north)


@kernel(parallel=True)
def lit_posts(z: Array, posting: float, sun: Array) -> BoolArray:
    """Return which grid points (rows, cols) of a relief see the centre of the Sun.

    `z` are elevations, m (NaN casts no shadow), `posting` is the grid spacing, m, and `sun` the
    unit vector to the Sun (3,), above the horizon.
    """
    rows, cols = z.shape
    out = np.zeros(z.shape, np.bool_)
    run = np.hypot(sun[0], sun[1])
    if run < 1e-9:
        out[:] = True
        return out
    # Each step advances one post along the major axis.
    scale = max(abs(sun[0]), abs(sun[1]))
    east, north = sun[0] / scale, sun[1] / scale
    rise = sun[2] / scale * posting
    highest = np.nanmax(z)
    for i in prange(rows):
        for j in range(cols):
            lit = True
            x, y, height = float(j), float(i), z[i, j]
            while lit:
                x += east
                y += north
                height += rise
                if height > highest or not (0.0 <= x <= cols - 1.0 and 0.0 <= y <= rows - 1.0):
                    break
                if interpolate(z, y, x) > height:
                    lit = False
            out[i, j] = lit
    return out


@kernel(parallel=True)
def scattered_irradiance(
    z: Array,
    slope: Array,
    posting: float,
    radiance_factor: Array,
    azimuths: int,
    distance_factor: float,
) -> Array:
    """Return the irradiance (rows, cols) of a relief by sunlit terrain around it.

    The irradiance is relative to that of the Sun. `z` are elevations, m, and `slope`
    (rows, cols, 2) their gradients to the east and to the north; `radiance_factor` is the I/F of
    every grid point, equal in all directions.

    Along each of `azimuths` azimuths the terrain is sampled at distances that grow by
    `distance_factor`; a sample above all nearer ones is visible, and fills the band of elevation
    angles in between.
    """
    rows, cols = z.shape
    out = np.zeros(z.shape)
    for i in prange(rows):
        for j in range(cols):
            east, north = slope[i, j, 0], slope[i, j, 1]
            length = np.sqrt(1.0 + east * east + north * north)
            total = 0.0
            for k in range(azimuths):
                angle = 2.0 * np.pi * (k + 0.5) / azimuths
                x, y = np.cos(angle), np.sin(angle)
                # The post's own tangent plane hides what is below it.
                own = east * x + north * y
                across, up = -own / length, 1.0 / length
                seen = np.arctan(own)
                sine = np.sin(seen)
                distance = 1.0
                while True:
                    row, column = i + distance * y, j + distance * x
                    if not (0.0 <= row <= rows - 1.0 and 0.0 <= column <= cols - 1.0):
                        break
                    here = np.arctan((interpolate(z, row, column) - z[i, j]) / (distance * posting))
                    if here > seen + 1e-7:
                        top = np.sin(here)
                        # Integral of (n . direction) cos(elevation) over the band.
                        band = across * 0.5 * (
                            here - seen + 0.5 * (np.sin(2.0 * here) - np.sin(2.0 * seen))
                        ) + up * 0.5 * (top * top - sine * sine)
                        # Rounding may make the integral over a narrow band negative.
                        total += interpolate(radiance_factor, row, column) * max(band, 0.0)
                        seen, sine = here, top
                    distance = max(distance + 1.0, distance * distance_factor)
            out[i, j] = 2.0 * total / azimuths
    return out
