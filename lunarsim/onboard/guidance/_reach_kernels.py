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
    SHARE,
    TAN_TILT,
    evaluate_path,
    refine_time,
    search_coarse,
)

# Scratch indices of the lanes: east, north and up of the sites, times, costs.
_EAST, _NORTH, _UP, _TIME, _COST = 0, SIMD_WIDTH, 2 * SIMD_WIDTH, 3 * SIMD_WIDTH, 4 * SIMD_WIDTH
_SCRATCH = 5 * SIMD_WIDTH
_NOTHING = 1e30  # represents an infinite cost


@kernel(inline=True)
def acceleration_terms(w, place, state, final, axis, powers, inverse):
    """Compute one axis of the path coefficients for sixteen sites at once.

    Returns the part of the lower power in the mean acceleration, and the sum of both parts, as
    `power_terms` does for one site. `w` is scratch with the target coordinates at index `place`;
    `state` and `final` (2, 3) are as for `evaluate_path`, `axis` is 0 to 2, and `inverse` is one
    over the times-to-go, 1/s. `powers` (2,) are the powers of time-to-go.
    """
    p = (final[0, axis] - state[1, axis]) * inverse - final[1, axis]
    q = ((state[0, axis] - load(w, place)) * inverse + final[0, axis]) * inverse
    q = q - 0.5 * final[1, axis]
    return (powers[0] + 2.0) / (powers[1] - powers[0]) * ((powers[1] + 2.0) * q - p), p


@kernel(inline=True)
def evaluate_lanes(w, state, final, table, powers, params):
    """Compute the delta-v of sixteen paths at once (one SIMD lane per site).

    `w` is scratch with targets, times and resulting costs; inadmissible paths cost `_NOTHING`. The
    other arguments are those of `evaluate_path`.
    """
    time = load(w, _TIME)
    inverse = 1.0 / time
    ux, p = acceleration_terms(w, _EAST, state, final, 0, powers, inverse)
    vx = p - ux
    uy, p = acceleration_terms(w, _NORTH, state, final, 1, powers, inverse)
    vy = p - uy
    uz, p = acceleration_terms(w, _UP, state, final, 2, powers, inverse)
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
        left = time * table[s, SHARE]
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
    store(w, _COST, select_ge(zero, violation, cost, lane_fill(_NOTHING)))


@kernel(inner=True)
def search_lanes(w, state, final, spans, count, skip, table, powers, params, best):
    """Search the best time-to-go of sixteen sites among geometric steps.

    `best` (16,) receives the index of the best step for SIMD lanes in which it is still negative.
    `spans` (3, 16) are first time, s, logarithm of the range of times, and step of the logarithm.
    There are `count` steps; multiples of `skip` are skipped if it is positive. `w` is scratch; the
    other arguments are those of `evaluate_path`.
    """
    least = np.full(SIMD_WIDTH, _NOTHING)
    open_ = best < 0
    for m in range(count):
        if skip > 0 and m % skip == 0:
            continue
        for k in range(SIMD_WIDTH):
            w[_TIME + k] = spans[0, k] * np.exp(m * spans[2, k])
        evaluate_lanes(w, state, final, table, powers, params)
        for k in range(SIMD_WIDTH):
            if open_[k] and w[_COST + k] < least[k]:
                best[k], least[k] = m, w[_COST + k]


@kernel(inner=True)
def refine_lanes(w, state, final, spans, table, powers, params, at):
    """Refine the times-to-go of sixteen sites by halving steps, in place.

    `at` (16,) are logarithms of time over the first time. `spans` (3, 16) are those of
    `search_lanes`, `w` is scratch, and the other arguments are those of `evaluate_path`.
    """
    least = np.empty(SIMD_WIDTH)
    for k in range(SIMD_WIDTH):
        w[_TIME + k] = spans[0, k] * np.exp(at[k])
    evaluate_lanes(w, state, final, table, powers, params)
    for k in range(SIMD_WIDTH):
        least[k] = w[_COST + k]
    step, middle, near = np.empty(SIMD_WIDTH), np.empty(SIMD_WIDTH), np.empty(SIMD_WIDTH)
    for k in range(SIMD_WIDTH):
        step[k] = spans[2, k]
    for _ in range(HALVINGS):
        for k in range(SIMD_WIDTH):
            step[k] *= 0.5
            middle[k] = at[k]
        for sense in (-1.0, 1.0):
            for k in range(SIMD_WIDTH):
                near[k] = middle[k] + sense * step[k]
                w[_TIME + k] = spans[0, k] * np.exp(min(max(near[k], 0.0), spans[1, k]))
            evaluate_lanes(w, state, final, table, powers, params)
            for k in range(SIMD_WIDTH):
                inside = 0.0 <= near[k] <= spans[1, k]
                if inside and step[k] > 0.0 and w[_COST + k] < least[k]:
                    least[k], at[k] = w[_COST + k], near[k]


