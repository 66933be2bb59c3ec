# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled evaluation of the paths of a guidance law."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

# Columns of a sample table; rows of `state` and `final`; indices of `params`.
TIME_FRACTION, LOW, HIGH = 0, 1, 2
POSITION, VELOCITY = 0, 1
SPEED, ACCELERATION = 0, 1
GRAVITY, MASS, EXHAUST, LEAST, MOST, TAN_TILT, GLIDE, TAN_FINAL_TILT = 0, 1, 2, 3, 4, 5, 6, 7
HALVINGS = 5


@kernel(exact=True)
def power_terms(state, target, final, time_to_go, powers, out):
    """Compute the coefficients of a polynomial path from its boundary conditions.

    `out` (2, 3), m/s^2, receives the contribution of each of the two powers of time-to-go to the
    mean acceleration. `state` (2, 3) is current position and velocity, `target` (3,) the final
    position, `final` (2, 3) final velocity and acceleration, and `powers` (2,) are those of
    `PathShape`.
    """
    low, high = powers[0], powers[1]
    for k in range(3):
        r, v, v_f, a_f = state[0, k], state[1, k], final[0, k], final[1, k]
        p = (v_f - v) / time_to_go - a_f
        q = (v_f * time_to_go - (target[k] - r)) / time_to_go**2 - 0.5 * a_f
        out[0, k] = (low + 2.0) * ((high + 2.0) * q - p) / (high - low)
        out[1, k] = p - out[0, k]


@kernel()
def initial_accelerations(state, targets, final, times, powers, out):
    """Write the initial accelerations of n polynomial paths to `out` (n, 3), m/s^2.

    `targets` (n, 3) are the final positions, m, and `times` (n,) the times-to-go, s. The other
    arguments are those of `power_terms`.
    """
    terms = np.empty((2, 3))
    for n in range(len(times)):
        power_terms(state, targets[n], final, times[n], powers, terms)
        for k in range(3):
            rate = (powers[0] + 1.0) * terms[0, k] + (powers[1] + 1.0) * terms[1, k]
            out[n, k] = final[1, k] + rate


@kernel(inline=True, inner=True)
def above_cone(target, final, time_to_go, time_fraction, low, high, powers, terms, tan_glideslope):
    """Return whether a sample of a path is above the glideslope cone of the target.

    The apex of the cone is 0.5 m below the target. `time_fraction` is the fraction of time left at
    the sample, `low` and `high` are its powers, and `terms` (2, 3) is the result of `power_terms`,
    to which the other arguments belong.
    """
    left = time_fraction * time_to_go
    f, g = low / (powers[0] + 2.0), high / (powers[1] + 2.0)
    east = left * (left * (0.5 * final[1, 0] + terms[0, 0] * f + terms[1, 0] * g) - final[0, 0])
    north = left * (left * (0.5 * final[1, 1] + terms[0, 1] * f + terms[1, 1] * g) - final[0, 1])
    up = left * (left * (0.5 * final[1, 2] + terms[0, 2] * f + terms[1, 2] * g) - final[0, 2]) + 0.5
    if tan_glideslope > 0.0:
        return up >= 0.0 and up * up >= tan_glideslope * tan_glideslope * (
            east * east + north * north
        )
    return up >= tan_glideslope * np.sqrt(east * east + north * north)


