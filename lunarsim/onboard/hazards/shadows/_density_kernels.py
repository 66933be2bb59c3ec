# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled density of rocks that may exist given the observations."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange

# A lit observation overrules a dark one if it is sharper by the first factor, or, if it shows a
# rock of the size with the given number of pixels, by the last factor. Sharpness is that of a mean
# rock; low ones may appear smaller in the later observation than in the dark one.
_SURER, _PLAIN, _PLAIN_SURER = np.float32(1.5), np.float32(5.0), np.float32(1.15)


@kernel(parallel=True)
def mark_possible(possible, lit, dark, radius):
    """Mark the positions at which the sharpest observations allow a rock of a size.

    `lit` and `dark` (rows, cols) are the sharpness of the sharpest observation in which the shadow
    of the rock would fall on lit and on dark terrain: q (the square root of the number of dark
    pixels) per metre of radius; 0 for no observation. `radius` is that of the rock, m. `possible`
    (rows, cols) receives the result.
    """
    rows, cols = lit.shape
    plain = _PLAIN / np.float32(radius)
    for i in prange(rows):
        for j in range(cols):
            surer = _PLAIN_SURER if lit[i, j] >= plain else _SURER
            possible[i, j] = (dark[i, j] > 0.0) & (lit[i, j] < surer * dark[i, j])


@kernel()
def count_crowded(lit, possible, explained):
    """Count the positions with a possible untracked rock, and the observed positions.

    `lit` (rows, cols) is the sharpness of the sharpest observation on lit terrain, 0 for none.
    `possible` marks where a rock may be in the dark, and `explained` where a tracked rock explains
    the darkness (rows, cols).
    """
    crowded = looked = 0
    for i in range(lit.shape[0]):
        for j in range(lit.shape[1]):
            crowded += possible[i, j] & ~explained[i, j]
            looked += possible[i, j] | (lit[i, j] > 0.0)
    return crowded, looked


@kernel()
def _missed(sharpness, radius, number, line, min_rate):
    """Return the density of rocks missed by an observation of lit terrain, 1/m^2.

    `sharpness` is q in pixels per metre of radius. `radius` (n,), m, and `number` (n,), 1/m^2, are
    the sizes of rocks and their expected densities. `line` holds the miss rate at q = 0, its slope
    and its minimum; `min_rate` is a further minimum.
    """
    start, slope, floor = line
    total = 0.0
    for k in range(len(radius)):
        rate = min(max(start + slope * radius[k] * sharpness, floor), 1.0)
        total += number[k] * max(rate, min_rate)
    return total


@kernel(parallel=True)
def fill(density, lit, possible, explained, radius, number, line, min_rate, hidden, crowded):
    """Compute the expected density of untracked rocks at each position, 1/m^2.

    Parameters
    ----------
    density
        Receives the result (rows, cols).
    lit
        Sharpness of the sharpest observation on lit terrain, q in pixels per metre of radius (rows,
        cols).
    possible, explained
        Where a rock may be in the dark, and where a tracked rock explains the darkness (rows,
        cols).
    radius, number
        Radii of the rocks (n,), m, and their expected number per area (n,), 1/m^2.
    line
        Miss rate on lit terrain: value at q = 0, slope, minimum.
    min_rate
        Further lower bound of the miss rate.
    hidden, crowded
        Density where a tracked rock explains the darkness, and on other dark terrain, 1/m^2.
    """
    rows, cols = lit.shape
    for i in prange(rows):
        for j in range(cols):
            if possible[i, j]:
                density[i, j] = hidden if explained[i, j] else crowded
            else:
                density[i, j] = _missed(lit[i, j], radius, number, line, min_rate)
