"""Compiled placement of rocks without overlap."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.world.terrain._surface_kernels import relief_at


@kernel()
def _size_classes(radius, area):
    """Return the class (n,) of each falling radius and the bucket side of each class.

    Radii halve from class to class; the last class takes all that would need buckets smaller
    than the space a rock has on average.
    """
    count = radius.size
    least = np.sqrt(area / count)
    sides = [2.0 * radius[0]]
    of = np.zeros(count, np.int64)
    for n in range(count):
        while 4.0 * radius[n] <= sides[-1] and 0.5 * sides[-1] >= least:
            sides.append(0.5 * sides[-1])
        of[n] = len(sides) - 1
    return of, np.array(sides)


@kernel()
def _is_free(px, py, r, x, y, radius, west, south, sides, widths, heights, offset, head, follow):
    """Tell whether a disc touches none of those that lie already."""
    for c in range(sides.size):
        j = int((px - west) / sides[c])
        i = int((py - south) / sides[c])
        for bi in range(max(i - 1, 0), min(i + 2, heights[c])):
            for bj in range(max(j - 1, 0), min(j + 2, widths[c])):
                m = head[offset[c] + bi * widths[c] + bj]
                while m >= 0:
                    reach = r + radius[m]
                    if (px - x[m]) ** 2 + (py - y[m]) ** 2 < reach * reach:
                        return False
                    m = follow[m]
    return True


@kernel()
def _about(ax, ay, radius, weights, farthest):
    """Return a place about one of the craters: their density falls as the cube of the distance."""
    k = min(np.searchsorted(weights, np.random.random()), weights.size - 1)  # noqa: NPY002
    # A ring of width dr has an area of r dr: how many lie within r goes as 1 - R / r.
    u = np.random.random()  # noqa: NPY002
    r = radius[k] / (1.0 - u * (1.0 - 1.0 / farthest))
    turn = 2.0 * np.pi * np.random.random()  # noqa: NPY002
    return ax[k] + r * np.cos(turn), ay[k] + r * np.sin(turn)


@kernel()
def drop_rocks(
    radius,
    west,
    east,
    south,
    north,
    z,
    x0,
    y0,
    p,
    seed,
    tries,
    share,
    ax,
    ay,
    ar,
    weights,
    farthest,
):
    """Drop discs at random without overlap; radii must fall.

    A share of them lies about craters (middles ax, ay, radii ar, shares summed up in weights).

    Discs of about one size share a grid of buckets as wide as the largest of them, one chained
    list a bucket. A smaller disc can only touch those in the nine buckets around it.

    Returns
    -------
    x, y, base, placed
        Centres, the relief's elevation under them, and how many found room.
    """
    np.random.seed(seed)  # noqa: NPY002  (Numba's own state, private to compiled code)
    count = radius.size
    x = np.empty(count)
    y = np.empty(count)
    base = np.empty(count)
    of, sides = _size_classes(radius, (east - west) * (north - south))
    widths = np.empty(sides.size, np.int64)
    heights = np.empty(sides.size, np.int64)
    offset = np.empty(sides.size, np.int64)
    total = 0
    for c in range(sides.size):
        widths[c] = int((east - west) / sides[c]) + 1
        heights[c] = int((north - south) / sides[c]) + 1
        offset[c] = total
        total += widths[c] * heights[c]
    head = np.full(total, -1, np.int64)
    follow = np.full(count, -1, np.int64)
    for n in range(count):
        r = radius[n]
        c = of[n]
        done = False
        near = share > 0.0 and np.random.random() < share  # noqa: NPY002
        for _ in range(tries):
            if near:
                px, py = _about(ax, ay, ar, weights, farthest)
            else:
                px = west + (east - west) * np.random.random()  # noqa: NPY002
                py = south + (north - south) * np.random.random()  # noqa: NPY002
            ground = relief_at(px, py, z, x0, y0, p)
            if np.isnan(ground):
                continue
            lists = sides[: c + 1]
            if _is_free(
                px, py, r, x, y, radius, west, south, lists, widths, heights, offset, head, follow
            ):
                x[n] = px
                y[n] = py
                base[n] = ground
                j = int((px - west) / sides[c])
                i = int((py - south) / sides[c])
                bucket = offset[c] + i * widths[c] + j
                follow[n] = head[bucket]
                head[bucket] = n
                done = True
                break
        if not done:
            return x[:n], y[:n], base[:n], n
    return x, y, base, count