@kernel(inline=True, inner=True)
def evaluate_path(state, target, final, time_to_go, table, powers, params, terms, out):
    """Evaluate a polynomial path; return whether it is admissible, and write its cost.

    `out` (4,) receives delta-v (m/s), time (s), maximum thrust (N) and maximum tangent of the tilt;
    it is not written if the path is not admissible. `terms` (2, 3) is a work array. `state`,
    `target`, `final` and `powers` are those of `power_terms`. `table` (samples + 1, 3) is the
    fraction of time left at the samples, from 1 to 0, and its two powers. `params` (8,): gravity,
    mass, exhaust velocity, minimum and maximum thrust, tangents of maximum tilt, glideslope and
    maximum tilt at the end.
    """
    power_terms(state, target, final, time_to_go, powers, terms)
    d, e = powers[0] + 1.0, powers[1] + 1.0
    samples = table.shape[0] - 1
    step = time_to_go / samples
    mass = params[MASS]
    before, total, peak, tilt_squared = 0.0, 0.0, 0.0, 0.0
    for s in range(samples + 1):
        f, g = table[s, LOW], table[s, HIGH]
        ax = final[1, 0] + d * terms[0, 0] * f + e * terms[1, 0] * g
        ay = final[1, 1] + d * terms[0, 1] * f + e * terms[1, 1] * g
        az = final[1, 2] + d * terms[0, 2] * f + e * terms[1, 2] * g + params[GRAVITY]
        side = ax * ax + ay * ay
        size = np.sqrt(side + az * az)
        if s > 0:
            # The trapezoidal rule suffices for the mass; the delta-v uses Simpson's rule. A step
            # uses a small fraction of the mass: three terms of the exponential leave an error of
            # 1e-9.
            burnt = 0.5 * (before + size) * step / params[EXHAUST]
            if burnt < 0.02:
                mass *= 1.0 - burnt * (1.0 - burnt * (0.5 - burnt / 6.0))
            else:
                mass *= np.exp(-burnt)
        before = size
        thrust = mass * size
        bound = params[TAN_TILT if s < samples else TAN_FINAL_TILT] * az
        if thrust > params[MOST] or thrust < params[LEAST] or az <= 0.0 or side > bound * bound:
            return False
        if not above_cone(
            target, final, time_to_go, table[s, TIME_FRACTION], f, g, powers, terms, params[GLIDE]
        ):
            return False
        peak = max(peak, thrust)
        tilt_squared = max(tilt_squared, side / (az * az))
        # Simpson's rule over an even number of intervals.
        weight = 1.0 if s in (0, samples) else (4.0 if s % 2 == 1 else 2.0)
        total += weight * size
    out[0] = total * step / 3.0
    out[1] = time_to_go
    out[2] = peak
    out[3] = np.sqrt(tilt_squared)
    return True


@kernel(inner=True)
def search_coarse(
    state, target, final, first, log_step, count, skip, table, powers, params, terms, path_cost
):
    """Search the time-to-go with minimum delta-v among geometric steps.

    The times are ``first exp(m log_step)``, s, for m below `count`; if `skip` is positive,
    multiples of `skip` are omitted. Returns the best m, or -1 if no path is admissible. The other
    arguments are those of `evaluate_path`; `path_cost` (4,) is a work array.
    """
    best, min_cost = -1, np.inf
    for m in range(count):
        if skip > 0 and m % skip == 0:
            continue
        time = first * np.exp(m * log_step)
        good = evaluate_path(state, target, final, time, table, powers, params, terms, path_cost)
        if good and path_cost[0] < min_cost:
            best, min_cost = m, path_cost[0]
    return best


@kernel(inline=True)
def _copy_result(path_cost, out):
    """Copy the result of a path (4,) from `path_cost` to `out`."""
    for k in range(4):
        out[k] = path_cost[k]


@kernel(inner=True)
def refine_time(
    state, target, final, first, log_ratio, step, span, table, powers, params, terms, path_cost, out
):
    """Refine the time-to-go with minimum delta-v by halving steps.

    The search starts at ``first exp(log_ratio)``, s, and stays between `first` and ``first
    exp(span)``; `step` is the initial step of the logarithm. `out` (4,) receives the result of
    `evaluate_path` for the best path. The other arguments are those of `evaluate_path`; `path_cost`
    (4,) is a work array.
    """
    time = first * np.exp(log_ratio)
    if evaluate_path(state, target, final, time, table, powers, params, terms, path_cost):
        _copy_result(path_cost, out)
    for _ in range(HALVINGS if step > 0.0 else 0):
        step *= 0.5
        middle = log_ratio
        for near in (middle - step, middle + step):
            if 0.0 <= near <= span:
                time = first * np.exp(near)
                good = evaluate_path(
                    state, target, final, time, table, powers, params, terms, path_cost
                )
                if good and path_cost[0] < out[0]:
                    _copy_result(path_cost, out)
                    log_ratio = near
