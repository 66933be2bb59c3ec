"""Compiled maps of a pool's worlds, and the sites to choose from on them.

Maps are (n, rows, cols), row 0 south, in each lander's own frame, which has drifted off the true
one by the time of the scan. `frame` (3,) of the pool is the centre of its cell (0, 0) and its
posting.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np

from lunarsim._jit import kernel
from lunarsim_envs.descent._kernels import normal, uniform
from lunarsim_envs.sites._flight_kernels import NOTHING, believed, reach

# Sets the draws of maps apart from others.
_ERRORS = np.uint64(0xE7037ED1A0B428DB)
_DRAWS = 16
# Of `candidates.best_cells`.
_PRICE = np.float32(1e-3 / 100.0)
# Stands for cells that are no site.
_NOWHERE = np.float32(-1e30)
# A spread map is made anew where the miss has changed by this share.
_ALIKE = 0.05
# Of `expected_miss.MOST`.
_MOST = 30.0


class Pool(NamedTuple):
    """True layers of each world (k, rows, cols): class, exact safety, height (m); and where."""

    kind: np.ndarray
    safe: np.ndarray
    height: np.ndarray
    frame: np.ndarray


class Errors(NamedTuple):
    """A mapper's errors; see `surrogate.Surrogate`.

    `tables` (worlds, scans, classes, nodes): p_safe by class, at even steps of a standard normal
    number from `-most` to `most`. `noise` (grounds, scans, fields, m, m): such numbers in space,
    periodic; `bank` (worlds,): of which ground.
    `common` (worlds, scans): share of the variance that a whole map has in common. `kept`:
    correlation of a map with the one before. `exact`: the truth instead.
    """

    tables: np.ndarray
    most: float
    noise: np.ndarray
    bank: np.ndarray
    common: np.ndarray
    kept: float
    exact: bool


class Maps(NamedTuple):
    """Maps of lanes: corner (n, 2), m, posting, m; layers p_safe, seen and height (n, rows, cols).

    `aim` (n, rows, cols) is p_safe spread by the miss `aimed` (n,), m, NaN: not made yet; `stated`
    (3,): miss without drift, m, of the drift's velocity, m/s, and time of the last descent, s.
    `mapped` (n,): when, s.
    """

    corner: np.ndarray
    posting: float
    p: np.ndarray
    seen: np.ndarray
    height: np.ndarray
    aim: np.ndarray
    aimed: np.ndarray
    stated: np.ndarray
    mapped: np.ndarray


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


@kernel(inline=True)
def _told(tables, world, stage, kind, z, most):
    """Return the p_safe of a class at a standard normal number."""
    nodes = tables.shape[3]
    at = (min(max(z, -most), most) + most) * ((nodes - 1) / (2.0 * most))
    low = min(int(at), nodes - 2)
    part = at - low
    return (1.0 - part) * tables[world, stage, kind, low] + part * tables[
        world, stage, kind, low + 1
    ]


@kernel()
def axes_to(way, out):
    """Write image x, image y and boresight (3, 3) of a camera that looks along a way (3,)."""
    size = np.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
    for k in range(3):
        out[2, k] = way[k] / size
    level = np.hypot(out[2, 0], out[2, 1])
    if level > 1e-9:
        out[0, 0], out[0, 1], out[0, 2] = out[2, 1] / level, -out[2, 0] / level, 0.0
    else:
        out[0, 0], out[0, 1], out[0, 2] = 1.0, 0.0, 0.0
    out[1, 0] = out[2, 1] * out[0, 2] - out[2, 2] * out[0, 1]
    out[1, 1] = out[2, 2] * out[0, 0] - out[2, 0] * out[0, 2]
    out[1, 2] = out[2, 0] * out[0, 1] - out[2, 1] * out[0, 0]


@kernel()
def _place(noise, key, first, out):
    """Draw which field of noise and where in it a map begins, turned which way (5,)."""
    fields, side = noise.shape[2], noise.shape[3]
    out[0] = min(int(uniform(key, first) * fields), fields - 1)
    out[1] = min(int(uniform(key, first + 1) * side), side - 1)
    out[2] = min(int(uniform(key, first + 2) * side), side - 1)
    out[3] = 1 if uniform(key, first + 3) < 0.5 else -1
    out[4] = 1 if uniform(key, first + 4) < 0.5 else -1


@kernel(inline=True)
def _noise(noise, bank, scan, place, r, c):
    side = noise.shape[3]
    row, col = (place[1] + place[3] * r) % side, (place[2] + place[4] * c) % side
    return noise[bank, scan, place[0], row, col]


@kernel()
def drawn_scan(i, key, first, y, time, world, course, errors, places, draw, axes):
    """Draw what a scan of a lane is to show, and return which of the scans it is.

    Writes where in the noise the first and the last map lie, `places` (2, 5); mean and deviation of
    a map's normal numbers, and the deviation of what is new in the last, `draw` (3,); and the axes
    of the LiDAR, see `axes_to`.
    """
    level = np.empty(2)
    for k in range(2):
        _place(errors.noise, key, first + 5 * k, places[k])
        level[k] = normal(key, first + 10 + 2 * k)
    w = 0 if errors.exact else world
    stage = min(course.scanned[i], errors.tables.shape[1] - 1)
    common = errors.common[w, stage]
    draw[2] = np.sqrt(1.0 - errors.kept**2)
    draw[0] = level[0] if stage == 0 else errors.kept * level[0] + draw[2] * level[1]
    draw[0] *= np.sqrt(common)
    draw[1] = np.sqrt(1.0 - common)
    # Where the LiDAR is pointed, it truly looks.
    way = np.empty(3)
    for k in range(3):
        way[k] = course.site[i, k] - y[k]
    for k in range(2):
        way[k] -= course.slip[i, k] * time
    axes_to(way, axes)
    return stage


@kernel(inline=True)
def told_at(r, c, true_x, true_y, y, world, stage, pool, errors, view, places, draw, axes):
    """Return p_safe and height that a scan gives a cell (r, c) of a map, at a true point.

    p_safe is -1 where the cell is not in view, or nothing is known of it.
    """
    row = int(np.floor((true_y - pool.frame[1]) / pool.frame[2] + 0.5))
    col = int(np.floor((true_x - pool.frame[0]) / pool.frame[2] + 0.5))
    if not (0 <= row < pool.kind.shape[1] and 0 <= col < pool.kind.shape[2]):
        return -1.0, 0.0
    kind, height = pool.kind[world, row, col], pool.height[world, row, col]
    if kind == 255:
        return -1.0, 0.0
    dx, dy, dz = true_x - y[0], true_y - y[1], height - y[2]
    depth = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
    room = view[0] * depth - view[1]
    across = axes[0, 0] * dx + axes[0, 1] * dy
    down = axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz
    if not (depth > 0.0 and abs(across) <= room and abs(down) <= room):
        return -1.0, 0.0
    if errors.exact:
        return (1.0 if pool.safe[world, row, col] else 0.0), height
    bank = errors.bank[world]
    z = _noise(errors.noise, bank, 0, places[0], r, c)
    if stage > 0:
        z = errors.kept * z + draw[2] * _noise(errors.noise, bank, stage, places[1], r, c)
    z = draw[0] + draw[1] * z
    return _told(errors.tables, world, stage, kind, z, errors.most), height


@kernel()
def _lay(i, key, first, y, time, world, course, maps, pool, errors, view):
    """Draw what a scan adds to the map of a lane."""
    places, draw, axes = np.empty((2, 5), np.int64), np.empty(3), np.empty((3, 3))
    stage = drawn_scan(i, key, first, y, time, world, course, errors, places, draw, axes)
    east, north = course.slip[i, 0] * time, course.slip[i, 1] * time
    for r in range(maps.p.shape[1]):
        true_y = maps.corner[i, 1] + r * maps.posting - north
        for c in range(maps.p.shape[2]):
            true_x = maps.corner[i, 0] + c * maps.posting - east
            p, height = told_at(
                r, c, true_x, true_y, y, world, stage, pool, errors, view, places, draw, axes
            )
            if p >= 0.0:
                maps.seen[i, r, c] = True
                maps.height[i, r, c] = height
                maps.p[i, r, c] = p


@kernel(shared=True)
def scan(share, mask, keys, begun, y, time, world, course, maps, pool, errors, view):
    """Let the lanes of `mask` (n,) take the scan that is due, and go on."""
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        key, first = drawn_from(keys[i], begun[i])
        _lay(i, key, first, y[i], time[i], world[i], course, maps, pool, errors, view)
        taken(i, time[i], course, maps)


@kernel()
def drawn_from(key, begun):
    """Return from which key, and which draw on, the maps of a flight are drawn."""
    return np.uint64(key) ^ _ERRORS, (begun - 1) * _DRAWS


@kernel()
def taken(i, time, course, maps):
    """Note that a lane has taken a scan; the site takes its height from the map."""
    course.scanned[i] += 1
    course.event[i] = NOTHING
    maps.mapped[i] = time
    maps.aimed[i] = np.nan
    row, col = cell(i, course.site[i, 0], course.site[i, 1], maps)
    rows, cols = maps.p.shape[1], maps.p.shape[2]
    if 0 <= row < rows and 0 <= col < cols and maps.seen[i, row, col]:
        course.site[i, 2] = maps.height[i, row, col]


@kernel(shared=True)
def took(share, mask, time, course, maps):
    """Note that the lanes of `mask` (n,) have taken a scan that somebody else has mapped."""
    for i in range(share[0], len(mask), share[1]):
        if mask[i]:
            taken(i, time[i], course, maps)


@kernel()
def cell(i, x, y, maps):
    """Return row and column of the cell of a lane's map that holds a point; may lie outside."""
    col = int(np.floor((x - maps.corner[i, 0]) / maps.posting + 0.5))
    row = int(np.floor((y - maps.corner[i, 1]) / maps.posting + 0.5))
    return row, col


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


