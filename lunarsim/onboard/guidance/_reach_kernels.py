# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search over many sites, sixteen at once by SIMD.

Trials use single precision; the selected path is evaluated again in double precision. Rounding can
therefore only affect the choice between two equally good times.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim._simd import (
    SIMD_WIDTH,
    any_greater,
    lane_fill,
    lane_max,
    lane_sqrt,
    load,
    select_ge,
    store,
)
from lunarsim.onboard.guidance._kernels import (
    EXHAUST,
    GLIDE,
    GRAVITY,
    HALVINGS,
    HIGH,
    LEAST,
    LOW,
    MASS,
    MOST,
    TAN_TILT,
    TIME_FRACTION,
    evaluate_path,
    refine_time,
    search_coarse,
)

# Scratch indices of the lanes: east, north and up of the sites, times, costs.
_EAST, _NORTH, _UP, _TIME, _COST = 0, SIMD_WIDTH, 2 * SIMD_WIDTH, 3 * SIMD_WIDTH, 4 * SIMD_WIDTH
_SCRATCH = 5 * SIMD_WIDTH
_INADMISSIBLE_COST = 1e30  # delta-v that represents infinity


@kernel(inline=True)
def acceleration_terms(work, target_index, state, final, axis, powers, inverse_time):
    """Compute one axis of the path coefficients for sixteen sites at once.

    Returns what the lower of the two powers of time-to-go adds to the mean acceleration, and what
    both add (compare `power_terms`). Scratch `work` has the target coordinates from `target_index`;
    `state`, `final` and `powers` are those of `evaluate_path`, and `inverse_time` is one over the
    times-to-go, 1/s.
    """
    p = (final[0, axis] - state[1, axis]) * inverse_time - final[1, axis]
    q = ((state[0, axis] - load(work, target_index)) * inverse_time + final[0, axis]) * inverse_time
    q = q - 0.5 * final[1, axis]
    return (powers[0] + 2.0) / (powers[1] - powers[0]) * ((powers[1] + 2.0) * q - p), p


@kernel(inline=True)
def evaluate_lanes(work, state, final, table, powers, params):
    """Compute the delta-v of sixteen paths at once (one SIMD lane per site).

    Scratch `work` holds targets and times-to-go and receives the delta-v, or `_INADMISSIBLE_COST`.
    The other arguments are those of `evaluate_path`.
    """
    time = load(work, _TIME)
    inverse = 1.0 / time
    ux, p = acceleration_terms(work, _EAST, state, final, 0, powers, inverse)
    vx = p - ux
    uy, p = acceleration_terms(work, _NORTH, state, final, 1, powers, inverse)
    vy = p - uy
    uz, p = acceleration_terms(work, _UP, state, final, 2, powers, inverse)
    vz = p - uz
    samples = table.shape[0] - 1
    half = time * (0.5 / samples / params[EXHAUST])
    tilt, glide = params[TAN_TILT] * params[TAN_TILT], params[GLIDE] * params[GLIDE]
    steep = params[GLIDE] > 0.0
    d, e = powers[0] + 1.0, powers[1] + 1.0
    zero = lane_fill(0.0)
    mass, before, total = lane_fill(params[MASS]), zero, zero
    violation = lane_fill(-1.0)  # positive once a limit is violated
    for s in range(samples + 1):
        low, high = table[s, LOW], table[s, HIGH]
        f, g = d * low, e * high
        ax = ux * f + vx * g + final[1, 0]
        ay = uy * f + vy * g + final[1, 1]
        az = uz * f + vz * g + (final[1, 2] + params[GRAVITY])
        side, lift = ax * ax + ay * ay, az * az
        size = lane_sqrt(side + lift)
        if s > 0:
            burnt = (before + size) * half
            over = burnt * burnt + 12.0
            mass = mass * (over - 6.0 * burnt) / (over + 6.0 * burnt)
        before = size
        thrust = mass * size
        violation = lane_max(violation, lane_max(thrust - params[MOST], params[LEAST] - thrust))
        violation = lane_max(violation, lane_max(0.0 - az, side - tilt * lift))
        left = time * table[s, TIME_FRACTION]
        f, g = low / (powers[0] + 2.0), high / (powers[1] + 2.0)
        x = left * (left * (ux * f + vx * g + 0.5 * final[1, 0]) - final[0, 0])
        y = left * (left * (uy * f + vy * g + 0.5 * final[1, 1]) - final[0, 1])
        up = left * (left * (uz * f + vz * g + 0.5 * final[1, 2]) - final[0, 2]) + 0.5
        rim = glide * (x * x + y * y)
        if steep:
            violation = lane_max(violation, lane_max(0.0 - up, rim - up * up))
        else:
            violation = lane_max(violation, select_ge(up, zero, lane_fill(-1.0), up * up - rim))
        if s % 3 == 2 and not any_greater(zero, violation):
            break
        weight = 1.0 if s in (0, samples) else (4.0 if s % 2 == 1 else 2.0)
        total = total + weight * size
    cost = total * time * (1.0 / (3.0 * samples))
    store(work, _COST, select_ge(zero, violation, cost, lane_fill(_INADMISSIBLE_COST)))


