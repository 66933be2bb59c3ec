"""Compiled choice among the sites on maps: which stand out, what each costs, how it is missed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim_envs.sites._flight_kernels import believed, reach
from lunarsim_envs.sites._map_kernels import cell

# Of `candidates.best_cells`.
_PRICE = np.float32(1e-3 / 100.0)
# Stands for cells that are no site.
_NOWHERE = np.float32(-1e30)
# A spread map is made anew where the miss has changed by this share.
_ALIKE = 0.05
# Of `expected_miss.MOST`.
_MOST = 30.0


class Found(NamedTuple):
    """Sites of lanes (n, m, ...): position, p_safe, distance, propellant; how many (n,).

    `here` (n, 3): p_safe at the site flown to (NaN: not seen), propellant to it, expected miss.
    """

    position: np.ndarray
    p_safe: np.ndarray
    distance: np.ndarray
    propellant: np.ndarray
    number: np.ndarray
    here: np.ndarray


@kernel()
def miss_at(time, left, mapped, stated):
    """Return the expected miss of a site that takes so long from now on, m; see `Aim.misses`."""
    if stated[1] == 0.0:
        return stated[0]
    seconds = max(time - mapped + left + stated[2], 0.0)
    return min(np.hypot(stated[0], stated[1] * seconds), max(_MOST, stated[0]))


@kernel()
def spread(p, seen, sigma, out, work, weight):
    """Write p_safe (rows, cols) spread by a miss of so many cells; see `HazardMap.dispersed`."""
    rows, cols = p.shape
    reach_ = int(3.0 * sigma + 0.5)
    total = 0.0
    for k in range(-reach_, reach_ + 1):
        total += np.exp(-0.5 * (k / sigma) ** 2)
    for k in range(-reach_, reach_ + 1):
        weight[k + reach_] = np.exp(-0.5 * (k / sigma) ** 2) / total
    for r in range(rows):
        for c in range(cols):
            work[r, c] = 0.0
        for k in range(-reach_, reach_ + 1):
            if 0 <= r + k < rows:
                w = weight[k + reach_]
                for c in range(cols):
                    work[r, c] += w * p[r + k, c]
    for r in range(rows):
        for c in range(cols):
            out[r, c] = 0.0
        for k in range(-reach_, reach_ + 1):
            w = weight[k + reach_]
            for c in range(max(-k, 0), min(cols - k, cols)):
                out[r, c] += w * work[r, c + k]
        for c in range(cols):
            if not seen[r, c]:
                out[r, c] = 0.0
            elif out[r, c] > 1.0:
                out[r, c] = 1.0


@kernel()
def spread_at(p, seen, row, col, sigma):
    """Return what `spread` gives at one cell."""
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


@kernel(finite=True)
def _scored(aim, dy, corner, posting, site, score):
    """Write how good each cell of a row is (cols,), and return the best of them and of its aim."""
    best, most = np.float32(_NOWHERE), np.float32(0.0)
    for c in range(len(aim)):
        dx = np.float32(corner + c * posting - site)
        far = np.sqrt(dx * dx + dy * dy)
        good = aim[c] - _PRICE * far if aim[c] > 0.0 else np.float32(_NOWHERE)
        score[c] = good
        best = max(best, good)
        most = max(most, aim[c])
    return best, most


@kernel(finite=True)
def _greatest(score):
    """Return the greatest of a row."""
    best = np.float32(_NOWHERE)
    for c in range(len(score)):
        best = max(best, score[c])
    return best


@kernel()
def best_cells(aim, corner, posting, site, count, separation, score, highest, cells):
    """Write up to `count` cells (m, 2) of greatest aim and return how many.

    See `candidates.best_cells`. `highest` (rows,) takes the greatest aim of each row.
    """
    rows, cols = aim.shape
    most = np.empty(rows, np.float32)
    for r in range(rows):
        dy = np.float32(corner[1] + r * posting - site[1])
        most[r], highest[r] = _scored(aim[r], dy, corner[0], posting, site[0], score[r])
    wide = int(np.ceil(separation / posting))
    for n in range(count):
        row = 0
        for r in range(1, rows):
            if most[r] > most[row]:
                row = r
        if most[row] <= _NOWHERE:
            return n
        col = 0
        while score[row, col] != most[row]:
            col += 1
        cells[n, 0], cells[n, 1] = row, col
        for r in range(max(row - wide, 0), min(row + wide + 1, rows)):
            for c in range(max(col - wide, 0), min(col + wide + 1, cols)):
                if np.hypot(r - row, c - col) * posting < separation:
                    score[r, c] = _NOWHERE
            most[r] = _greatest(score[r])
    return count


@kernel()
def _nearest(aim, corner, posting, site, level, highest, place):
    """Write the nearest cell of an aim of at least `level` (2,); tell whether there is one.

    Rows are gone through from the site's outward, as far as one may still be nearer.
    """
    rows, cols = aim.shape
    middle = min(max(int(np.floor((site[1] - corner[1]) / posting + 0.5)), 0), rows - 1)
    best = np.inf
    for k in range(2 * rows):
        r = middle + (k + 1) // 2 if k % 2 == 1 else middle - k // 2
        if not 0 <= r < rows:
            continue
        dy = corner[1] + r * posting - site[1]
        if dy * dy > best or highest[r] < level:
            continue
        for c in range(cols):
            if aim[r, c] >= level:
                dx = corner[0] + c * posting - site[0]
                far = dx * dx + dy * dy
                if far < best or (far == best and r < place[0]):
                    best = far
                    place[0], place[1] = r, c
    return best < np.inf


@kernel()
def nearest_cells(aim, corner, posting, site, levels, count, highest, cells):
    """Add the nearest cell at each level of aim that is not among them; return how many."""
    place = np.empty(2, np.int64)
    for k in range(len(levels)):
        known = not _nearest(aim, corner, posting, site, levels[k], highest, place)
        for n in range(count):
            known = known or (cells[n, 0] == place[0] and cells[n, 1] == place[1])
        if not known:
            cells[count, 0], cells[count, 1] = place[0], place[1]
            count += 1
    return count


@kernel()
def _aimed(i, time, left, maps, work, weight):
    """Spread a lane's map by the miss of its site, and return that miss, m."""
    miss = miss_at(time, left, maps.mapped[i], maps.stated)
    if not abs(miss / maps.aimed[i] - 1.0) <= _ALIKE:
        maps.aimed[i] = miss
        spread(maps.p[i], maps.seen[i], miss / maps.posting, maps.aim[i], work, weight)
    return miss


