"""Compiled survey of the paths of a law, and times-to-go by limits on jerk and snap."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange

# Columns of the table of samples.
SHARE, LOW, HIGH = 0, 1, 2


@kernel()
def measure(r, v, target, v_f, a_f, big_t, table, powers, gravity, mass, limits, out):
    """Follow one path; return whether it is admissible, and write what it takes.

    Writes increment, time, greatest thrust (N) and greatest tangent of the lean into `out` (4,).
    `table` (samples + 1, 3): share of the time that is left, from 1 to 0, and its two powers.
    `limits`: exhaust velocity, least and greatest thrust, tangents of tilt and glideslope.
    """
    low, high = powers[0], powers[1]
    exhaust, least, most, tan_tilt, glide = limits[0], limits[1], limits[2], limits[3], limits[4]
    p0 = (v_f[0] - v[0]) / big_t - a_f[0]
    p1 = (v_f[1] - v[1]) / big_t - a_f[1]
    p2 = (v_f[2] - v[2]) / big_t - a_f[2]
    square = 1.0 / big_t**2
    gain = (low + 2.0) / (high - low)
    q0 = (v_f[0] * big_t - target[0] + r[0]) * square - 0.5 * a_f[0]
    q1 = (v_f[1] * big_t - target[1] + r[1]) * square - 0.5 * a_f[1]
    q2 = (v_f[2] * big_t - target[2] + r[2]) * square - 0.5 * a_f[2]
    # Integrated once, what each power gives (the terms over their power + 1).
    x0, x1, x2 = (
        gain * ((high + 2.0) * q0 - p0),
        gain * ((high + 2.0) * q1 - p1),
        gain * ((high + 2.0) * q2 - p2),
    )
    y0, y1, y2 = p0 - x0, p1 - x1, p2 - x2
    d0, d1, d2 = (low + 1.0) * x0, (low + 1.0) * x1, (low + 1.0) * x2
    e0, e1, e2 = (high + 1.0) * y0, (high + 1.0) * y1, (high + 1.0) * y2
    samples = table.shape[0] - 1
    step = big_t / samples
    left_mass = mass
    before = 0.0
    total = 0.0
    peak = 0.0
    lean = 0.0
    for s in range(samples + 1):
        u, f, g = table[s, SHARE], table[s, LOW], table[s, HIGH]
        ax = a_f[0] + d0 * f + e0 * g
        ay = a_f[1] + d1 * f + e1 * g
        az = a_f[2] + d2 * f + e2 * g + gravity
        side = ax * ax + ay * ay
        size = np.sqrt(side + az * az)
        if s > 0:
            # Trapezia are enough for the mass; the increment below is Simpson's. What burns in a
            # step is a small share of the mass: three terms of the exponential leave 1e-9 of it.
            burnt = 0.5 * (before + size) * step / exhaust
            if burnt < 0.02:
                left_mass *= 1.0 - burnt * (1.0 - burnt * (0.5 - burnt / 6.0))
            else:
                left_mass *= np.exp(-burnt)
        before = size
        thrust = left_mass * size
        bound = tan_tilt * az
        if thrust > most or thrust < least or az <= 0.0 or side > bound * bound:
            return False
        big = u * big_t
        ahead = 0.5 * a_f[0] + x0 * f / (low + 2.0) + y0 * g / (high + 2.0)
        x = big * (big * ahead - v_f[0])
        ahead = 0.5 * a_f[1] + x1 * f / (low + 2.0) + y1 * g / (high + 2.0)
        y = big * (big * ahead - v_f[1])
        ahead = 0.5 * a_f[2] + x2 * f / (low + 2.0) + y2 * g / (high + 2.0)
        z = big * (big * ahead - v_f[2]) + 0.5
        if glide > 0.0:
            if z < 0.0 or z * z < glide * glide * (x * x + y * y):
                return False
        elif z < glide * np.sqrt(x * x + y * y):
            return False
        peak = max(peak, thrust)
        lean = max(lean, side / (az * az))
        # Simpson's rule over an even number of intervals.
        weight = 1.0 if s in (0, samples) else (4.0 if s % 2 == 1 else 2.0)
        total += weight * size
    out[0] = total * step / 3.0
    out[1] = big_t
    out[2] = peak
    out[3] = np.sqrt(lean)
    return True


@kernel(parallel=True)
def survey(
    r, v, targets, v_f, a_f, first, last, coarse, rough, table, powers, gravity, mass, limits, out,
):  # fmt: skip
    """Find for each target the admissible time-to-go that takes the least velocity increment.

    Writes (n, 4): the increment (inf where no time is admissible), the time, the greatest thrust
    (N) and the greatest tangent of its lean (see `measure`). `coarse` times a target are tried in
    geometric steps from `first` to `last` (n,) on the samples of `rough`, and where none of them
    will do those between, three to a step. Then the steps about the best are halved five times on
    the samples of `table`, which finds an edge of what is admissible as well as a dip. NaN for no
    time.
    """
    for n in prange(targets.shape[0]):
        found = np.empty(4)
        out[n, 0] = np.inf
        out[n, 1:] = np.nan
        if not (0.0 < first[n] <= last[n] < np.inf):
            continue
        span = np.log(last[n] / first[n])
        step = span / max(coarse - 1, 1)
        best, least = -1.0, np.inf
        for m in range(coarse):
            at = m * step
            if (
                measure(
                    r,
                    v,
                    targets[n],
                    v_f,
                    a_f,
                    first[n] * np.exp(at),
                    rough,
                    powers,
                    gravity,
                    mass,
                    limits,
                    found,
                )
                and found[0] < least
            ):
                best, least = at, found[0]
        if best < 0.0 and step > 0.0:
            step /= 3.0
            for m in range(3 * (coarse - 1)):
                at = m * step
                if (
                    m % 3 != 0
                    and measure(
                        r,
                        v,
                        targets[n],
                        v_f,
                        a_f,
                        first[n] * np.exp(at),
                        rough,
                        powers,
                        gravity,
                        mass,
                        limits,
                        found,
                    )
                    and found[0] < least
                ):
                    best, least = at, found[0]
        if best < 0.0:
            continue
        if measure(
            r, v, targets[n], v_f, a_f, first[n] * np.exp(best), table, powers, gravity, mass,
            limits, found,
        ):  # fmt: skip
            out[n] = found
        for _ in range(5 if step > 0.0 else 0):
            step *= 0.5
            middle = best
            for at in (middle - step, middle + step):
                if (
                    0.0 <= at <= span
                    and measure(
                        r,
                        v,
                        targets[n],
                        v_f,
                        a_f,
                        first[n] * np.exp(at),
                        table,
                        powers,
                        gravity,
                        mass,
                        limits,
                        found,
                    )
                    and found[0] < out[n, 0]
                ):
                    out[n] = found
                    best = at


@kernel()
def excess(r, v, target, v_f, a_f, big_t, jerk, snap):
    """Return by how much a quartic path breaks its limits on jerk and snap; negative if it keeps.

    Jerk is linear in time, so it is greatest at an end; snap is constant.
    """
    at_end = 0.0
    at_start = 0.0
    fourth = 0.0
    for k in range(3):
        p = (v_f[k] - v[k]) / big_t - a_f[k]
        q = (v_f[k] * big_t - target[k] + r[k]) / big_t**2 - 0.5 * a_f[k]
        first = 3.0 * (4.0 * q - p)
        d, e = 2.0 * first, 3.0 * (p - first)
        at_end += d * d
        at_start += (d + 2.0 * e) ** 2
        fourth += e * e
    most = np.sqrt(max(at_end, at_start)) / big_t
    return max(most / jerk, 2.0 * np.sqrt(fourth) / big_t**2 / snap) - 1.0


@kernel(parallel=True)
def limited_times(r, v, targets, v_f, a_f, times, jerk, snap, out):
    """Find for each target (n, 3) the least time-to-go that keeps both limits (n,), else NaN.

    Times (m,) ascend; the least is bracketed by them and halved 40 times.
    """
    for n in prange(targets.shape[0]):
        out[n] = np.nan
        for m in range(times.shape[0]):
            if excess(r, v, targets[n], v_f, a_f, times[m], jerk, snap) > 0.0:
                continue
            if m == 0:
                out[n] = times[0]
                break
            low, high = times[m - 1], times[m]
            for _ in range(40):
                middle = 0.5 * (low + high)
                if excess(r, v, targets[n], v_f, a_f, middle, jerk, snap) > 0.0:
                    low = middle
                else:
                    high = middle
            out[n] = high
            break
