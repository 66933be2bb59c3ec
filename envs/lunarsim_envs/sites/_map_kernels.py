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


class TrueTerrains(NamedTuple):
    """True terrain of k worlds: hazard class, safety, height, m (k, rows, cols).

    `hazard_class` depends on slope, roughness and distance to the safety edge (`hazard.py`).
    `frame` (3,) has east and north of cell (0, 0), and the grid spacing, m.
    """

    hazard_class: np.ndarray
    safe: np.ndarray
    height: np.ndarray
    frame: np.ndarray


class MapErrorModel(NamedTuple):
    """Statistical error model of a mapper, as `surrogate.Surrogate.errors` returns it.

    `tables` (worlds, scans, classes, nodes): p_safe at evenly spaced normal scores from
    `-max_score` to `max_score`. `noise` (terrains, scans, fields, side, side): periodic standard
    normal fields; `terrain_index` (worlds,): index of the fitted terrain of each world.
    `common_fraction` (worlds, scans): fraction of the variance that all cells of a map share.
    `correlation`: correlation of consecutive maps. `exact`: whether maps are the truth.
    """

    tables: np.ndarray
    max_score: float
    noise: np.ndarray
    terrain_index: np.ndarray
    common_fraction: np.ndarray
    correlation: float
    exact: bool


class Maps(NamedTuple):
    """Hazard maps of n landers: p_safe, observed mask and height, m (n, rows, cols).

    `p` is p_safe, the probability of safe terrain; `seen` marks observed cells. `corner` (n, 2)
    and `posting`: position of cell (0, 0) and spacing of cells, m. `averaged` (n, rows, cols) is
    p_safe averaged over the expected miss `averaged_miss` (n,), m (NaN: not computed).
    `miss_params` (3,): touchdown sigma, m, drift velocity sigma, m/s, and duration of the vertical
    descent, s. `map_time` (n,): time of the last map, s.
    """

    corner: np.ndarray
    posting: float
    p: np.ndarray
    seen: np.ndarray
    height: np.ndarray
    averaged: np.ndarray
    averaged_miss: np.ndarray
    miss_params: np.ndarray
    map_time: np.ndarray


@kernel(inline=True)
def _interpolate_p_safe(tables, world, scan_index, hazard_class, score, max_score):
    """Interpolate p_safe of a hazard class at a standard normal `score`.

    `tables` and `max_score` are fields of `MapErrorModel`.
    """
    nodes = tables.shape[3]
    position = (min(max(score, -max_score), max_score) + max_score) * (
        (nodes - 1) / (2.0 * max_score)
    )
    low = min(int(position), nodes - 2)
    fraction = position - low
    return (1.0 - fraction) * tables[world, scan_index, hazard_class, low] + fraction * tables[
        world, scan_index, hazard_class, low + 1
    ]


@kernel()
def sensor_axes(direction, out):
    """Compute the axes (3, 3) of a sensor that points along `direction` (3,).

    The rows of `out` are image x (horizontal), image y and boresight, as unit vectors.
    """
    size = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    for k in range(3):
        out[2, k] = direction[k] / size
    level = np.hypot(out[2, 0], out[2, 1])
    if level > 1e-9:
        out[0, 0], out[0, 1], out[0, 2] = out[2, 1] / level, -out[2, 0] / level, 0.0
    else:
        out[0, 0], out[0, 1], out[0, 2] = 1.0, 0.0, 0.0
    out[1, 0] = out[2, 1] * out[0, 2] - out[2, 2] * out[0, 1]
    out[1, 1] = out[2, 2] * out[0, 0] - out[2, 0] * out[0, 2]
    out[1, 2] = out[2, 0] * out[0, 1] - out[2, 1] * out[0, 0]


@kernel()
def _sample_placement(noise, key, first, out):
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
def _noise_at(noise, terrain, scan_index, placement, r, c):
    """Return the noise at map cell (r, c), for a placement of `_sample_placement`."""
    side = noise.shape[3]
    row, col = (placement[1] + placement[3] * r) % side, (placement[2] + placement[4] * c) % side
    return noise[terrain, scan_index, placement[0], row, col]


