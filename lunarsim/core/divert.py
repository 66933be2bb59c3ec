# mypy: allow-untyped-defs, no-check-untyped-defs
"""Cost of diverts: the path with minimum propellant to each of many sites.

The search evaluates sixteen sites at once by SIMD. Trials use single precision; the selected path
is evaluated again in double precision. Rounding can therefore only affect the choice between two
equally good times.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

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
from lunarsim.core.path_cost import (
    EXHAUST,
    GLIDE,
    GRAVITY,
    HALVINGS,
    HIGH,
    LEAST,
    LOW,
    MASS,
    MOST,
    TAN_FINAL_TILT,
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
_COARSE_TIMES = 14  # times-to-go of the coarse search
# Upper time-to-go of the first search, as a multiple of the time at the current speed. Slower paths
# are rarely admissible; they are searched only if no faster one is.
_FIRST_SEARCH_TIME_RATIO = 8.0


class DivertParams(NamedTuple):
    """Paths of a guidance law, and limits of the lander, SI.

    `powers` (2,): powers of time-to-go in the acceleration of a path. `final` (2, 3): velocity and
    acceleration at the end of the approach. `params` (8,): gravity, mass, exhaust velocity, minimum
    and maximum thrust, tangents of maximum tilt, glideslope and maximum tilt at the end.
    `coarse_table`, `fine_table`: samples of a path (`sample_table`). `mass_limits` (4,): maximum
    thrust over dry mass, dry mass, exhaust velocity, propellant reserve.
    """

    powers: np.ndarray
    final: np.ndarray
    params: np.ndarray
    coarse_table: np.ndarray
    fine_table: np.ndarray
    mass_limits: np.ndarray


def sample_table(powers, samples):
    """Return the fraction of time left and its two powers at samples of a path.

    `samples` is the number of intervals; the result is (samples + 1, 3).
    """
    left = 1.0 - np.arange(samples + 1) / samples
    return np.column_stack((left, left ** powers[0], left ** powers[1]))


@kernel(inline=True)
def acceleration_terms(work, target_index, state, final, axis, powers, inverse_time):
    """Compute one axis of the path coefficients for sixteen sites at once.

    Returns two SIMD vectors, m/s^2: the contribution of the lower power of time-to-go to the mean
    acceleration, and the sum of the contributions of the two powers (compare `power_terms`).
    Scratch `work` has the target coordinates from `target_index` on; `state`, `final` and `powers`
    are those of `evaluate_path`, and `inverse_time` is one over the times-to-go, 1/s.
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
    glide = params[GLIDE] * params[GLIDE]
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
        tan = params[TAN_TILT if s < samples else TAN_FINAL_TILT]
        violation = lane_max(violation, lane_max(0.0 - az, side - tan * tan * lift))
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
    """Search the best of several times-to-go, in geometric steps, for sixteen sites.

    `best` (16,) is the index of the best step; only negative entries (nothing found yet) are
    searched and overwritten. `spans` (3, 16) are first time, s, logarithm of the range of times,
    and step of the logarithm. There are `count` steps; if `skip` is positive, steps whose index is
    a multiple of it are omitted. `work` is scratch; the other arguments are those of
    `evaluate_path`.
    """
    min_cost = np.full(SIMD_WIDTH, _INADMISSIBLE_COST)
    open_ = best < 0
    for m in range(count):
        if skip > 0 and m % skip == 0:
            continue
        for k in range(SIMD_WIDTH):
            work[_TIME + k] = spans[0, k] * np.exp(m * spans[2, k])
        evaluate_lanes(work, state, final, table, powers, params)
        for k in range(SIMD_WIDTH):
            if open_[k] and work[_COST + k] < min_cost[k]:
                best[k], min_cost[k] = m, work[_COST + k]


