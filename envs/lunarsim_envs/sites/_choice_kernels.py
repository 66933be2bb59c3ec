# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled selection of candidate sites from maps, with cost and expected miss."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.core.candidates import average_cell, best_cells, nearest_cells
from lunarsim.onboard.policies.expected_miss import MAX_EXPECTED_MISS_M
from lunarsim_envs.sites._flight_kernels import compute_divert_costs, estimate_state
from lunarsim_envs.sites._map_kernels import map_cell
from lunarsim_envs.sites.reachable_candidates import (
    is_safest_unreachable,
    replace_unreachable,
    select_reachable,
)

# An averaged map is recomputed if the miss has changed by this fraction.
_ALIKE = 0.05


class CandidateSites(NamedTuple):
    """Candidate landing sites of n landers, at most m each.

    Position (n, m, 3), p_safe (probability of safe terrain), distance from the current site (m)
    and propellant to reach the candidate (kg), each (n, m); `number` (n,) of candidates. `here` (n,
    3) describes the current site: p_safe (NaN if not observed), propellant to reach it, kg, and
    expected miss, m.
    """

    position: np.ndarray
    p_safe: np.ndarray
    distance: np.ndarray
    propellant: np.ndarray
    number: np.ndarray
    here: np.ndarray


@kernel()
def expected_miss(time, time_to_go, map_time, miss_params):
    """Return the expected horizontal miss at touchdown, m.

    The miss grows with the drift of navigation since the map, which was made at `map_time`, until
    touchdown; all times are in s. `miss_params` (3,) is a field of `Maps`.
    """
    if miss_params[1] == 0.0:
        return miss_params[0]
    seconds = max(time - map_time + time_to_go + miss_params[2], 0.0)
    return min(
        np.hypot(miss_params[0], miss_params[1] * seconds), max(MAX_EXPECTED_MISS_M, miss_params[0])
    )


@kernel(exact=True)
def add_scaled(out, row, weight):
    """Add weight * row to the row `out`, in place."""
    for c in range(len(out)):
        out[c] += weight * row[c]


@kernel(exact=True)
def add_two_scaled(out, row_a, weight_a, row_b, weight_b):
    """Add weight_a * row_a + weight_b * row_b to the row `out`, in place."""
    for c in range(len(out)):
        out[c] = (out[c] + weight_a * row_a[c]) + weight_b * row_b[c]


@kernel(allocates=False)
def average_map(p, observed, sigma, out, padded, weights):
    """Average a map of p_safe over a Gaussian landing dispersion, into `out`.

    `p`, `observed` and `out` are (rows, cols); `sigma` is the dispersion per axis, in cells.
    Terrain outside the map counts as 0, and unobserved cells (`observed` false) get 0. `padded` and
    `weights` are scratch.
    """
    rows, cols = p.shape
    reach_ = int(3.0 * sigma + 0.5)
    total = 0.0
    for k in range(-reach_, reach_ + 1):
        total += np.exp(-0.5 * (k / sigma) ** 2)
    for k in range(-reach_, reach_ + 1):
        weights[k + reach_] = np.exp(-0.5 * (k / sigma) ** 2) / total
    padded[: cols + 2 * reach_] = 0.0
    middle = padded[reach_ : reach_ + cols]
    for r in range(rows):
        low, high = max(r - reach_, 0), min(r + reach_ + 1, rows)
        middle[:] = 0.0
        for k in range(low, high - 1, 2):
            add_two_scaled(
                middle, p[k], weights[k - r + reach_], p[k + 1], weights[k + 1 - r + reach_]
            )
        if (high - low) % 2 == 1:
            add_scaled(middle, p[high - 1], weights[high - 1 - r + reach_])
        out[r] = 0.0
        for k in range(0, 2 * reach_, 2):
            add_two_scaled(out[r], padded[k:], weights[k], padded[k + 1 :], weights[k + 1])
        add_scaled(out[r], padded[2 * reach_ :], weights[2 * reach_])
        for c in range(cols):
            capped = min(out[r, c], np.float32(1.0))
            out[r, c] = capped if observed[r, c] else np.float32(0.0)


@kernel()
def _update_averaged_map(i, time, time_to_go, maps, padded, weights):
    """Average a lander's map over the expected miss at its site; return the miss, m.

    Writes `maps.averaged` and `maps.averaged_miss` of lander `i`, unless its miss has changed by at
    most 5 %. `padded` and `weights` are scratch.
    """
    miss = expected_miss(time, time_to_go, maps.map_time[i], maps.miss_params)
    if not abs(miss / maps.averaged_miss[i] - 1.0) <= _ALIKE:
        maps.averaged_miss[i] = miss
        average_map(maps.p[i], maps.seen[i], miss / maps.posting, maps.averaged[i], padded, weights)
    return miss


