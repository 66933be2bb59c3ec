# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled moves of the rocks in the reference posterior of a patch of terrain."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.world.terrain._surface_kernels import relief_at

# Sides of the buckets of returns, m.
BUCKET_M = 0.25
# Rocks that a patch can hold.
MAX_ROCKS = 500
# Smallest and largest scale of a step: of the centre, m, and of the logarithm of the radius.
_STEP_M, _STEP_LOG = (0.0005, 0.5), (0.001, 1.0)


@kernel(inline=True)
def relief_weights(x, y, x0, y0, posting, rows, cols):
    """Return the grid point south-west of (x, y), and the weights of four points.

    Its row and column come first. The weights are those of the south-west, south-east, north-west
    and north-east point. Each square has two triangles with a diagonal from south-west to
    north-east.
    """
    u, v = (x - x0) / posting, (y - y0) / posting
    col = min(max(int(np.floor(u)), 0), cols - 2)
    row = min(max(int(np.floor(v)), 0), rows - 2)
    u, v = u - col, v - row
    if u >= v:
        return row, col, 1.0 - u, u - v, 0.0, v
    return row, col, 1.0 - v, 0.0, v - u, u


@kernel(inner=False)
def fill_relief(points, relief, frame, terrain):
    """Fill in the elevation of a relief (rows, cols) below each point.

    `points` (n, 2) or more are in m, and `terrain` (n,) is the result, m.
    """
    for n in range(len(points)):
        terrain[n] = relief_at(points[n, 0], points[n, 1], relief, *frame)