@kernel(inner=True)
def refine_lanes(work, state, final, spans, table, powers, params, log_ratio):
    """Refine the times-to-go of sixteen sites by halving steps, in place.

    `log_ratio` (16,) are logarithms of time over the first time, which are refined. `spans` (3, 16)
    are those of `search_lanes`, `work` is scratch; the others are those of `evaluate_path`.
    """
    min_cost = np.empty(SIMD_WIDTH)
    for k in range(SIMD_WIDTH):
        work[_TIME + k] = spans[0, k] * np.exp(log_ratio[k])
    evaluate_lanes(work, state, final, table, powers, params)
    for k in range(SIMD_WIDTH):
        min_cost[k] = work[_COST + k]
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
                if inside and step[k] > 0.0 and work[_COST + k] < min_cost[k]:
                    min_cost[k], log_ratio[k] = work[_COST + k], near[k]


@kernel(inner=True)
def search_one(
    state, target, final, start, span, coarse_count, coarse_table, table, powers, params, out
):
    """Search the best time-to-go to one target in double precision.

    `start` is the first time, s, `span` the logarithm of the range of times, and `coarse_count` the
    number of steps. `coarse_table` and `table` are the samples of coarse search and refinement.
    `out` (4,) receives the result of `evaluate_path` for the best path; it is unchanged if no time
    is admissible. The other arguments are those of `evaluate_path`.
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


@kernel(shared=True)
def evaluate_given_times(thread_slice, state, targets, final, times, table, powers, params, out):
    """Evaluate the path with a given time-to-go to each target.

    `targets` (n, 3) are end positions, m, and `times` (n,) times-to-go, s. `out` (n, 4) receives
    delta-v, m/s (inf if a limit is violated or the time is NaN), time, s, maximum thrust, N, and
    maximum tangent of the tilt. `thread_slice` is (thread, number of threads); the other arguments
    are those of `evaluate_path`.
    """
    terms = np.empty((2, 3))
    for n in range(thread_slice[0], len(targets), thread_slice[1]):
        good = times[n] > 0.0 and evaluate_path(
            state, targets[n], final, times[n], table, powers, params, terms, out[n]
        )
        if not good:
            out[n, 0] = np.inf
            out[n, 1:] = np.nan


_search_sites = cast(Any, search_sites).compiled
_evaluate_given_times = cast(Any, evaluate_given_times).compiled


@kernel(exact=True)
def norm(vector):
    """Return the norm of a vector (3,)."""
    return np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


@kernel(exact=True)
def min_flight_time(speed, distance, law):
    """Return a lower bound of the time to fly `distance` (m), s; at least 1 s.

    It is the time of constant maximum thrust with empty tanks straight towards the target. `speed`
    is the current one, m/s; `law` is a `DivertParams`.
    """
    max_acceleration = law.mass_limits[0] + law.params[GRAVITY]
    root = np.sqrt(speed * speed + 2.0 * max_acceleration * distance)
    return max(2.0 * distance / (speed + root + 1e-12), 1.0)


@kernel(exact=True)
def max_flight_time(speed, mass, law):
    """Return an upper bound of the time-to-go, s.

    It is the time for which the delta-v in the tanks can compensate gravity. `speed` (m/s) and
    `mass` (kg) are the current ones; `law` is a `DivertParams`.
    """
    max_delta_v = law.mass_limits[2] * np.log(max(mass / law.mass_limits[1], 1.0))
    return (max_delta_v + speed + norm(law.final[0])) / law.params[GRAVITY]


@kernel(exact=True)
def _distance(state, target):
    """Return the distance from the position in `state` to a target (3,), m."""
    total = 0.0
    for k in range(3):
        total += (target[k] - state[0, k]) ** 2
    return np.sqrt(total)


@kernel(exact=True)
def propellant_for(delta_v, mass, law):
    """Return the propellant for `delta_v` (m/s), kg; inf if too little is left.

    `mass` is the current mass, kg; `law` is a `DivertParams`, which has the dry mass and the
    reserve.
    """
    propellant = mass * -np.expm1(-delta_v / law.mass_limits[2])
    return propellant if propellant <= mass - law.mass_limits[1] - law.mass_limits[3] else np.inf


@kernel(exact=True)
def _is_thread_target(n, thread_slice):
    """Return whether target `n` is in a block of sixteen that a thread computes.

    `thread_slice` is (thread, number of threads).
    """
    return (n // SIMD_WIDTH) % thread_slice[1] == thread_slice[0]


@kernel(inner=True)
def _search_longer_times(thread_slice, state, targets, first, searched, last, law, params, out):
    """Search longer times-to-go for targets without an admissible path.

    `out` (n, 4) has the results of the search from `first` to `searched` (n,), s, and is updated by
    a search up to `last` (n,). Only the blocks of this thread are searched. `params` are those of
    `law` with the current mass; the other arguments are those of `divert_costs`.
    """
    indices = np.empty(len(targets), np.int64)
    count = 0
    for n in range(len(targets)):
        mine = _is_thread_target(n, thread_slice)
        if mine and not np.isfinite(out[n, 0]) and searched[n] < last[n]:
            indices[count] = n
            count += 1
    if count == 0:
        return
    ends, begin, end = np.empty((count, 3)), np.empty(count), np.empty(count)
    found = np.empty((count, 4))
    for k in range(count):
        n = indices[k]
        begin[k], end[k] = max(first[n], searched[n]), last[n]
        ends[k] = targets[n]
    _search_sites(
        (0, 1), state, ends, law.final, begin, end, _COARSE_TIMES, law.coarse_table,
        law.fine_table, law.powers, params, found,
    )  # fmt: skip
    for k in range(count):
        out[indices[k]] = found[k]


@kernel(shared=True)
def divert_costs(thread_slice, state, mass, targets, min_times, law, out):
    """Compute propellant and time-to-go of the minimum-propellant path to each target.

    `state` (2, 3) is position and velocity, `mass` in kg, `targets` (n, 3) are end positions of the
    approach, m, and `min_times` (n,) minimum times-to-go, s (NaN: out of reach). `out` (n, 4)
    receives propellant, kg, time, s, maximum thrust, N, and maximum tangent of the tilt; inf and
    NaN for targets out of reach. `law` is a `DivertParams`, and `thread_slice` is (thread, number
    of threads).
    """
    count = len(targets)
    first, last, searched = np.empty(count), np.empty(count), np.empty(count)
    speed, params = norm(state[1]), law.params.copy()
    params[MASS] = mass
    longest = max_flight_time(speed, mass, law)
    for n in range(count):
        if not _is_thread_target(n, thread_slice):
            continue
        distance = _distance(state, targets[n])
        fastest = min_flight_time(speed, distance, law)
        first[n], last[n] = max(fastest, min_times[n]), max(longest, fastest)
        searched[n] = min(
            last[n], _FIRST_SEARCH_TIME_RATIO * max(distance / max(speed, 5.0), first[n])
        )
        if np.isnan(min_times[n]):
            first[n] = np.nan
    _search_sites(
        thread_slice, state, targets, law.final, first, searched, _COARSE_TIMES, law.coarse_table,
        law.fine_table, law.powers, params, out,
    )  # fmt: skip
    _search_longer_times(thread_slice, state, targets, first, searched, last, law, params, out)
    for n in range(count):
        if _is_thread_target(n, thread_slice):
            out[n, 0] = propellant_for(out[n, 0], mass, law)
            if not np.isfinite(out[n, 0]):
                out[n, 1:] = np.nan


@kernel(shared=True)
def costs_at_times(thread_slice, state, mass, targets, times, law, out):
    """Compute the propellant of the path with a given time-to-go to each target.

    `times` (n,) are in s; a time that is too short for the distance is not admissible. The other
    arguments are those of `divert_costs`.
    """
    speed, params, given = norm(state[1]), law.params.copy(), times.copy()
    params[MASS] = mass
    for n in range(len(targets)):
        if not times[n] >= min_flight_time(speed, _distance(state, targets[n]), law):
            given[n] = np.nan
    _evaluate_given_times(
        thread_slice, state, targets, law.final, given, law.fine_table, law.powers, params, out
    )
    for n in range(thread_slice[0], len(targets), thread_slice[1]):
        out[n, 0] = propellant_for(out[n, 0], mass, law)
        if not np.isfinite(out[n, 0]):
            out[n, 1:] = np.nan
