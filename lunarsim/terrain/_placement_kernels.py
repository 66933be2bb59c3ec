"""Compiled placement of rocks without overlap."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.terrain._surface_kernels import relief_at


@kernel()
def drop_rocks(radius, west, east, south, north, z, x0, y0, p, seed, tries):
    """Drop discs at random without overlap; radii must fall.

    Discs no wider than a bucket are kept in buckets, one chained list a bucket, so a trial looks
    at nine of them; the few wider ones are all looked at.

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
    # Twice the median diameter keeps the lists short.
    side = max(4.0 * radius[count // 2], 0.25)
    small = 0
    while small < count and 2.0 * radius[small] > side:
        small += 1
    width = int((east - west) / side) + 1
    height = int((north - south) / side) + 1
    head = np.full((height, width), -1, np.int64)
    follow = np.full(count, -1, np.int64)
    for n in range(count):
        r = radius[n]
        done = False
        for _ in range(tries):
            px = west + (east - west) * np.random.random()  # noqa: NPY002
            py = south + (north - south) * np.random.random()  # noqa: NPY002
            ground = relief_at(px, py, z, x0, y0, p)
            if np.isnan(ground):
                continue
            free = True
            for m in range(min(n, small)):
                reach = r + radius[m]
                if (px - x[m]) ** 2 + (py - y[m]) ** 2 < reach * reach:
                    free = False
                    break
            if free and n >= small:
                j = int((px - west) / side)
                i = int((py - south) / side)
                for bi in range(max(i - 1, 0), min(i + 2, height)):
                    for bj in range(max(j - 1, 0), min(j + 2, width)):
                        m = head[bi, bj]
                        while m >= 0:
                            reach = r + radius[m]
                            if (px - x[m]) ** 2 + (py - y[m]) ** 2 < reach * reach:
                                free = False
                                break
                            m = follow[m]
            if free:
                x[n] = px
                y[n] = py
                base[n] = ground
                if n >= small:
                    follow[n] = head[int((py - south) / side), int((px - west) / side)]
                    head[int((py - south) / side), int((px - west) / side)] = n
                done = True
                break
        if not done:
            return x[:n], y[:n], base[:n], n
    return x, y, base, count