@kernel()
def sample_scan(i, key, first, y, time, world, guidance, errors, placements, amplitudes, axes):
    """Sample the random numbers of a LiDAR scan of lander `i`; return its scan index.

    Writes the placement of noise fields to `placements` (2, 5), common offset and noise amplitudes
    to `amplitudes` (3,), and the axes of the LiDAR, which points at the site, to `axes` (3, 3).
    `key` selects the random stream and `first` its first number.
    """
    level = np.empty(2)
    for k in range(2):
        _sample_placement(errors.noise, key, first + 5 * k, placements[k])
        level[k] = normal(key, first + 10 + 2 * k)
    w = 0 if errors.exact else world
    scan_index = min(guidance.scan_count[i], errors.tables.shape[1] - 1)
    common = errors.common_fraction[w, scan_index]
    amplitudes[2] = np.sqrt(1.0 - errors.correlation**2)
    amplitudes[0] = (
        level[0] if scan_index == 0 else errors.correlation * level[0] + amplitudes[2] * level[1]
    )
    amplitudes[0] *= np.sqrt(common)
    amplitudes[1] = np.sqrt(1.0 - common)
    # The LiDAR has no pointing error.
    direction = np.empty(3)
    for k in range(3):
        direction[k] = guidance.site[i, k] - y[k]
    for k in range(2):
        direction[k] -= guidance.drift_velocity[i, k] * time
    sensor_axes(direction, axes)
    return scan_index


@kernel(inline=True)
def scan_cell(
    r, c, true_x, true_y, y, world, scan_index, truth, errors, view, placements, amplitudes, axes
):
    """Return p_safe and height that a simulated scan measures at map cell (r, c).

    `true_x` and `true_y` are the true position of the cell, m; `y` the true state of the lander;
    `view` the result of `fov_and_footprint`. p_safe is -1 for cells that are not in view or without
    known truth. `scan_index` and the last three arguments are results of `sample_scan`.
    """
    row = int(np.floor((true_y - truth.frame[1]) / truth.frame[2] + 0.5))
    col = int(np.floor((true_x - truth.frame[0]) / truth.frame[2] + 0.5))
    if not (0 <= row < truth.hazard_class.shape[1] and 0 <= col < truth.hazard_class.shape[2]):
        return -1.0, 0.0
    hazard_class, height = truth.hazard_class[world, row, col], truth.height[world, row, col]
    if hazard_class == 255:
        return -1.0, 0.0
    dx, dy, dz = true_x - y[0], true_y - y[1], height - y[2]
    depth = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
    room = view[0] * depth - view[1]
    across = axes[0, 0] * dx + axes[0, 1] * dy
    down = axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz
    if not (depth > 0.0 and abs(across) <= room and abs(down) <= room):
        return -1.0, 0.0
    if errors.exact:
        return (1.0 if truth.safe[world, row, col] else 0.0), height
    terrain = errors.terrain_index[world]
    z = _noise_at(errors.noise, terrain, 0, placements[0], r, c)
    if scan_index > 0:
        z = errors.correlation * z + amplitudes[2] * _noise_at(
            errors.noise, terrain, scan_index, placements[1], r, c
        )
    z = amplitudes[0] + amplitudes[1] * z
    return _interpolate_p_safe(
        errors.tables, world, scan_index, hazard_class, z, errors.max_score
    ), height


@kernel()
def _add_scan(i, key, first, y, time, world, guidance, maps, truth, errors, view):
    """Add a simulated LiDAR scan to the map of lander `i`, in `maps`.

    Cells that are not in view keep their values. `key` and `first` select the random numbers of the
    scan; the other arguments are as in `scan`.
    """
    placements, amplitudes, axes = np.empty((2, 5), np.int64), np.empty(3), np.empty((3, 3))
    scan_index = sample_scan(
        i, key, first, y, time, world, guidance, errors, placements, amplitudes, axes
    )
    east, north = guidance.drift_velocity[i, 0] * time, guidance.drift_velocity[i, 1] * time
    for r in range(maps.p.shape[1]):
        true_y = maps.corner[i, 1] + r * maps.posting - north
        for c in range(maps.p.shape[2]):
            true_x = maps.corner[i, 0] + c * maps.posting - east
            p, height = scan_cell(
                r,
                c,
                true_x,
                true_y,
                y,
                world,
                scan_index,
                truth,
                errors,
                view,
                placements,
                amplitudes,
                axes,
            )
            if p >= 0.0:
                maps.seen[i, r, c] = True
                maps.height[i, r, c] = height
                maps.p[i, r, c] = p


