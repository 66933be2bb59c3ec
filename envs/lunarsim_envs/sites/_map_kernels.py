# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled hazard maps (n, rows, cols) of worlds, in each lander's local frame."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np

from lunarsim._jit import kernel
from lunarsim_envs.descent._kernels import normal, uniform
from lunarsim_envs.sites._flight_kernels import NOTHING

# Random stream of the maps.
_ERRORS = np.uint64(0xE7037ED1A0B428DB)
_DRAWS = 16


class Pool(NamedTuple):
    """True terrain of k worlds: hazard class, safety, height, m (k, rows, cols).

    `kind` is the class of a cell by slope, roughness and distance to the safety edge (`hazard.py`).
    `frame` (3,) has east and north of cell (0, 0), and the grid spacing, m.
    """

    kind: np.ndarray
    safe: np.ndarray
    height: np.ndarray
    frame: np.ndarray


class Errors(NamedTuple):
    """Statistical error model of a mapper, as `surrogate.Surrogate.errors` returns it.

    `tables` (worlds, scans, classes, nodes): p_safe at evenly spaced normal scores from `-most` to
    `most`. `noise` (terrains, scans, fields, side, side): periodic standard normal fields; `bank`
    (worlds,): index of the terrain of each world. `common` (worlds, scans): fraction of the
    variance that is common to a complete map. `kept`: correlation of consecutive maps. `exact`:
    whether maps are the truth.
    """

    tables: np.ndarray
    most: float
    noise: np.ndarray
    bank: np.ndarray
    common: np.ndarray
    kept: float
    exact: bool


class Maps(NamedTuple):
    """Hazard maps of n landers: p_safe, observed mask and height, m (n, rows, cols).

    `p` is p_safe, the probability of a safe landing; `seen` marks observed cells.
    `corner` (n, 2) and `posting`: position of cell (0, 0) and spacing of cells, m.
    `aim` (n, rows, cols) is p_safe averaged over the miss `aimed` (n,), m (NaN: not computed).
    `stated` (3,): touchdown sigma, m, drift velocity sigma, m/s, and duration of the vertical
    descent, s. `mapped` (n,): time of the last map, s.
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


@kernel(inline=True)
def _p_safe_at(tables, world, stage, kind, z, most):
    """Interpolate p_safe of a terrain class (`kind`) at a standard normal score `z`.

    `tables` and `most` are fields of `Errors`; `world` and `stage` index the world and the scan.
    """
    nodes = tables.shape[3]
    at = (min(max(z, -most), most) + most) * ((nodes - 1) / (2.0 * most))
    low = min(int(at), nodes - 2)
    part = at - low
    return (1.0 - part) * tables[world, stage, kind, low] + part * tables[
        world, stage, kind, low + 1
    ]


@kernel()
def axes_to(way, out):
    """Compute the axes (3, 3) of a sensor that points along `way` (3,).

    The rows of `out` are image x (horizontal), image y and boresight, as unit vectors.
    """
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
    """Sample noise field, offsets and orientation of a map at random, into `out` (5,).

    `key` selects the random stream and `first` its first number.
    """
    fields, side = noise.shape[2], noise.shape[3]
    out[0] = min(int(uniform(key, first) * fields), fields - 1)
    out[1] = min(int(uniform(key, first + 1) * side), side - 1)
    out[2] = min(int(uniform(key, first + 2) * side), side - 1)
    out[3] = 1 if uniform(key, first + 3) < 0.5 else -1
    out[4] = 1 if uniform(key, first + 4) < 0.5 else -1


@kernel(inline=True)
def _noise(noise, bank, scan, place, r, c):
    """Return the noise at map cell (r, c), with the placement from `_place`."""
    side = noise.shape[3]
    row, col = (place[1] + place[3] * r) % side, (place[2] + place[4] * c) % side
    return noise[bank, scan, place[0], row, col]


@kernel()
def drawn_scan(i, key, first, y, time, world, course, errors, places, draw, axes):
    """Sample the random numbers of a LiDAR scan of lander `i`; return its index.

    Writes the placement of noise fields to `places` (2, 5), common offset and noise amplitudes to
    `draw` (3,), and the axes of the LiDAR, which points at the site, to `axes` (3, 3).
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
    # The LiDAR has no pointing error.
    way = np.empty(3)
    for k in range(3):
        way[k] = course.site[i, k] - y[k]
    for k in range(2):
        way[k] -= course.slip[i, k] * time
    axes_to(way, axes)
    return stage