@kernel(inner=True)
def search_lanes(work, state, final, spans, count, skip, table, powers, params, best):
    """Search the best time-to-go of sixteen sites among geometric steps.

    `best` (16,) is the index of the best step; only negative entries (nothing found yet) are
    searched and overwritten. `spans` (3, 16) are first time, s, logarithm of the range of times,
    and step of the logarithm. There are `count` steps; if `skip` is positive, its multiples are
    omitted. `work` is scratch; the other arguments are those of `evaluate_path`.
    """
    least = np.full(SIMD_WIDTH, _INADMISSIBLE_COST)
    open_ = best < 0
    for m in range(count):
        if skip > 0 and m % skip == 0:
            continue
        for k in range(SIMD_WIDTH):
            work[_TIME + k] = spans[0, k] * np.exp(m * spans[2, k])
        evaluate_lanes(work, state, final, table, powers, params)
        for k in range(SIMD_WIDTH):
            if open_[k] and work[_COST + k] < least[k]:
                best[k], least[k] = m, work[_COST + k]


@kernel(inner=True)
def refine_lanes(work, state, final, spans, table, powers, params, log_ratio):
    """Refine the times-to-go of sixteen sites by halving steps, in place.

    `log_ratio` (16,) are logarithms of time over the first time, which are refined. `spans` (3, 16)
    are those of `search_lanes`, `work` is scratch; the others are those of `evaluate_path`.
    """
    least = np.empty(SIMD_WIDTH)
    for k in range(SIMD_WIDTH):
        work[_TIME + k] = spans[0, k] * np.exp(log_ratio[k])
    evaluate_lanes(work, state, final, table, powers, params)
    for k in range(SIMD_WIDTH):
        least[k] = work[_COST + k]
    step, middle, near = np.empty(SIMD_WIDTH), np.empty(SIMD_WIDTH), np.empty(SIMD_WIDTH)
    for k in range(SIMD_WIDTH):
        step[k] = spans[2, k]
    for _ in range(HALVINGS):
        for k in range(SIMD_WIDTH):
            step[k] *= 0.5
            middle[k] = log_ratio[k]
        for sense in (-1.0, 1.0):
            for k in range(SIMD_WIDTH):
                near[k] = middle[k] + sense * step[k]
                work[_TIME + k] = spans[0, k] * np.exp(min(max(near[k], 0.0), spans[1, k]))
            evaluate_lanes(work, state, final, table, powers, params)
            for k in range(SIMD_WIDTH):
                inside = 0.0 <= near[k] <= spans[1, k]
                if inside and step[k] > 0.0 and work[_COST + k] < least[k]:
                    least[k], log_ratio[k] = work[_COST + k], near[k]