@kernel(shared=True)
def shrink(share, mask, p, seen, out):
    """Write mean p_safe and share seen of equal blocks of maps (n, 2, cells, cells)."""
    rows, cols, cells = p.shape[1], p.shape[2], out.shape[2]
    total = np.zeros((cells, cells))
    for i in range(share[0], len(p), share[1]):
        if not mask[i]:
            continue
        out[i] = 0.0
        total[:] = 0.0
        for r in range(rows):
            a = (r * cells) // rows
            for c in range(cols):
                b = (c * cells) // cols
                total[a, b] += 1.0
                out[i, 0, a, b] += p[i, r, c]
                out[i, 1, a, b] += 1.0 if seen[i, r, c] else 0.0
        for a in range(cells):
            for b in range(cells):
                for k in range(2):
                    out[i, k, a, b] = min(out[i, k, a, b] / max(total[a, b], 1.0), 1.0)


shrink_here = partial(cast(Any, shrink).compiled, (0, 1))


@kernel(shared=True)
def crop(share, p, seen, corner, posting, middle, spacing, out):
    """Write p_safe and whether seen about points (n, 2), `spacing` metres apart (n, 2, m, m)."""
    half = out.shape[2] // 2
    for i in range(share[0], len(p), share[1]):
        for a in range(out.shape[2]):
            y = middle[i, 1] + (a - half) * spacing
            row = int(np.floor((y - corner[i, 1]) / posting + 0.5))
            for b in range(out.shape[3]):
                x = middle[i, 0] + (b - half) * spacing
                col = int(np.floor((x - corner[i, 0]) / posting + 0.5))
                inside = 0 <= row < p.shape[1] and 0 <= col < p.shape[2]
                known = inside and seen[i, row, col]
                out[i, 0, a, b] = p[i, row, col] if known else 0.0
                out[i, 1, a, b] = 1.0 if known else 0.0
