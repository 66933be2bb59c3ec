# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled selection of candidate sites from maps, with cost and expected miss."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim_envs.sites._cell_kernels import best_cells, nearest_cells
from lunarsim_envs.sites._flight_kernels import believed, reach
from lunarsim_envs.sites._map_kernels import cell
from lunarsim_envs.sites.reachable_candidates import beaten, replace_unreachable, within

# An averaged map is recomputed if the miss has changed by this fraction.
_ALIKE = 0.05
# Value of `expected_miss.MOST`.
_MOST = 30.0


class Found(NamedTuple):
    """Candidate landing sites of n landers, m places each.

    Position (n, m, 3), p_safe (probability of a safe landing), distance from the current site (m)
    and propellant to reach the candidate (kg), each (n, m); `number` (n,) of candidates. `here` (n,
    3) is the current site: p_safe (NaN if not observed), propellant to reach it, kg, and expected
    miss, m.
    """

    position: np.ndarray
    p_safe: np.ndarray
    distance: np.ndarray
    propellant: np.ndarray
    number: np.ndarray
    here: np.ndarray


@kernel()
def miss_at(time, left, mapped, stated):
    """Return the expected horizontal miss at touchdown, m.

    `time` is now, `left` the time-to-go and `mapped` the time of the map, s. `stated` (3,) is
    `Maps.stated`. The miss grows with the drift of navigation since the map.
    """
    if stated[1] == 0.0:
        return stated[0]
    seconds = max(time - mapped + left + stated[2], 0.0)
    return min(np.hypot(stated[0], stated[1] * seconds), max(_MOST, stated[0]))


@kernel(exact=True)
def one(out, a, w):
    """Add w * a to the row `out`, in place."""
    for c in range(len(out)):
        out[c] += w * a[c]


@kernel(exact=True)
def two(out, a, v, b, w):
    """Add v * a + w * b to the row `out`, in place."""
    for c in range(len(out)):
        out[c] = (out[c] + v * a[c]) + w * b[c]


@kernel(allocates=False)
def spread(p, seen, sigma, out, line, weight):
    """Average a map of p_safe (rows, cols) over a Gaussian landing dispersion.

    `sigma` is the dispersion per axis, in cells. Unobserved cells (`seen` false) get 0. `line` and
    `weight` are scratch.
    """
    rows, cols = p.shape
    reach_ = int(3.0 * sigma + 0.5)
    total = 0.0
    for k in range(-reach_, reach_ + 1):
        total += np.exp(-0.5 * (k / sigma) ** 2)
    for k in range(-reach_, reach_ + 1):
        weight[k + reach_] = np.exp(-0.5 * (k / sigma) ** 2) / total
    line[: cols + 2 * reach_] = 0.0
    middle = line[reach_ : reach_ + cols]
    for r in range(rows):
        low, high = max(r - reach_, 0), min(r + reach_ + 1, rows)
        middle[:] = 0.0
        for k in range(low, high - 1, 2):
            two(middle, p[k], weight[k - r + reach_], p[k + 1], weight[k + 1 - r + reach_])
        if (high - low) % 2 == 1:
            one(middle, p[high - 1], weight[high - 1 - r + reach_])
        out[r] = 0.0
        for k in range(0, 2 * reach_, 2):
            two(out[r], line[k:], weight[k], line[k + 1 :], weight[k + 1])
        one(out[r], line[2 * reach_ :], weight[2 * reach_])
        for c in range(cols):
            capped = min(out[r, c], np.float32(1.0))
            out[r, c] = capped if seen[r, c] else np.float32(0.0)


@kernel()
def spread_at(p, seen, row, col, sigma):
    """Return p_safe of one cell, averaged over a Gaussian landing dispersion."""
    if not seen[row, col]:
        return 0.0
    reach_ = int(3.0 * sigma + 0.5)
    if reach_ == 0:
        return float(p[row, col])
    weight = np.empty(2 * reach_ + 1)
    total, out = 0.0, 0.0
    for k in range(2 * reach_ + 1):
        weight[k] = np.exp(-0.5 * ((k - reach_) / sigma) ** 2)
        total += weight[k]
    for r in range(max(row - reach_, 0), min(row + reach_ + 1, p.shape[0])):
        line = 0.0
        for c in range(max(col - reach_, 0), min(col + reach_ + 1, p.shape[1])):
            line += weight[c - col + reach_] * p[r, c]
        out += weight[r - row + reach_] * line
    return min(out / (total * total), 1.0)


@kernel()
def _aimed(i, time, left, maps, line, weight):
    """Average a lander's map over the expected miss of its site; return the miss, m.

    `time` is now and `left` the time-to-go, s; `line` and `weight` are scratch.
    """
    miss = miss_at(time, left, maps.mapped[i], maps.stated)
    if not abs(miss / maps.aimed[i] - 1.0) <= _ALIKE:
        maps.aimed[i] = miss
        spread(maps.p[i], maps.seen[i], miss / maps.posting, maps.aim[i], line, weight)
    return miss


