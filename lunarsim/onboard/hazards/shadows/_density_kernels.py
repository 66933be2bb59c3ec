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
    """Mark the positions where a rock of one size may exist in the dark undetected.

    That is where an observation saw dark terrain at the place of the rock's shadow, and no
    considerably sharper one saw it lit. `lit` and `dark` (rows, cols) are the sharpness of the
    sharpest observation of lit and of dark terrain: q (the square root of the number of dark
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
def count_possible(lit, possible, explained):
    """Count the positions where an untracked rock may exist, and all observed ones.

    `lit` (rows, cols) is the sharpness of the sharpest observation of lit terrain, 0 for none.
    `possible` is the result of `mark_possible`, and `explained` marks where the dark terrain is the
    shadow of a tracked rock (rows, cols).
    """
    possible_count = observed_count = 0
    for i in range(lit.shape[0]):
        for j in range(lit.shape[1]):
            possible_count += possible[i, j] & ~explained[i, j]
            observed_count += possible[i, j] | (lit[i, j] > 0.0)
    return possible_count, observed_count


@kernel()
def _missed_density(sharpness, radius, expected_density, miss_rate_line, min_rate):
    """Return the density of rocks missed by an observation of lit terrain, 1/m^2.

    `sharpness` is q in pixels per metre of radius. `radius` (n,), m, and `expected_density` (n,),
    1/m^2, describe the rocks before any observation. `miss_rate_line` holds the miss rate at q = 0,
    its slope and its minimum; `min_rate` is a further minimum.
    """
    start, slope, floor = miss_rate_line
    total = 0.0
    for k in range(len(radius)):
        rate = min(max(start + slope * radius[k] * sharpness, floor), 1.0)
        total += expected_density[k] * max(rate, min_rate)
    return total


@kernel(parallel=True)
def compute_density(
    out, lit, possible, explained, radius, expected_density, miss_rate_line, min_rate,
    tracked_dark_density, dark_density,
):  # fmt: skip
    """Compute the expected density of untracked rocks of a size class per position.

    `out` (rows, cols) receives the density, 1/m^2. `lit`, `possible` and `explained` (rows, cols)
    are those of `count_possible`. Where no rock is possible in the dark, the density is that of
    `_missed_density`, which explains the other arguments. Elsewhere it is `tracked_dark_density` in
    the shadow of a tracked rock, and `dark_density` on other dark terrain, 1/m^2.
    """
    rows, cols = lit.shape
    for i in prange(rows):
        for j in range(cols):
            if possible[i, j]:
                out[i, j] = tracked_dark_density if explained[i, j] else dark_density
            else:
                out[i, j] = _missed_density(
                    lit[i, j], radius, expected_density, miss_rate_line, min_rate
                )
