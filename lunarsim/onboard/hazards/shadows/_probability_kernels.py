# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled probability that rocks cover points, and density of unseen rocks."""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel, prange

_NODE, _WEIGHT = np.polynomial.legendre.leggauss(12)
# Standard deviations beyond which a point is certainly covered, and from which the distance to the
# centre is taken as normal (error 6e-4 in probability).
_CERTAIN, _FAR = 5.5, 5.0
# Number of rows per thread.
_BAND = 64


@kernel()
def i0e(x):
    """Return exp(-x) I0(x) for x >= 0 (Abramowitz and Stegun 9.8.1 and 9.8.2)."""
    if x < 3.75:
        y = (x / 3.75) ** 2
        inner = 1.2067492 + y * (0.2659732 + y * (0.0360768 + y * 0.0045813))
        return math.exp(-x) * (1.0 + y * (3.5156229 + y * (3.0899424 + y * inner)))
    y = 3.75 / x
    inner = 0.02635537 + y * (-0.01647633 + y * 0.00392377)
    inner = -0.00157565 + y * (0.00916281 + y * (-0.02057706 + y * inner))
    return (0.39894228 + y * (0.01328592 + y * (0.00225319 + y * inner))) / math.sqrt(x)


@kernel()
def _normal_cdf(x):
    """Return the cumulative standard normal distribution at x."""
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@kernel()
def _cover_probability(distance, sigma, radius, radius_sigma, node, weight):
    """Return the probability that a point lies within the circular outline of a rock.

    `distance`, m, is that of the point from the estimated centre. Its distance from the true centre
    has a Rice distribution with `distance` and the standard deviation `sigma` per axis, m. The
    radius of the rock is normal with mean `radius` and standard deviation `radius_sigma`, m. `node`
    and `weight` are those of Gauss-Legendre quadrature.
    """
    if distance > _FAR * sigma:
        # The distance is nearly normal: its first two moments to the fourth order of sigma / d.
        share = (sigma / distance) ** 2
        middle = distance * (1.0 + 0.5 * share + 0.125 * share * share)
        width = math.sqrt(sigma * sigma * (1.0 - 0.5 * share) + radius_sigma * radius_sigma)
        return _normal_cdf((radius - middle) / width)
    if radius - distance > _CERTAIN * (sigma + radius_sigma):
        return 1.0
    low = max(distance - 7.0 * sigma, 0.0)
    high = distance + 7.0 * sigma
    # The integrand changes near the radius, so panels meet there. The last panel ends where no rock
    # reaches.
    total = 0.0
    left = low
    for panel in range(3):
        if panel == 0:
            right = radius - 4.0 * radius_sigma
        elif panel == 1:
            right = radius
        else:
            right = radius + 4.0 * radius_sigma
        right = min(max(right, left), high)
        half = 0.5 * (right - left)
        if half > 0.0:
            for k in range(node.size):
                rho = left + half * (1.0 + node[k])
                z = rho * distance / (sigma * sigma)
                density = rho / (sigma * sigma) * i0e(z)
                density *= math.exp(-0.5 * ((rho - distance) / sigma) ** 2)
                total += half * weight[k] * density * _normal_cdf((radius - rho) / radius_sigma)
        left = right
    return min(max(total, 0.0), 1.0)


@kernel(parallel=True)
def rice_profiles(distance, sigma, radius, radius_sigma, node, weight):
    """Return the probabilities that points lie within the outlines of rocks (n, k).

    `distance` (n, k), m, is that of k points from the estimated centre of each rock; the distance
    from the true centre has a Rice distribution. `sigma` (n,), m, is the standard
    deviation of the centre per axis. `radius` and `radius_sigma` (n,), m, are mean and standard
    deviation of the radius. `node` and `weight` are those of Gauss-Legendre quadrature.
    """
    out = np.empty(distance.shape)
    for j in prange(distance.shape[0]):
        for k in range(distance.shape[1]):
            out[j, k] = _cover_probability(
                distance[j, k], sigma[j], radius[j], radius_sigma[j], node, weight
            )
    return out


@kernel(parallel=True)
def multiply_clear_probability(clear, x0, y0, posting, xy, reach, cover_profile, rock_probability):
    """Multiply the probability that each cell is clear by that for each rock.

    `clear` (rows, cols) is updated. (`x0`, `y0`) is the centre of cell (0, 0) and `posting` the
    cell size, m. Rock i is at `xy` (n, 2), m, and exists with `rock_probability` (n,).
    `cover_profile` (n, k) is the probability that its outline contains a cell's centre, at equal
    steps of distance from 0 to `reach` (n,), m. Cells farther away are not changed.
    """
    rows, cols = clear.shape
    last = cover_profile.shape[1] - 1
    for band in prange((rows + _BAND - 1) // _BAND):
        top, bottom = band * _BAND, min((band + 1) * _BAND, rows) - 1
        for j in range(xy.shape[0]):
            r = reach[j]
            i0 = max(math.ceil((xy[j, 1] - r - y0) / posting), top)
            i1 = min(math.floor((xy[j, 1] + r - y0) / posting), bottom)
            scale = last / r
            for i in range(i0, i1 + 1):
                dy = y0 + i * posting - xy[j, 1]
                # Part of the row within reach.
                half = math.sqrt(max(r * r - dy * dy, 0.0))
                c0 = max(math.ceil((xy[j, 0] - half - x0) / posting), 0)
                c1 = min(math.floor((xy[j, 0] + half - x0) / posting), cols - 1)
                for c in range(c0, c1 + 1):
                    dx = x0 + c * posting - xy[j, 0]
                    at = math.sqrt(dx * dx + dy * dy) * scale
                    k = int(at)
                    if k < last:
                        p = cover_profile[j, k] + (at - k) * (
                            cover_profile[j, k + 1] - cover_profile[j, k]
                        )
                        clear[i, c] *= 1.0 - rock_probability[j] * p


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
    """Count positions where an untracked rock may exist, and all observed positions.

    A position is observed if its shadow place was seen lit or may hide a rock in the dark. `lit`
    (rows, cols) is the sharpness of the sharpest observation of lit terrain, 0 for none.
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
