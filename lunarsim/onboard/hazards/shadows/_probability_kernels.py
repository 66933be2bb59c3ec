# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled probability map: profile of one rock, and accumulation over rocks."""

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
    """Return the probability that a rock covers a point near its estimated centre.

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
    """Return the probabilities that rocks (n,) cover points at distances (n, k).

    `distance` (n, k), m, is measured from the estimated centres. `sigma` (n,), m, is the standard
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
    `cover_profile` (n, k) is the probability that it covers a point, at equal steps of distance
    from 0 to `reach` (n,), m, where it ends at 0.
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
