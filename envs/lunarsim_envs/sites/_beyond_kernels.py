# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled proofs that a region of targets is out of reach for every time-to-go.

T is the time-to-go, s. Along a path (a polynomial in time), acceleration and position relative to
the target are linear in 1 / T^2, 1 / T and T; a limit is violated where a polynomial is positive.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.core.path_cost import (
    GLIDE,
    GRAVITY,
    HIGH,
    LOW,
    MASS,
    MOST,
    TAN_TILT,
    TIME_FRACTION,
)

# Margins for rounding: relative, m^2/s^4, m, m/s.
_SHARE, _SQUARE, _LENGTH, _SPEED = 1e-3, 1e-3, 0.05, 1e-3
# Number of first samples with a tilt check; smallest part of the interval of 1 / T.
_LOOKED, _FINEST = 4, 1.0 / 64.0


@kernel(inner=True)
def path_coefficients(state, law, out):
    """Compute how path samples depend on the time-to-go T, into `out` (samples, 9).

    `state` (2, 3) is the estimated position and velocity. With r the vector from target to lander,
    the acceleration at a sample is out[0] r / T^2 + out[1:4] / T, and its position relative to the
    target is out[4] r + out[5:8] T. The last column is unused.
    """
    table, low, high = law.paths.coarse_table, law.paths.powers[0], law.paths.powers[1]
    k = (low + 2.0) / (high - low)
    for s in range(len(out)):
        fraction, at_low, at_high = table[s, TIME_FRACTION], table[s, LOW], table[s, HIGH]
        f, g = (low + 1.0) * at_low, (high + 1.0) * at_high
        out[s, 0] = k * (high + 2.0) * (f - g)
        rest = g - k * (f - g)
        near, far = at_low / (low + 2.0), at_high / (high + 2.0)
        out[s, 4] = fraction * fraction * k * (high + 2.0) * (near - far)
        other = fraction * fraction * (far - k * (near - far))
        for axis in range(3):
            asked, change = law.paths.final[0, axis], law.paths.final[0, axis] - state[1, axis]
            out[s, 1 + axis] = out[s, 0] * asked + rest * change
            out[s, 5 + axis] = out[s, 4] * asked + other * change - fraction * asked


@kernel(inline=True)
def _add_square(a, b, c, out, sign):
    """Add sign * (a x^2 + b x + c)^2 to a polynomial `out` (5,), constant term first."""
    out[0] += sign * c * c
    out[1] += sign * 2.0 * b * c
    out[2] += sign * (b * b + 2.0 * a * c)
    out[3] += sign * 2.0 * a * b
    out[4] += sign * a * a


@kernel(inline=True)
def _is_positive(c, low, high):
    """Return whether a quartic is positive from `low` to `high`.

    `c` (5,) are its coefficients, constant term first. The test by Bernstein coefficients is
    sufficient, not necessary.
    """
    w = high - low
    # Bernstein form on the interval from low to high.
    b0 = c[0] + low * (c[1] + low * (c[2] + low * (c[3] + low * c[4])))
    b1 = w * (c[1] + low * (2.0 * c[2] + low * (3.0 * c[3] + low * 4.0 * c[4])))
    b2 = w * w * (c[2] + low * (3.0 * c[3] + low * 6.0 * c[4]))
    b3 = w * w * w * (c[3] + low * 4.0 * c[4])
    b4 = w * w * w * w * c[4]
    return (
        b0 > 0.0
        and b0 + b1 / 4.0 > 0.0
        and b0 + b1 / 2.0 + b2 / 6.0 > 0.0
        and b0 + 3.0 * b1 / 4.0 + b2 / 2.0 + b3 / 4.0 > 0.0
        and b0 + b1 + b2 + b3 + b4 > 0.0
    )


@kernel(inline=True)
def _height_above_glideslope(coefficients, offset, half_width, half_height, glideslope, time_to_go):
    """Bound a path's height above the glideslopes of a target box from above, m.

    The bound holds for one path sample (`coefficients`, a row of `path_coefficients`) and every
    target in a box of `half_width` and `half_height`, m. `offset` (3,) is the vector from the
    centre of the box to the lander, m, and `glideslope` a tangent. Also returns the derivative of
    the bound with respect to the time-to-go.
    """
    part = abs(coefficients[4])
    east, north = (
        coefficients[4] * offset[0] + coefficients[5] * time_to_go,
        coefficients[4] * offset[1] + coefficients[6] * time_to_go,
    )
    side = np.sqrt(east * east + north * north)
    grows = (east * coefficients[5] + north * coefficients[6]) / max(side, 1e-9)
    above = (
        coefficients[4] * offset[2]
        + coefficients[7] * time_to_go
        + 0.5
        + part * (half_height + glideslope * half_width)
        - glideslope * side
    )
    return above + _LENGTH + _SPEED * time_to_go, coefficients[7] - glideslope * grows + _SPEED