@kernel(shared=True)
def scan(
    thread_slice, mask, keys, flight_counts, y, time, world, guidance, maps, truth, errors, view
):
    """Take the due scans of the landers of `mask` (n,) and update their maps.

    `y` (n, 15) are the true states and `world` (n,) the terrain of each lander. `view` is the
    result of `fov_and_footprint`; `thread_slice` is (thread, number of threads).
    """
    for i in range(thread_slice[0], len(y), thread_slice[1]):
        if not mask[i]:
            continue
        key, first = map_stream(keys[i], flight_counts[i])
        _add_scan(i, key, first, y[i], time[i], world[i], guidance, maps, truth, errors, view)
        record_scan(i, time[i], guidance, maps)


@kernel()
def map_stream(key, flight_count):
    """Return the random stream and first index for the maps of a flight.

    `key` is the random key of the lander and `flight_count` the number of its flights.
    """
    return np.uint64(key) ^ _ERRORS, (flight_count - 1) * _DRAWS


@kernel()
def record_scan(i, time, guidance, maps):
    """Record in `guidance` and `maps` that lander `i` has taken a scan at `time`, s.

    The height of its site is set from its map, if the map has observed the site.
    """
    guidance.scan_count[i] += 1
    guidance.event[i] = NOTHING
    maps.map_time[i] = time
    maps.averaged_miss[i] = np.nan
    row, col = map_cell(i, guidance.site[i, 0], guidance.site[i, 1], maps)
    rows, cols = maps.p.shape[1], maps.p.shape[2]
    if 0 <= row < rows and 0 <= col < cols and maps.seen[i, row, col]:
        guidance.site[i, 2] = maps.height[i, row, col]


@kernel(shared=True)
def record_scans(thread_slice, mask, time, guidance, maps):
    """Record scans of landers `mask` (n,) whose maps were updated by other code."""
    for i in range(thread_slice[0], len(mask), thread_slice[1]):
        if mask[i]:
            record_scan(i, time[i], guidance, maps)


@kernel()
def map_cell(i, x, y, maps):
    """Return row and column of the map cell of lander `i` at (x, y), m, local frame.

    The indices may be outside the map.
    """
    col = int(np.floor((x - maps.corner[i, 0]) / maps.posting + 0.5))
    row = int(np.floor((y - maps.corner[i, 1]) / maps.posting + 0.5))
    return row, col


@kernel(shared=True)
def downsample(thread_slice, mask, p, seen, out):
    """Downsample the maps of landers `mask` (n,) to p_safe and observed fraction.

    `p` and `seen` are (n, rows, cols). Writes the means in equal blocks to `out` (n, 2, cells,
    cells). `thread_slice` is (thread, number of threads).
    """
    rows, cols, cells = p.shape[1], p.shape[2], out.shape[2]
    total = np.zeros((cells, cells))
    for i in range(thread_slice[0], len(p), thread_slice[1]):
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


downsample_single = partial(cast(Any, downsample).compiled, (0, 1))


@kernel(shared=True)
def crop(thread_slice, p, observed, corner, posting, centers, spacing, out):
    """Sample maps around points: p_safe and observed mask, into `out` (n, 2, k, k).

    `p` and `observed` are (n, rows, cols) with `corner` (n, 2) and cell size `posting`; `centers`
    (n, 2+) are the points, and `spacing` the distance of samples, m. `thread_slice` is (thread,
    number of threads).
    """
    half = out.shape[2] // 2
    for i in range(thread_slice[0], len(p), thread_slice[1]):
        for a in range(out.shape[2]):
            y = centers[i, 1] + (a - half) * spacing
            row = int(np.floor((y - corner[i, 1]) / posting + 0.5))
            for b in range(out.shape[3]):
                x = centers[i, 0] + (b - half) * spacing
                col = int(np.floor((x - corner[i, 0]) / posting + 0.5))
                inside = 0 <= row < p.shape[1] and 0 <= col < p.shape[2]
                known = inside and observed[i, row, col]
                out[i, 0, a, b] = p[i, row, col] if known else 0.0
                out[i, 1, a, b] = 1.0 if known else 0.0
