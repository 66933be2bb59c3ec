# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled placement of rocks without overlap."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.world.terrain._surface_kernels import relief_at


@kernel()
def _size_classes(radius, area):
    """Divide rocks into size classes for the search for overlaps.

    `radius` (n,) are decreasing radii and `area` is the area of the map, m^2. Returns the class of
    each rock (n,) and the side of each class's square buckets, m.
    Radii halve from class to class. Buckets are at least as large as the mean area per rock: the
    last class contains all rocks that would need smaller buckets.
    """
    count = radius.size
    min_side = np.sqrt(area / count)
    sides = [max(2.0 * radius[0], min_side)]
    of = np.zeros(count, np.int64)
    for n in range(count):
        while 4.0 * radius[n] <= sides[-1] and 0.5 * sides[-1] >= min_side:
            sides.append(0.5 * sides[-1])
        of[n] = len(sides) - 1
    return of, np.array(sides)


@kernel()
def _is_free(
    px, py, r, x, y, radius, west, south, sides, widths, heights, offset, first_disc, next_disc
):
    """Return whether a disc overlaps none of the discs already placed.

    The disc has its centre at (px, py) and radius `r`; `x`, `y` and `radius` are the placed discs.
    Size class c of the placed discs has `widths[c]` x `heights[c]` square buckets of side
    `sides[c]` from the corner (west, south). The linked list of a bucket starts in `first_disc`,
    for class c at index `offset[c]`, and continues in `next_disc` until -1.
    """
    for c in range(sides.size):
        j = int((px - west) / sides[c])
        i = int((py - south) / sides[c])
        for bi in range(max(i - 1, 0), min(i + 2, heights[c])):
            for bj in range(max(j - 1, 0), min(j + 2, widths[c])):
                m = first_disc[offset[c] + bi * widths[c] + bj]
                while m >= 0:
                    reach = r + radius[m]
                    if (px - x[m]) ** 2 + (py - y[m]) ** 2 < reach * reach:
                        return False
                    m = next_disc[m]
    return True


@kernel()
def _draw_near_crater(craters, farthest):
    """Sample a point (x, y) around a random crater.

    Points lie between the rim and `farthest` crater radii from the centre; points per area decrease
    as distance^-3. `craters` (4, n) are x, y, radius and cumulative selection probability.
    """
    k = min(np.searchsorted(craters[3], np.random.random()), craters.shape[1] - 1)  # noqa: NPY002
    # A ring of width dr has an area proportional to r dr: the number within r goes as 1 - R / r.
    u = np.random.random()  # noqa: NPY002
    r = craters[2, k] / (1.0 - u * (1.0 - 1.0 / farthest))
    turn = 2.0 * np.pi * np.random.random()  # noqa: NPY002
    return craters[0, k] + r * np.cos(turn), craters[1, k] + r * np.sin(turn)


@kernel()
def _buckets(sides, wide, high):
    """Create the empty buckets that cover a map of `wide` x `high` metres.

    `sides` are the bucket sides of the size classes. Returns columns, rows and first bucket of each
    class, and an array of list heads, one per bucket.
    """
    widths = np.empty(sides.size, np.int64)
    heights = np.empty(sides.size, np.int64)
    offset = np.empty(sides.size, np.int64)
    total = 0
    for c in range(sides.size):
        widths[c] = int(wide / sides[c]) + 1
        heights[c] = int(high / sides[c]) + 1
        offset[c] = total
        total += widths[c] * heights[c]
    return widths, heights, offset, np.full(total, -1, np.int64)


@kernel()
def drop_rocks(
    radius, west, east, south, north, z, x0, y0, p, seed, tries, cluster_fraction, craters, farthest
):
    """Place discs (rocks) at random on a relief without overlap; radii must decrease.

    `radius` are the radii of the discs, m. The map extends from west to east and south to north, m;
    `z` (rows, cols) are its elevations with the first point (x0, y0) and the spacing `p`. Random
    numbers start from `seed`; each disc has `tries` attempts. A fraction of the discs,
    `cluster_fraction`, lies around `craters` (rows: x, y, radius, cumulative fractions), up to
    `farthest` crater radii away. Returns x and y of the centres, the relief's elevation below them,
    and the number of placed discs. The first disc without a free place ends the placement, and the
    results contain only the discs before it.

    Discs of similar size share a grid of buckets as wide as the largest of them, with one linked
    list per bucket. A smaller disc can only overlap discs in the nine buckets around it.
    """
    np.random.seed(seed)  # noqa: NPY002  (Numba's own state, private to compiled code)
    x, y, base = np.empty(radius.size), np.empty(radius.size), np.empty(radius.size)
    of, sides = _size_classes(radius, (east - west) * (north - south))
    widths, heights, offset, first_disc = _buckets(sides, east - west, north - south)
    next_disc = np.full(radius.size, -1, np.int64)
    for n in range(radius.size):
        c = of[n]
        done = False
        near = cluster_fraction > 0.0 and np.random.random() < cluster_fraction  # noqa: NPY002
        for _ in range(tries):
            if near:
                px, py = _draw_near_crater(craters, farthest)
            else:
                px = west + (east - west) * np.random.random()  # noqa: NPY002
                py = south + (north - south) * np.random.random()  # noqa: NPY002
            terrain_height = relief_at(px, py, z, x0, y0, p)
            if np.isnan(terrain_height) or not _is_free(
                px, py, radius[n], x, y, radius, west, south, sides[: c + 1], widths, heights,
                offset, first_disc, next_disc,
            ):  # fmt: skip
                continue
            x[n], y[n], base[n] = px, py, terrain_height
            i, j = int((py - south) / sides[c]), int((px - west) / sides[c])
            bucket = offset[c] + i * widths[c] + j
            next_disc[n] = first_disc[bucket]
            first_disc[bucket] = n
            done = True
            break
        if not done:
            return x[:n], y[:n], base[:n], n
    return x, y, base, radius.size