@kernel(inner=True)
def glideslope_exit_time(paths, offset, half_width, half_height, glideslope, min_time):
    """Return a time-to-go above which all paths to a box violate the glideslope, s.

    The time is at least `min_time`, and inf if no such time is known. `paths` are the rows of
    `path_coefficients`; other arguments as in `_height_above_glideslope`.
    """
    best = np.inf
    for s in range(len(paths) - 1):
        coefficients = paths[s]
        if not coefficients[7] + _SPEED < 0.0:
            continue
        part = abs(coefficients[4])
        u = (
            coefficients[4] * offset[2]
            + 0.5
            + part * (half_height + glideslope * half_width)
            + _LENGTH
        )
        v = coefficients[7] + _SPEED
        lowest = -u / v  # below the terrain after this time
        g = glideslope * glideslope
        a = v * v - g * (coefficients[5] * coefficients[5] + coefficients[6] * coefficients[6])
        b = u * v - g * coefficients[4] * (
            offset[0] * coefficients[5] + offset[1] * coefficients[6]
        )
        c = u * u - g * coefficients[4] * coefficients[4] * (
            offset[0] * offset[0] + offset[1] * offset[1]
        )
        time, inside = lowest, b * b - a * c
        if inside >= 0.0 and abs(a) > 1e-12:
            time = -np.inf
            for sign in (-1.0, 1.0):
                root = (-b + sign * np.sqrt(inside)) / a
                if time < root <= lowest:
                    time = root
        elif inside < 0.0:
            time = -np.inf
        time = max(time * 1.0001 + 0.01, min_time)
        above, grows = _height_above_glideslope(
            coefficients, offset, half_width, half_height, glideslope, time
        )
        if above < 0.0 and grows < 0.0 and time < best:
            best = time
    return best


@kernel(inner=True)
def _limit_polynomials(paths, offset, half_width, half_height, params, out):
    """Compute polynomials in 1 / T, positive where all paths to a box violate limits.

    T is the time-to-go. `out[0]` (5,) is for the thrust, the others for the tilt at the first
    samples. `params` is a field of `DivertParams`; other arguments as in
    `_height_above_glideslope`.
    """
    out[:] = 0.0
    tan, gravity = params[TAN_TILT] * (1.0 + _SHARE), params[GRAVITY]
    for s in range(_LOOKED):
        part, coefficients = paths[s, 0], paths[s]
        room = abs(part) * (half_width + tan * half_height)
        polynomial = out[1 + s]
        _add_square(part * offset[0], coefficients[1], 0.0, polynomial, 1.0)
        _add_square(part * offset[1], coefficients[2], 0.0, polynomial, 1.0)
        _add_square(
            tan * part * offset[2] + room, tan * coefficients[3], tan * gravity, polynomial, -1.0
        )
        polynomial[0] -= _SQUARE
    polynomial, coefficients, part = out[0], paths[0], paths[0, 0]
    for axis in range(3):
        _add_square(
            part * offset[axis],
            coefficients[1 + axis],
            gravity if axis == 2 else 0.0,
            polynomial,
            1.0,
        )
    most = params[MOST] / params[MASS] * (1.0 + _SHARE)
    _add_square(
        abs(part) * np.sqrt(half_width * half_width + half_height * half_height),
        0.0,
        most,
        polynomial,
        -1.0,
    )
    polynomial[0] -= _SQUARE


@kernel()
def is_unreachable(paths, state, low, high, speed, max_acceleration, law, params):
    """Return whether it is proven that no target in a box is reachable within limits.

    `paths` is from `path_coefficients`. `low` and `high` (3,) are corners of the box, m; `state`
    (2, 3) is position and velocity; `speed` is the norm of the velocity and `max_acceleration` is
    in m/s^2. False means that nothing is proven.
    """
    for axis in range(3):
        if law.paths.final[1, axis] != 0.0:
            return False
    offset, squared_distance = np.empty(3), 0.0
    for axis in range(3):
        offset[axis] = state[0, axis] - 0.5 * (low[axis] + high[axis])
        squared_distance += offset[axis] * offset[axis]
    half_width = 0.5 * np.hypot(high[0] - low[0], high[1] - low[1])
    half_height = 0.5 * (high[2] - low[2])
    min_distance = max(np.sqrt(squared_distance) - np.hypot(half_width, half_height), 0.0)
    first = (
        2.0
        * min_distance
        / (speed + np.sqrt(speed * speed + 2.0 * max_acceleration * min_distance) + 1e-12)
    )
    first = max(first, 1.0) * (1.0 - 1e-4)
    if not params[GLIDE] > 0.0 or len(paths) <= _LOOKED:
        return False
    until = glideslope_exit_time(paths, offset, half_width, half_height, params[GLIDE], first)
    if until == np.inf:
        return False
    quartics = np.empty((1 + _LOOKED, 5))
    _limit_polynomials(paths, offset, half_width, half_height, params, quartics)
    inverse_time, end = 1.0 / until, 1.0 / first
    span = end - inverse_time
    step = span
    while inverse_time < end:
        next_inverse_time = min(inverse_time + step, end)
        proven = False
        for k in range(1 + _LOOKED):
            proven = proven or _is_positive(quartics[k], inverse_time, next_inverse_time)
        if proven:
            inverse_time = next_inverse_time
            step *= 2.0
        else:
            step *= 0.5
            if step < _FINEST * span:
                return False
    return True
