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
    """Write where the sharpest observations do not exclude a rock (rows, cols).

    `lit` and `dark` are the sharpness of the sharpest observation on lit and on dark terrain, q in
    pixels per metre of radius (rows, cols); 0: none.
    """
    rows, cols = lit.shape
    plain = _PLAIN / np.float32(radius)
    for i in prange(rows):
        for j in range(cols):
            surer = _PLAIN_SURER if lit[i, j] >= plain else _SURER
            possible[i, j] = (dark[i, j] > 0.0) & (lit[i, j] < surer * dark[i, j])


@kernel()
def count_crowded(lit, possible, explained):
    """Return the numbers of cells with a possible untracked rock and observed."""
    crowded = looked = 0
    for i in range(lit.shape[0]):
        for j in range(lit.shape[1]):
            crowded += possible[i, j] & ~explained[i, j]
            looked += possible[i, j] | (lit[i, j] > 0.0)
    return crowded, looked


@kernel()
def _missed(sharpness, radius, number, line, min_rate):
    """Return the density of rocks missed by an observation of lit terrain, 1/m^2."""
    start, slope, floor = line
    total = 0.0
    for k in range(len(radius)):
        rate = min(max(start + slope * radius[k] * sharpness, floor), 1.0)
        total += number[k] * max(rate, min_rate)
    return total


@kernel(parallel=True)
def fill(density, lit, possible, explained, radius, number, line, min_rate, hidden, crowded):
    """Write the density of possible untracked rocks (rows, cols), 1/m^2.

    Parameters
    ----------
    density
        Result (rows, cols).
    lit
        Sharpness of the sharpest observation on lit terrain, q in pixels per metre of radius.
    possible, explained
        Where a rock may be in the dark, and where a tracked rock explains that (rows, cols).
    radius, number
        Radii of the rocks (n,), m, and their expected number per area (n,), 1/m^2.
    line
        Miss rate on lit terrain: value at q = 0, slope, minimum.
    min_rate
        Further lower bound of the miss rate.
    hidden, crowded
        Density where dark terrain is explained, and on other dark terrain.
    """
    rows, cols = lit.shape
    for i in prange(rows):
        for j in range(cols):
            if possible[i, j]:
                density[i, j] = hidden if explained[i, j] else crowded
            else:
                density[i, j] = _missed(lit[i, j], radius, number, line, min_rate)