@kernel(inner=False)
def add_returns(points, weight, rocks, owner, frame, cols, precision, pull):
    """Add what returns (n, 3) measure of the relief to its `precision` and `pull`.

    They are the matrix and the right-hand side of the normal equations, with the grid points in
    the order of their rows. A return on the terrain measures the relief below it, one on a rock,
    given by its `owner`, the relief at the rock's centre plus the height above the rock's base.
    """
    x0, y0, posting = frame
    rows = len(pull) // cols
    at, share = np.empty(4, np.int64), np.empty(4)
    for n in range(len(points)):
        x, y, z = points[n]
        if owner[n] >= 0:
            rock = rocks[owner[n]]
            left = rock[2] ** 2 - (x - rock[0]) ** 2 - (y - rock[1]) ** 2
            x, y, z = rock[0], rock[1], z - np.sqrt(max(left, 0.0))
        row, col, share[0], share[1], share[2], share[3] = relief_weights(
            x, y, x0, y0, posting, rows, cols
        )
        for m in range(4):
            at[m] = (row + m // 2) * cols + col + m % 2
        for i in range(4):
            pull[at[i]] += weight[n] * share[i] * z
            for j in range(4):
                precision[at[i], at[j]] += weight[n] * share[i] * share[j]


@kernel()
def _surface(x, y, terrain, rocks, count, skip, extra):
    """Return the elevation at (x, y) and the rock that it belongs to; -1: relief.

    `terrain` is the relief there. The first `count` of `rocks` (x, y, radius, base) count without
    the rock `skip`, and also the rock `extra`, whose number is `skip`, or `count` if this is -1.
    """
    best, owner = terrain, -1
    for i in range(count):
        if i == skip:
            continue
        left = rocks[i, 2] ** 2 - (x - rocks[i, 0]) ** 2 - (y - rocks[i, 1]) ** 2
        if left > 0.0:
            z = rocks[i, 3] + np.sqrt(left)
            if z > best:
                best, owner = z, i
    left = extra[2] ** 2 - (x - extra[0]) ** 2 - (y - extra[1]) ** 2
    if left > 0.0 and extra[2] > 0.0:
        z = extra[3] + np.sqrt(left)
        if z > best:
            best, owner = z, (count if skip < 0 else skip)
    return best, owner


@kernel(inner=False)
def assign_returns(points, terrain, rocks, count, owner, expected):
    """Fill in rock and elevation of each return for the current rocks.

    They are `owner` (n,), -1 for the relief, and `expected` (n,), m.
    """
    none = np.zeros(4)
    for k in range(len(points)):
        expected[k], owner[k] = _surface(
            points[k, 0], points[k, 1], terrain[k], rocks, count, -1, none
        )


@kernel()
def _bucket_range(centre, radius, first, side):
    """Return the buckets that the interval `centre` ± `radius` covers along an axis."""
    low = int(np.floor((centre - radius - first) / BUCKET_M))
    high = int(np.floor((centre + radius - first) / BUCKET_M))
    return range(max(low, 0), min(high, side - 1) + 1)


@kernel()
def _change(points, weight, terrain, expected, buckets, rocks, count, skip, extra, found, value):
    """Return the change of the log likelihood, and the number of affected returns.

    The rock `skip` is replaced by `extra`; -1: none, and a radius of 0: nothing. The affected
    returns and their new elevations are written to `found` and `value`.
    """
    start, order, x0, y0, side = buckets
    total, n = 0.0, 0
    for part in range(2):
        if part == 0:
            if skip < 0:
                continue
            x, y, r = rocks[skip, 0], rocks[skip, 1], rocks[skip, 2]
        else:
            x, y, r = extra[0], extra[1], extra[2]
        if r <= 0.0:
            continue
        for i in _bucket_range(y, r, y0, side):
            for j in _bucket_range(x, r, x0, side):
                for m in range(start[i * side + j], start[i * side + j + 1]):
                    k = order[m]
                    px, py = points[k, 0], points[k, 1]
                    if (px - x) ** 2 + (py - y) ** 2 >= r * r:
                        continue
                    if part == 1 and skip >= 0:
                        old = rocks[skip]
                        if (px - old[0]) ** 2 + (py - old[1]) ** 2 < old[2] ** 2:
                            continue
                    new, _ = _surface(px, py, terrain[k], rocks, count, skip, extra)
                    before, after = points[k, 2] - expected[k], points[k, 2] - new
                    total += 0.5 * weight[k] * (before * before - after * after)
                    found[n], value[n] = k, new
                    n += 1
    return total, n


@kernel()
def _log_uniform(low, high):
    return np.exp(np.log(low) + (np.log(high) - np.log(low)) * np.random.random())  # noqa: NPY002


@kernel()
def _draw_rock(rock, half, table):
    """Draw place and radius of a new rock from the prior.

    `half` and `table` are those of `move_rocks`.
    """
    rock[0] = half * (2.0 * np.random.random() - 1.0)  # noqa: NPY002
    rock[1] = half * (2.0 * np.random.random() - 1.0)  # noqa: NPY002
    at = np.random.random() * (len(table) - 1)  # noqa: NPY002
    n = min(int(at), len(table) - 2)
    rock[2] = 0.5 * np.exp(table[n] + (at - n) * (table[n + 1] - table[n]))


@kernel()
def _step_rock(rock, q):
    """Change place, radius or both; return the log ratio of the acceptance.

    It contains the prior and the proposals, not the returns. The density of diameters D is
    proportional to ``exp(-q D) / D^2``, and a step of log D has the factor D.
    """
    mode, gain = np.random.random(), 0.0  # noqa: NPY002
    if mode < 0.67:
        step = _log_uniform(*_STEP_M)
        rock[0] += step * np.random.normal()  # noqa: NPY002
        rock[1] += step * np.random.normal()  # noqa: NPY002
    if mode > 0.33:
        step, before = _log_uniform(*_STEP_LOG) * np.random.normal(), rock[2]  # noqa: NPY002
        rock[2] *= np.exp(step)
        gain = -2.0 * q * (rock[2] - before) - step
    return gain


@kernel(inner=False)
def move_rocks(
    points, weight, terrain, expected, buckets, relief, frame, rocks, count, law, half, moves, seed
):
    """Apply `moves` reversible-jump moves to the rocks; return their number.

    Births take a place and a diameter from the prior, deaths remove a random rock, and other moves
    change centre, radius or both. The acceptance probabilities are those of Green (1995,
    Biometrika 82).

    `points` (n, 3) are returns with the inverse variance `weight` (n,), the relief `terrain` (n,)
    below them and the current `expected` elevations (n,), which are updated. `buckets` are first
    return, order, origin and number per side of the buckets. `relief` (rows, cols) has the `frame`
    (x0, y0, posting). The first `count` of `rocks` (n, 4), rows x, y, radius and base, are updated.
    `law` is the number of rocks per square metre, the exponent q, minimum and maximum diameter, and
    a table of logarithms of diameters at equal steps of the distribution function. Centres are at
    most `half` from the middle along an axis. `seed` starts the random numbers.
    """
    np.random.seed(seed)  # noqa: NPY002  (Numba's own state, private to compiled code)
    mean = law[0] * 4.0 * half * half
    extra, none = np.zeros(4), np.zeros(4)
    found, value = np.empty(2 * len(points), np.int64), np.empty(2 * len(points))
    for _ in range(moves):
        kind = np.random.random()  # noqa: NPY002
        is_birth, is_death, skip = kind < 0.25, 0.25 <= kind < 0.5, -1
        if is_birth:
            if count == MAX_ROCKS:
                continue
            _draw_rock(extra, half, law[4])
            gain = np.log(mean / (count + 1))
        elif count == 0:
            continue
        else:
            skip = int(np.random.random() * count)  # noqa: NPY002
            extra[:] = rocks[skip]
            gain = np.log(count / mean) if is_death else _step_rock(extra, law[1])
            if not (max(abs(extra[0]), abs(extra[1])) <= half and law[2] <= 2 * extra[2] <= law[3]):
                continue
        extra[3] = relief_at(extra[0], extra[1], relief, *frame)
        change, n = _change(
            points, weight, terrain, expected, buckets, rocks, count, skip,
            none if is_death else extra, found, value,
        )  # fmt: skip
        if np.log(np.random.random()) >= gain + change:  # noqa: NPY002
            continue
        for m in range(n):
            expected[found[m]] = value[m]
        if is_birth:
            rocks[count] = extra
            count += 1
        elif is_death:
            count -= 1
            rocks[skip] = rocks[count]
        else:
            rocks[skip] = extra
    return count
