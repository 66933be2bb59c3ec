# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled proofs that a region of targets is out of reach for every time-to-go.

T is the time-to-go, s. Along a path (a polynomial in time), acceleration and position relative to
the target are linear in 1 / T^2, 1 / T and T; a limit is violated where a polynomial is positive.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import (
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
def ways_of(state, law, out):
    """Compute how path samples depend on the time-to-go T, into `out` (samples, 9).

    `state` (2, 3) is the estimated position and velocity. With g the vector from target to lander,
    acceleration is out[0] g / T^2 + out[1:4] / T and position from the target out[4] g + out[5:8]
    T.
    """
    low, high = law.powers[0], law.powers[1]
    k = (low + 2.0) / (high - low)
    for s in range(len(out)):
        share = law.rough[s, TIME_FRACTION]
        f, g = (low + 1.0) * law.rough[s, LOW], (high + 1.0) * law.rough[s, HIGH]
        out[s, 0] = k * (high + 2.0) * (f - g)
        rest = g - k * (f - g)
        near, far = law.rough[s, LOW] / (low + 2.0), law.rough[s, HIGH] / (high + 2.0)
        out[s, 4] = share * share * k * (high + 2.0) * (near - far)
        other = share * share * (far - k * (near - far))
        for axis in range(3):
            asked, change = law.asked[0, axis], law.asked[0, axis] - state[1, axis]
            out[s, 1 + axis] = out[s, 0] * asked + rest * change
            out[s, 5 + axis] = out[s, 4] * asked + other * change - share * asked


@kernel(inline=True)
def _square(a, b, c, out, sign):
    """Add sign * (a x^2 + b x + c)^2 to a polynomial `out` (5,), constant term first."""
    out[0] += sign * c * c
    out[1] += sign * 2.0 * b * c
    out[2] += sign * (b * b + 2.0 * a * c)
    out[3] += sign * 2.0 * a * b
    out[4] += sign * a * a


@kernel(inline=True)
def _positive(c, low, high):
    """Return whether a quartic (5,), constant first, is positive from `low` to `high`.

    The test by Bernstein coefficients is sufficient, not necessary.
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
def _over(way, gap, wide, tall, glide, time):
    """Bound the height of a path sample above the glideslope cone of a target box, m.

    `way` is a row of `ways_of`, `gap` (3,) the vector from the centre of the box to the lander,
    `wide` and `tall` the half sizes of the box, m, `glide` the tangent of the glideslope and `time`
    the time-to-go T, s. Also returns the derivative with respect to T.
    """
    part = abs(way[4])
    east, north = way[4] * gap[0] + way[5] * time, way[4] * gap[1] + way[6] * time
    side = np.sqrt(east * east + north * north)
    grows = (east * way[5] + north * way[6]) / max(side, 1e-9)
    above = way[4] * gap[2] + way[7] * time + 0.5 + part * (tall + glide * wide) - glide * side
    return above + _LENGTH + _SPEED * time, way[7] - glide * grows + _SPEED


@kernel(inner=True)
def sunk(ways, gap, wide, tall, glide, first):
    """Return a time-to-go above which all paths to a box violate the glideslope, s.

    The time is at least `first`, and inf if no such time is known. Arguments as in `_over`; `ways`
    are the rows of `ways_of`.
    """
    best = np.inf
    for s in range(len(ways) - 1):
        way = ways[s]
        if not way[7] + _SPEED < 0.0:
            continue
        part = abs(way[4])
        u = way[4] * gap[2] + 0.5 + part * (tall + glide * wide) + _LENGTH
        v = way[7] + _SPEED
        lowest = -u / v  # below the terrain after this time
        g = glide * glide
        a = v * v - g * (way[5] * way[5] + way[6] * way[6])
        b = u * v - g * way[4] * (gap[0] * way[5] + gap[1] * way[6])
        c = u * u - g * way[4] * way[4] * (gap[0] * gap[0] + gap[1] * gap[1])
        time, inside = lowest, b * b - a * c
        if inside >= 0.0 and abs(a) > 1e-12:
            time = -np.inf
            for sign in (-1.0, 1.0):
                at = (-b + sign * np.sqrt(inside)) / a
                if time < at <= lowest:
                    time = at
        elif inside < 0.0:
            time = -np.inf
        time = max(time * 1.0001 + 0.01, first)
        above, grows = _over(way, gap, wide, tall, glide, time)
        if above < 0.0 and grows < 0.0 and time < best:
            best = time
    return best


@kernel(inner=True)
def _quartics(ways, gap, wide, tall, figures, out):
    """Compute polynomials in 1 / T, positive where all paths to a box violate limits.

    `out[0]` (5,) is for the thrust, the others for the tilt at the first samples. `figures` are
    `Law.figures`; other arguments as in `_over`.
    """
    out[:] = 0.0
    tan, gravity = figures[TAN_TILT] * (1.0 + _SHARE), figures[GRAVITY]
    for s in range(_LOOKED):
        part, way = ways[s, 0], ways[s]
        room = abs(part) * (wide + tan * tall)
        one = out[1 + s]
        _square(part * gap[0], way[1], 0.0, one, 1.0)
        _square(part * gap[1], way[2], 0.0, one, 1.0)
        _square(tan * part * gap[2] + room, tan * way[3], tan * gravity, one, -1.0)
        one[0] -= _SQUARE
    one, way, part = out[0], ways[0], ways[0, 0]
    for axis in range(3):
        _square(part * gap[axis], way[1 + axis], gravity if axis == 2 else 0.0, one, 1.0)
    most = figures[MOST] / figures[MASS] * (1.0 + _SHARE)
    _square(abs(part) * np.sqrt(wide * wide + tall * tall), 0.0, most, one, -1.0)
    one[0] -= _SQUARE


@kernel()
def beyond(ways, state, low, high, speed, most, law, figures):
    """Return whether no target in a box can be reached within limits, proven.

    `low` and `high` (3,) are corners of the box, m; `state` (2, 3) is position and velocity;
    `speed` is its norm and `most` the maximum acceleration, m/s^2. False means that nothing is
    proven.
    """
    for axis in range(3):
        if law.asked[1, axis] != 0.0:
            return False
    gap, way = np.empty(3), 0.0
    for axis in range(3):
        gap[axis] = state[0, axis] - 0.5 * (low[axis] + high[axis])
        way += gap[axis] * gap[axis]
    wide = 0.5 * np.hypot(high[0] - low[0], high[1] - low[1])
    tall = 0.5 * (high[2] - low[2])
    least = max(np.sqrt(way) - np.hypot(wide, tall), 0.0)
    first = 2.0 * least / (speed + np.sqrt(speed * speed + 2.0 * most * least) + 1e-12)
    first = max(first, 1.0) * (1.0 - 1e-4)
    if not figures[GLIDE] > 0.0 or len(ways) <= _LOOKED:
        return False
    until = sunk(ways, gap, wide, tall, figures[GLIDE], first)
    if until == np.inf:
        return False
    quartics = np.empty((1 + _LOOKED, 5))
    _quartics(ways, gap, wide, tall, figures, quartics)
    at, end = 1.0 / until, 1.0 / first
    span = end - at
    step = span
    while at < end:
        there = min(at + step, end)
        proven = False
        for k in range(1 + _LOOKED):
            proven = proven or _positive(quartics[k], at, there)
        if proven:
            at = there
            step *= 2.0
        else:
            step *= 0.5
            if step < _FINEST * span:
                return False
    return True