@kernel()
def _sort_by_p_safe(order, count, p_safe):
    """Write indices of `count` values of `p_safe` to `order`, by decreasing value.

    Equal values keep their order.
    """
    for n in range(count):
        order[n] = n
    for n in range(1, count):
        index = order[n]
        m = n - 1
        while m >= 0 and p_safe[order[m]] < p_safe[index]:
            order[m + 1] = order[m]
            m -= 1
        order[m + 1] = index


@kernel()
def _candidate_costs(i, cells, n, site, state, mass, law, maps, sites, cost):
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
    compute_divert_costs(state, mass, sites[: n + 1], law, cost[: n + 1])


@kernel()
def _average_candidates(i, time, time_to_go, cells, n, cost, maps, p_safe):
    """Write p_safe of n candidates, each averaged over the expected miss of its path.

    `cells` (n, 2) are rows and columns in the map of lander `i`. Column 1 of `cost` has the
    time-to-go of each candidate; `time_to_go` is used for unreachable candidates. If the miss does
    not grow with time, `p_safe` (n,) gets the values of `maps.averaged`.
    """
    for m in range(n):
        row, col = cells[m, 0], cells[m, 1]
        p_safe[m] = maps.averaged[i, row, col]
        if maps.miss_params[1] > 0.0:
            until = cost[m, 1] if np.isfinite(cost[m, 1]) else time_to_go
            miss = expected_miss(time, until, maps.map_time[i], maps.miss_params)
            p_safe[m] = average_cell(maps.p[i], maps.seen[i], row, col, miss / maps.posting)


@kernel(shared=True)
def select_candidates(
    thread_slice, mask, y, time, guidance, law, maps, count, separation, p_safe_levels, candidates
):
    """Select candidate sites from the maps of landers `mask` (n,), with their cost.

    Candidates are up to `count` cells with the best p_safe, `separation` (m) apart, and for each of
    `p_safe_levels` the nearest cell with at least this p_safe. If the safest of them are out of
    reach, reachable cells are searched to replace them. Writes the candidates to `candidates`, by
    decreasing p_safe. `thread_slice` is (thread, number of threads).
    """
    rows, cols = maps.p.shape[1], maps.p.shape[2]
    max_count = 2 * (count + len(p_safe_levels))
    masked, score = np.empty((rows, cols), np.float32), np.empty((rows, cols), np.float32)
    # Padding for the maximum miss in `average_map`.
    padding = 2 * int(3.0 * max(MAX_EXPECTED_MISS_M, maps.miss_params[0]) / maps.posting + 0.5) + 1
    weights, padded = np.empty(padding, np.float32), np.empty(cols + padding, np.float32)
    cells = np.empty((max_count, 2), np.int64)
    row_maxima, more = np.empty(rows, np.float32), np.empty((max_count, 2), np.int64)
    state, sites, cost = (
        np.empty((2, 3)),
        np.empty((max_count + 1, 3)),
        np.empty((max_count + 1, 4)),
    )
    p, order = np.empty(max_count), np.empty(max_count, np.int64)
    for i in range(thread_slice[0], len(y), thread_slice[1]):
        if not mask[i]:
            continue
        site, time_to_go, mass = guidance.site[i], guidance.arrival[i] - time[i], y[i, 13]
        averaged, corner = maps.averaged[i], maps.corner[i]
        miss = _update_averaged_map(i, time[i], time_to_go, maps, padded, weights)
        n = best_cells(
            averaged, corner, maps.posting, site, count, separation, score, row_maxima, cells
        )
        n = nearest_cells(averaged, corner, maps.posting, site, p_safe_levels, n, row_maxima, cells)
        estimate_state(y[i], guidance.drift_velocity[i], time[i], state)
        _candidate_costs(i, cells, n, site, state, mass, law, maps, sites, cost)
        if is_safest_unreachable(averaged, cells, cost, n, p_safe_levels[0]):
            k = select_reachable(
                averaged, corner, maps.posting, maps.height[i], site, state, mass, law, count,
                separation, p_safe_levels, masked, score, more,
            )  # fmt: skip
            n = replace_unreachable(cells, cost, n, more, k)
            _candidate_costs(i, cells, n, site, state, mass, law, maps, sites, cost)
        _average_candidates(i, time[i], time_to_go, cells, n, cost, maps, p)
        _sort_by_p_safe(order, n, p)
        for m in range(n):
            from_row = order[m]
            for k in range(3):
                candidates.position[i, m, k] = sites[from_row, k]
            candidates.p_safe[i, m] = p[from_row]
            candidates.distance[i, m] = np.hypot(
                sites[from_row, 0] - site[0], sites[from_row, 1] - site[1]
            )
            candidates.propellant[i, m] = cost[from_row, 0]
        candidates.number[i] = n
        row, col = map_cell(i, site[0], site[1], maps)
        inside = 0 <= row < rows and 0 <= col < cols and maps.seen[i, row, col]
        candidates.here[i, 0] = averaged[row, col] if inside else np.nan
        candidates.here[i, 1] = cost[n, 0]
        candidates.here[i, 2] = miss