@kernel()
def _sorted(order, count, p):
    """Order rows by falling p_safe, those alike as they were."""
    for n in range(count):
        order[n] = n
    for n in range(1, count):
        one = order[n]
        m = n - 1
        while m >= 0 and p[order[m]] < p[one]:
            order[m + 1] = order[m]
            m -= 1
        order[m + 1] = one


@kernel(shared=True)
def look(share, mask, y, time, course, law, maps, count, separation, levels, found):
    """Write the sites that the lanes of `mask` (n,) may choose from, and what each costs.

    See `OnboardComputer.observe` and `candidates.candidate_sites`.
    """
    rows, cols = maps.p.shape[1], maps.p.shape[2]
    most = count + len(levels)
    work, score = np.empty((rows, cols), np.float32), np.empty((rows, cols), np.float32)
    weight, cells = np.empty(2 * max(rows, cols) + 3, np.float32), np.empty((most, 2), np.int64)
    highest = np.empty(rows, np.float32)
    state, sites, cost = np.empty((2, 3)), np.empty((most + 1, 3)), np.empty((most + 1, 4))
    p, order = np.empty(most), np.empty(most, np.int64)
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        site, left = course.site[i], course.arrival[i] - time[i]
        aim, corner = maps.aim[i], maps.corner[i]
        miss = _aimed(i, time[i], left, maps, work, weight)
        n = best_cells(aim, corner, maps.posting, site, count, separation, score, highest, cells)
        n = nearest_cells(aim, corner, maps.posting, site, levels, n, highest, cells)
        for m in range(n):
            row, col = cells[m, 0], cells[m, 1]
            sites[m, 0] = corner[0] + col * maps.posting
            sites[m, 1] = corner[1] + row * maps.posting
            sites[m, 2] = maps.height[i, row, col]
        for k in range(3):
            sites[n, k] = site[k]
        believed(y[i], course.slip[i], time[i], state)
        reach(state, y[i, 13], sites[: n + 1], law, cost[: n + 1])
        for m in range(n):
            row, col = cells[m, 0], cells[m, 1]
            p[m] = aim[row, col]
            if maps.stated[1] > 0.0:
                until = cost[m, 1] if np.isfinite(cost[m, 1]) else left
                own = miss_at(time[i], until, maps.mapped[i], maps.stated)
                p[m] = spread_at(maps.p[i], maps.seen[i], row, col, own / maps.posting)
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
