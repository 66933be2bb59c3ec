# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled choice of a site on a sparse lattice of cells, for a million descents."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim_envs.sites._flight_kernels import NOTHING, optimal_time_to_go
from lunarsim_envs.sites._map_kernels import map_stream, sample_scan, scan_cell

# p_safe of a site that is safe enough; number of sites tested for reach.
_ENOUGH, _TRIES = 0.95, 6


@kernel(inline=True)
def _mean_around(
    r, c, neighbour_distance, corner, posting, drift_velocity, time, y, world, scan_index, truth,
    errors, view, placements, amplitudes, axes,
):  # fmt: skip
    """Return mean p_safe of a cell (r, c) and 4 neighbours, and the cell's height.

    The neighbours are `neighbour_distance` cells away; unobserved ones count as 0. The mean is -1
    if the cell itself is not observed. The other arguments are those of `_map_kernels.scan_cell`.
    """
    total, height, is_unobserved = 0.0, 0.0, False
    for k in range(5):
        a = r + (neighbour_distance if k == 1 else -neighbour_distance if k == 2 else 0)
        b = c + (neighbour_distance if k == 3 else -neighbour_distance if k == 4 else 0)
        x = corner[0] + b * posting - drift_velocity[0] * time
        north = corner[1] + a * posting - drift_velocity[1] * time
        p, z = scan_cell(
            a, b, x, north, y, world, scan_index, truth, errors, view, placements, amplitudes, axes
        )
        if k == 0:
            height = z
            is_unobserved = p < 0.0
        total += max(p, 0.0)
    return (-1.0 if is_unobserved else 0.2 * total), height


@kernel()
def _is_better(p, distance, best_p, best_distance):
    """Return whether a site is better than the best site so far.

    Sites with p_safe of 0.95 or more are better than all others, and are compared by their
    distance; sites with less are compared by p_safe.
    """
    if p >= _ENOUGH:
        return best_p < _ENOUGH or distance < best_distance
    return best_p < _ENOUGH and p > best_p


@kernel()
def _divert_to_best(i, y, time, n, sites, p, distance, guidance, law, site_p_safe):
    """Divert lander `i` to the best reachable site among the six best of n sites.

    `sites` (n, 3) have p_safe `p` and a distance from the current site (n,). Writes the new site
    and its arrival time to `guidance` and its p_safe to `site_p_safe`. If none of the six is
    reachable, the lander keeps its site. `p` is changed.
    """
    for _ in range(min(n, _TRIES)):
        best = 0
        for k in range(1, n):
            if _is_better(p[k], distance[k], p[best], distance[best]):
                best = k
        if p[best] < 0.0:
            return
        time_to_go = optimal_time_to_go(y, guidance.drift_velocity[i], time, sites[best], law)
        if np.isfinite(time_to_go):
            for k in range(3):
                guidance.site[i, k] = sites[best, k]
            guidance.arrival[i] = time + time_to_go
            guidance.decided[i] = True
            site_p_safe[i] = p[best]
            return
        p[best] = -1.0


@kernel(shared=True)
def scan_and_divert(
    thread_slice, mask, keys, flight_counts, y, time, world, target, guidance, law, side, stride,
    posting, truth, errors, view, site_p_safe,
):  # fmt: skip
    """Take a scan for landers `mask` (n,) and divert each to the best lattice site.

    The lattice is every `stride`-th cell of a square of `side` cells around the target; only cells
    with a higher p_safe than the current site are considered. A lander with p_safe of 0.95 or more
    at its site does not divert. Writes `guidance` and the p_safe of the sites, `site_p_safe` (n,)
    (NaN if not observed). `thread_slice` is (thread, number of threads).
    """
    count = (side - 1) // stride + 1
    placements, amplitudes, axes = np.empty((2, 5), np.int64), np.empty(3), np.empty((3, 3))
    corner = np.empty(2)
    sites, p, distance = (
        np.empty((count * count, 3)),
        np.empty(count * count),
        np.empty(count * count),
    )
    neighbour_distance = max(int(0.5 / posting + 0.5), 1)
    for i in range(thread_slice[0], len(y), thread_slice[1]):
        if not mask[i]:
            continue
        for k in range(2):
            corner[k] = target[i, k] - 0.5 * (side - 1) * posting
        key, first = map_stream(keys[i], flight_counts[i])
        scan_index = sample_scan(
            i, key, first, y[i], time[i], world[i], guidance, errors, placements, amplitudes, axes
        )
        site = guidance.site[i].copy()
        here_r = int(np.floor((site[1] - corner[1]) / posting + 0.5))
        here_c = int(np.floor((site[0] - corner[0]) / posting + 0.5))
        stay, height = _mean_around(
            here_r, here_c, neighbour_distance, corner, posting, guidance.drift_velocity[i],
            time[i], y[i], world[i], scan_index, truth, errors, view, placements, amplitudes, axes,
        )  # fmt: skip
        site_p_safe[i] = stay if stay >= 0.0 else np.nan
        if stay >= 0.0:
            guidance.site[i, 2] = height
        guidance.scan_count[i] += 1
        guidance.event[i] = NOTHING
        if stay >= _ENOUGH:
            continue
        n = 0
        for r in range(0, side, stride):
            for c in range(0, side, stride):
                cell_p, z = _mean_around(
                    r, c, neighbour_distance, corner, posting, guidance.drift_velocity[i], time[i],
                    y[i], world[i], scan_index, truth, errors, view, placements, amplitudes, axes,
                )  # fmt: skip
                if cell_p <= stay:
                    continue
                sites[n, 0], sites[n, 1] = corner[0] + c * posting, corner[1] + r * posting
                sites[n, 2], p[n] = z, cell_p
                distance[n] = np.hypot(sites[n, 0] - site[0], sites[n, 1] - site[1])
                n += 1
        _divert_to_best(i, y[i], time[i], n, sites, p, distance, guidance, law, site_p_safe)
