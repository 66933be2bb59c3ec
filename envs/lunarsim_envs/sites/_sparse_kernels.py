# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled choice of a site on a sparse lattice of cells, for a million descents."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim_envs.sites._flight_kernels import NOTHING, time_to
from lunarsim_envs.sites._map_kernels import drawn_from, drawn_scan, scanned_cell

# p_safe of a site that is safe enough; number of sites tested for reach.
_ENOUGH, _TRIES = 0.95, 6


@kernel(inline=True)
def _around(
    r, c, near, corner, posting, slip, time, y, world, stage, pool, errors, view, places, draw, axes
):
    """Return mean p_safe of a cell (r, c) and 4 neighbours, and the cell's height.

    The neighbours are `near` cells away. p_safe is -1 if the cell is not observed. The other
    arguments are those of `_map_kernels.scanned_cell`.
    """
    total, height, unseen = 0.0, 0.0, False
    for k in range(5):
        a = r + (near if k == 1 else -near if k == 2 else 0)
        b = c + (near if k == 3 else -near if k == 4 else 0)
        x = corner[0] + b * posting - slip[0] * time
        north = corner[1] + a * posting - slip[1] * time
        p, z = scanned_cell(a, b, x, north, y, world, stage, pool, errors, view, places, draw, axes)
        if k == 0:
            height = z
            unseen = p < 0.0
        total += max(p, 0.0)
    return (-1.0 if unseen else 0.2 * total), height


@kernel()
def _nearer(p, far, best_p, best_far):
    """Return whether a site is better than the best site so far.

    Sites with p_safe of 0.95 or more are compared by their distance (`far`, m), others by p_safe.
    """
    if p >= _ENOUGH:
        return best_p < _ENOUGH or far < best_far
    return best_p < _ENOUGH and p > best_p


@kernel()
def _fly_to_best(i, y, time, n, sites, p, far, course, law, site_p_safe):
    """Divert lander `i` to the best reachable site among the six best of n sites.

    `sites` (n, 3) with p_safe `p` and distance `far` (n,); writes p_safe to `site_p_safe`.
    """
    for _ in range(min(n, _TRIES)):
        best = 0
        for k in range(1, n):
            if _nearer(p[k], far[k], p[best], far[best]):
                best = k
        if p[best] < 0.0:
            return
        left = time_to(y, course.slip[i], time, sites[best], law)
        if np.isfinite(left):
            for k in range(3):
                course.site[i, k] = sites[best, k]
            course.arrival[i] = time + left
            course.decided[i] = True
            site_p_safe[i] = p[best]
            return
        p[best] = -1.0


@kernel(shared=True)
def choose(
    share, mask, keys, flight_counts, y, time, world, target, course, law, side, every, posting,
    pool, errors, view, site_p_safe,
):  # fmt: skip
    """Take a scan for landers `mask` (n,) and divert each to the best lattice site.

    The lattice is every `every`-th cell of a square of `side` cells around the target. A lander
    with p_safe of 0.95 or more at its site does not divert. `share` is (thread, number of threads).
    """
    count = (side - 1) // every + 1
    places, draw, axes = np.empty((2, 5), np.int64), np.empty(3), np.empty((3, 3))
    corner = np.empty(2)
    sites, p, far = np.empty((count * count, 3)), np.empty(count * count), np.empty(count * count)
    near = max(int(0.5 / posting + 0.5), 1)
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        for k in range(2):
            corner[k] = target[i, k] - 0.5 * (side - 1) * posting
        key, first = drawn_from(keys[i], flight_counts[i])
        stage = drawn_scan(
            i, key, first, y[i], time[i], world[i], course, errors, places, draw, axes
        )
        site = course.site[i].copy()
        here_r = int(np.floor((site[1] - corner[1]) / posting + 0.5))
        here_c = int(np.floor((site[0] - corner[0]) / posting + 0.5))
        stay, height = _around(
            here_r, here_c, near, corner, posting, course.slip[i], time[i], y[i], world[i], stage,
            pool, errors, view, places, draw, axes,
        )  # fmt: skip
        site_p_safe[i] = stay if stay >= 0.0 else np.nan
        if stay >= 0.0:
            course.site[i, 2] = height
        course.scanned[i] += 1
        course.event[i] = NOTHING
        if stay >= _ENOUGH:
            continue
        n = 0
        for r in range(0, side, every):
            for c in range(0, side, every):
                cell_p, z = _around(
                    r, c, near, corner, posting, course.slip[i], time[i], y[i], world[i], stage,
                    pool, errors, view, places, draw, axes,
                )  # fmt: skip
                if cell_p <= stay:
                    continue
                sites[n, 0], sites[n, 1] = corner[0] + c * posting, corner[1] + r * posting
                sites[n, 2], p[n] = z, cell_p
                far[n] = np.hypot(sites[n, 0] - site[0], sites[n, 1] - site[1])
                n += 1
        _fly_to_best(i, y[i], time[i], n, sites, p, far, course, law, site_p_safe)