@kernel()
def _sorted(order, count, p):
    """Write indices of `count` values of p_safe to `order`, by decreasing value.

    Equal values keep their order.
    """
    for n in range(count):
        order[n] = n
    for n in range(1, count):
        one = order[n]
        m = n - 1
        while m >= 0 and p[order[m]] < p[one]:
            order[m + 1] = order[m]
            m -= 1
        order[m + 1] = one


@kernel()
def _costs(i, cells, n, site, state, mass, law, maps, sites, cost):
    """Compute position and propellant of n candidate cells and of the current site.

    `cells` (n, 2) are rows and columns in the map of lander `i`; `state` (2, 3) is the estimated
    position and velocity. Writes `sites` and `cost` (n + 1, ...); the last row is the current site.
    """
    for m in range(n):
        row, col = cells[m, 0], cells[m, 1]
        sites[m, 0] = maps.corner[i, 0] + col * maps.posting
        sites[m, 1] = maps.corner[i, 1] + row * maps.posting
        sites[m, 2] = maps.height[i, row, col]
    for k in range(3):
        sites[n, k] = site[k]
    reach(state, mass, sites[: n + 1], law, cost[: n + 1])


@kernel()
def _average_p_safe(i, time, left, cells, n, cost, maps, p):
    """Write p_safe of n candidates, each averaged over the expected miss of its path.

    `cost` has the time-to-go of each candidate; `left` is used for unreachable candidates.
    """
    for m in range(n):
        row, col = cells[m, 0], cells[m, 1]
        p[m] = maps.aim[i, row, col]
        if maps.stated[1] > 0.0:
            until = cost[m, 1] if np.isfinite(cost[m, 1]) else left
            own = miss_at(time, until, maps.mapped[i], maps.stated)
            p[m] = spread_at(maps.p[i], maps.seen[i], row, col, own / maps.posting)


@kernel(shared=True)
def look(share, mask, y, time, course, law, maps, count, separation, levels, found):
    """Select candidate sites from the maps of landers `mask` (n,), with their cost.

    Candidates are up to `count` cells with the best p_safe, `separation` (m) apart, and the nearest
    cells with p_safe of at least `levels`. Writes them to `found`, by decreasing p_safe. `share` is
    (thread, number of threads).
    """
    rows, cols = maps.p.shape[1], maps.p.shape[2]
    most = 2 * (count + len(levels))
    work, score = np.empty((rows, cols), np.float32), np.empty((rows, cols), np.float32)
    # Padding for the maximum miss in `spread`.
    far = 2 * int(3.0 * max(_MOST, maps.stated[0]) / maps.posting + 0.5) + 1
    weight, line = np.empty(far, np.float32), np.empty(cols + far, np.float32)
    cells = np.empty((most, 2), np.int64)
    highest, more = np.empty(rows, np.float32), np.empty((most, 2), np.int64)
    state, sites, cost = np.empty((2, 3)), np.empty((most + 1, 3)), np.empty((most + 1, 4))
    p, order = np.empty(most), np.empty(most, np.int64)
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        site, left, mass = course.site[i], course.arrival[i] - time[i], y[i, 13]
        aim, corner = maps.aim[i], maps.corner[i]
        miss = _aimed(i, time[i], left, maps, line, weight)
        n = best_cells(aim, corner, maps.posting, site, count, separation, score, highest, cells)
        n = nearest_cells(aim, corner, maps.posting, site, levels, n, highest, cells)
        believed(y[i], course.slip[i], time[i], state)
        _costs(i, cells, n, site, state, mass, law, maps, sites, cost)
        if beaten(aim, cells, cost, n, levels[0]):
            k = within(
                aim, corner, maps.posting, maps.height[i], site, state, mass, law, count,
                separation, levels, work, score, more,
            )  # fmt: skip
            n = replace_unreachable(cells, cost, n, more, k)
            _costs(i, cells, n, site, state, mass, law, maps, sites, cost)
        _average_p_safe(i, time[i], left, cells, n, cost, maps, p)
        _sorted(order, n, p)
        for m in range(n):
            o = order[m]
            for k in range(3):
                found.position[i, m, k] = sites[o, k]
            found.p_safe[i, m] = p[o]
            found.distance[i, m] = np.hypot(sites[o, 0] - site[0], sites[o, 1] - site[1])
            found.propellant[i, m] = cost[o, 0]
        found.number[i] = n
        row, col = cell(i, site[0], site[1], maps)
        inside = 0 <= row < rows and 0 <= col < cols and maps.seen[i, row, col]
        found.here[i, 0] = aim[row, col] if inside else np.nan
        found.here[i, 1] = cost[n, 0]
        found.here[i, 2] = miss
