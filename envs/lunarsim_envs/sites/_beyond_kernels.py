# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled proofs that a region is out of reach for every time-to-go."""

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
    SHARE,
    TAN_TILT,
)

# Margins for rounding: relative, m^2/s^4, m, m/s.
_SHARE, _SQUARE, _LENGTH, _SPEED = 1e-3, 1e-3, 0.05, 1e-3
# Number of first samples with a tilt check; smallest part of the interval of 1 / T.
_LOOKED, _FINEST = 4, 1.0 / 64.0


@kernel(inner=True)
def ways_of(state, law, out):
    """Write the coefficients of path samples in T and 1 / T (samples, 9)."""
    low, high = law.powers[0], law.powers[1]
    k = (low + 2.0) / (high - low)
    for s in range(len(out)):
        share = law.rough[s, SHARE]
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
    """Add the square of a quadratic (highest term first) to a quartic (5,)."""
    out[0] += sign * c * c
    out[1] += sign * 2.0 * b * c
    out[2] += sign * (b * b + 2.0 * a * c)
    out[3] += sign * 2.0 * a * b
    out[4] += sign * a * a


@kernel(inline=True)
def _positive(c, low, high):
    """Return whether a quartic (5,), constant first, is positive in an interval.

    The test is sufficient, not necessary.
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
    """Return the maximum sample height above the cone, m, and its derivative in T."""
    part = abs(way[4])
    east, north = way[4] * gap[0] + way[5] * time, way[4] * gap[1] + way[6] * time
    side = np.sqrt(east * east + north * north)
    grows = (east * way[5] + north * way[6]) / max(side, 1e-9)
    above = way[4] * gap[2] + way[7] * time + 0.5 + part * (tall + glide * wide) - glide * side
    return above + _LENGTH + _SPEED * time, way[7] - glide * grows + _SPEED


@kernel(inner=True)
def sunk(ways, gap, wide, tall, glide, first):
    """Return a time after `first`, s, after which all paths are below the cone.

    It is inf if no such time is known.
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
    """Write polynomials in 1 / T that are positive where limits are violated."""
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
    """Return whether no target in a box has an admissible time-to-go, for certain."""
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