@kernel(inline=True)
def scanned_cell(r, c, true_x, true_y, y, world, stage, pool, errors, view, places, draw, axes):
    """Return p_safe and height that a simulated scan measures at map cell (r, c).

    `true_x` and `true_y` are the true position of the cell, m; `y` the true state of the lander;
    `view` the result of `fov_and_footprint`. p_safe is -1 for cells that are not in view or without
    known truth. Other arguments are results of `drawn_scan`.
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
    return _p_safe_at(errors.tables, world, stage, kind, z, errors.most), height


@kernel()
def _lay(i, key, first, y, time, world, course, maps, pool, errors, view):
    """Add a simulated LiDAR scan to the map of lander `i`.

    `key` and `first` select the random numbers of the scan; the other arguments are as in `scan`.
    """
    places, draw, axes = np.empty((2, 5), np.int64), np.empty(3), np.empty((3, 3))
    stage = drawn_scan(i, key, first, y, time, world, course, errors, places, draw, axes)
    east, north = course.slip[i, 0] * time, course.slip[i, 1] * time
    for r in range(maps.p.shape[1]):
        true_y = maps.corner[i, 1] + r * maps.posting - north
        for c in range(maps.p.shape[2]):
            true_x = maps.corner[i, 0] + c * maps.posting - east
            p, height = scanned_cell(
                r, c, true_x, true_y, y, world, stage, pool, errors, view, places, draw, axes
            )
            if p >= 0.0:
                maps.seen[i, r, c] = True
                maps.height[i, r, c] = height
                maps.p[i, r, c] = p


@kernel(shared=True)
def scan(share, mask, keys, flight_counts, y, time, world, course, maps, pool, errors, view):
    """Take the due scans of the landers of `mask` (n,) and update their maps.

    `y` (n, 15) are the true states and `world` (n,) the terrain of each lander. `view` is the
    result of `fov_and_footprint`; `share` is (thread, number of threads).
    """
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        key, first = drawn_from(keys[i], flight_counts[i])
        _lay(i, key, first, y[i], time[i], world[i], course, maps, pool, errors, view)
        taken(i, time[i], course, maps)


@kernel()
def drawn_from(key, flight_count):
    """Return random stream and index of its first number for the maps of a flight."""
    return np.uint64(key) ^ _ERRORS, (flight_count - 1) * _DRAWS


@kernel()
def taken(i, time, course, maps):
    """Record that lander `i` has taken a scan, and set its site's height from its map."""
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
    """Record scans of landers `mask` (n,) whose maps were updated by other code."""
    for i in range(share[0], len(mask), share[1]):
        if mask[i]:
            taken(i, time[i], course, maps)


@kernel()
def cell(i, x, y, maps):
    """Return row and column of the map cell of lander `i` at (x, y), m, local frame.

    The indices may be outside the map.
    """
    col = int(np.floor((x - maps.corner[i, 0]) / maps.posting + 0.5))
    row = int(np.floor((y - maps.corner[i, 1]) / maps.posting + 0.5))
    return row, col


@kernel(shared=True)
def shrink(share, mask, p, seen, out):
    """Downsample the maps of landers `mask` (n,) to p_safe and observed fraction.

    `p` and `seen` are (n, rows, cols), `out` is (n, 2, cells, cells). `share` is (thread, number of
    threads).
    """
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
    """Sample maps around points: p_safe and observed mask, into `out` (n, 2, k, k).

    `p` and `seen` are (n, rows, cols) with `corner` (n, 2) and cell size `posting`; `middle` (n,
    2+) are the points, and `spacing` the distance of samples, m. `share` is (thread, number of
    threads).
    """
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