@kernel(inner=True)
def search_one(
    state, target, final, start, span, coarse_count, coarse_table, table, powers, params, out
):
    """Search the best time-to-go to one target in double precision.

    `start` is the first time, s, `span` the logarithm of the range of times, and `coarse_count` the
    number of steps. `coarse_table` and `table` are the samples of coarse search and refinement.
    `out` (4,) receives the result of `evaluate_path` for the best path. The other arguments are
    those of `evaluate_path`.
    """
    path_cost, terms = np.empty(4), np.empty((2, 3))
    step = span / max(coarse_count - 1, 1)
    best = search_coarse(
        state,
        target,
        final,
        start,
        step,
        coarse_count,
        0,
        coarse_table,
        powers,
        params,
        terms,
        path_cost,
    )
    if best < 0 and step > 0.0:
        step /= 3.0
        count = 3 * (coarse_count - 1)
        best = search_coarse(
            state,
            target,
            final,
            start,
            step,
            count,
            3,
            coarse_table,
            powers,
            params,
            terms,
            path_cost,
        )
    if best >= 0:
        refine_time(
            state, target, final, start, best * step, step, span, table, powers, params, terms,
            path_cost, out,
        )  # fmt: skip


@kernel(shared=True)
def search_sites(
    thread_slice, state, targets, final, first, last, coarse_count, coarse_table, table, powers,
    params, out,
):  # fmt: skip
    """Find the admissible time-to-go with minimum delta-v for each target (n, 3).

    `out` (n, 4) receives delta-v, m/s (inf if no time is admissible), time, s, maximum thrust, N,
    and maximum tangent of the tilt, as from `evaluate_path`; NaN without an admissible time. Per
    target, `coarse_count` times in geometric steps from `first` to `last` (n,), s, are tried with
    the samples of `coarse_table`; if none is admissible, two more between each pair. Then the steps
    around the best time are halved with the samples of `table`, which finds a limit of
    admissibility as well as a minimum. `thread_slice` is (thread, number of threads); the other
    arguments are those of `evaluate_path`.
    """
    count = targets.shape[0]
    blocks = (count + SIMD_WIDTH - 1) // SIMD_WIDTH
    work = np.zeros(_SCRATCH, np.float32)
    spans, log_ratio = np.empty((3, SIMD_WIDTH)), np.empty(SIMD_WIDTH)
    best, valid = np.empty(SIMD_WIDTH, np.int64), np.empty(SIMD_WIDTH, np.bool_)
    terms = np.empty((2, 3))
    for block in range(thread_slice[0], blocks, thread_slice[1]):
        first_site = block * SIMD_WIDTH
        wanted = False
        for k in range(SIMD_WIDTH):
            n = min(first_site + k, count - 1)
            out[n, 0] = np.inf
            out[n, 1:] = np.nan
            good = 0.0 < first[n] <= last[n] < np.inf and first_site + k < count
            valid[k] = good
            best[k] = -1
            spans[0, k] = first[n] if good else 1.0
            spans[1, k] = np.log(last[n] / first[n]) if good else 0.0
            spans[2, k] = spans[1, k] / max(coarse_count - 1, 1)
            site = targets[n]
            work[_EAST + k], work[_NORTH + k], work[_UP + k] = site[0], site[1], site[2]
        search_lanes(work, state, final, spans, coarse_count, 0, coarse_table, powers, params, best)
        for k in range(SIMD_WIDTH):
            if best[k] < 0 and valid[k] and spans[2, k] > 0.0:
                wanted = True
                spans[2, k] /= 3.0
            elif best[k] < 0:
                valid[k] = False
        if wanted:
            search_lanes(
                work, state, final, spans, 3 * (coarse_count - 1), 3, coarse_table, powers, params,
                best,
            )  # fmt: skip
        some = False
        for k in range(SIMD_WIDTH):
            log_ratio[k] = max(best[k], 0) * spans[2, k]
            some = some or (valid[k] and best[k] >= 0)
        if not some:
            continue
        refine_lanes(work, state, final, spans, table, powers, params, log_ratio)
        for k in range(SIMD_WIDTH):
            if not (valid[k] and best[k] >= 0):
                continue
            n = first_site + k
            time = spans[0, k] * np.exp(log_ratio[k])
            if not evaluate_path(
                state, targets[n], final, time, table, powers, params, terms, out[n]
            ):
                # Rounding changed the admissibility: repeat the search in double precision.
                out[n, 0] = np.inf
                out[n, 1:] = np.nan
                search_one(
                    state, targets[n], final, spans[0, k], spans[1, k], coarse_count,
                    coarse_table, table, powers, params, out[n],
                )  # fmt: skip