@kernel(inner=True)
def search_one(state, target, final, start, span, coarse, rough, table, powers, params, out):
    """Search the best time-to-go to one target in double precision.

    `start` is the first time, s, `span` the logarithm of the range of times, and `coarse` the
    number of steps. `rough` and `table` are the samples for the coarse search and the refinement.
    `out` (4,) receives the result of `evaluate_path` for the best path. The other arguments are
    those of `evaluate_path`.
    """
    found, x = np.empty(4), np.empty((2, 3))
    step = span / max(coarse - 1, 1)
    best = search_coarse(
        state, target, final, start, step, coarse, 0, rough, powers, params, x, found
    )
    if best < 0 and step > 0.0:
        step /= 3.0
        count = 3 * (coarse - 1)
        best = search_coarse(
            state, target, final, start, step, count, 3, rough, powers, params, x, found
        )
    if best >= 0:
        refine_time(
            state, target, final, start, best * step, step, span, table, powers, params, x,
            found, out,
        )  # fmt: skip


@kernel(shared=True)
def search_sites(
    share, state, targets, final, first, last, coarse, rough, table, powers, params, out
):
    """Find the admissible time-to-go with minimum delta-v for each target (n, 3).

    `out` (n, 4) receives delta-v, m/s (inf if no time is admissible), time, s, maximum thrust, N,
    and maximum tangent of the tilt, as from `evaluate_path`; NaN without an admissible time. Per
    target, `coarse` times in geometric steps from `first` to `last` (n,), s, are tried with the
    samples of `rough`; if none is admissible, two more between each pair. Then the steps around the
    best time are halved with the samples of `table`, which finds a limit of admissibility as well
    as a minimum. `share` is (thread, number of threads). `state` and `final` (2, 3), `powers` and
    `params` are those of `evaluate_path`.
    """
    count = targets.shape[0]
    blocks = (count + SIMD_WIDTH - 1) // SIMD_WIDTH
    w = np.zeros(_SCRATCH, np.float32)
    spans, at = np.empty((3, SIMD_WIDTH)), np.empty(SIMD_WIDTH)
    best, valid = np.empty(SIMD_WIDTH, np.int64), np.empty(SIMD_WIDTH, np.bool_)
    x = np.empty((2, 3))
    for block in range(share[0], blocks, share[1]):
        here = block * SIMD_WIDTH
        wanted = False
        for k in range(SIMD_WIDTH):
            n = min(here + k, count - 1)
            out[n, 0] = np.inf
            out[n, 1:] = np.nan
            good = 0.0 < first[n] <= last[n] < np.inf and here + k < count
            valid[k] = good
            best[k] = -1
            spans[0, k] = first[n] if good else 1.0
            spans[1, k] = np.log(last[n] / first[n]) if good else 0.0
            spans[2, k] = spans[1, k] / max(coarse - 1, 1)
            w[_EAST + k], w[_NORTH + k], w[_UP + k] = targets[n, 0], targets[n, 1], targets[n, 2]
        search_lanes(w, state, final, spans, coarse, 0, rough, powers, params, best)
        for k in range(SIMD_WIDTH):
            if best[k] < 0 and valid[k] and spans[2, k] > 0.0:
                wanted = True
                spans[2, k] /= 3.0
            elif best[k] < 0:
                valid[k] = False
        if wanted:
            search_lanes(w, state, final, spans, 3 * (coarse - 1), 3, rough, powers, params, best)
        some = False
        for k in range(SIMD_WIDTH):
            at[k] = max(best[k], 0) * spans[2, k]
            some = some or (valid[k] and best[k] >= 0)
        if not some:
            continue
        refine_lanes(w, state, final, spans, table, powers, params, at)
        for k in range(SIMD_WIDTH):
            if not (valid[k] and best[k] >= 0):
                continue
            n = here + k
            time = spans[0, k] * np.exp(at[k])
            if not evaluate_path(state, targets[n], final, time, table, powers, params, x, out[n]):
                # Rounding changed the admissibility: repeat the search in double precision.
                out[n, 0] = np.inf
                out[n, 1:] = np.nan
                search_one(
                    state, targets[n], final, spans[0, k], spans[1, k], coarse, rough, table,
                    powers, params, out[n],
                )  # fmt: skip
