"""A divert's paths sampled one by one: which time-to-go is admissible and takes least."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid, simpson


def path(r, v, target, v_f, a_f, total, t, powers=(1.0, 2.0)):
    """Return positions and accelerations (n, 3) of the path that ends as asked.

    The acceleration is that of the end and two powers of the time that is left, integrated from
    the start on.
    """

    def once(power, t):
        return (total ** (power + 1.0) - (total - t) ** (power + 1.0)) / (power + 1.0)

    def twice(power, t):
        gone = (total - t) ** (power + 2.0) - total ** (power + 2.0)
        whole = t * total ** (power + 1.0) / (power + 1.0)
        return gone / ((power + 1.0) * (power + 2.0)) + whole

    ends = np.array([[f(p, total) for p in powers] for f in (once, twice)])
    asked = np.array([
        v_f - v - a_f * total, target - r - v * total - 0.5 * a_f * total**2,
    ])  # fmt: skip
    k = np.linalg.solve(ends, asked)
    t = np.asarray(t)[:, None]
    acceleration, place = a_f + 0.0 * t, r + v * t + 0.5 * a_f * t**2
    for gain, power in zip(k, powers, strict=True):
        acceleration = acceleration + gain * (total - t) ** power
        place = place + gain * twice(power, t)
    return place, acceleration


def best(
    r, v, target, v_f, a_f, times, samples, gravity, mass, exhaust, least, most, tan_tilt, glide,
    tan_end, powers=(1.0, 2.0),
):  # fmt: skip
    """Return delta-v, time, peak thrust and tangent of tilt of the cheapest time, or NaN.

    The tangent of the tilt is at most `tan_tilt`, and `tan_end` at the end of the path.
    """
    found = [np.inf, np.nan, np.nan, np.nan]
    for total in times:
        t = np.linspace(0.0, total, samples + 1)
        place, pull = path(r, v, target, v_f, a_f, total, t, powers)
        pull = pull + [0.0, 0.0, gravity]
        size = np.linalg.norm(pull, axis=1)
        side = np.hypot(pull[:, 0], pull[:, 1])
        thrust = mass * np.exp(-cumulative_trapezoid(size, t, initial=0.0) / exhaust) * size
        away = np.hypot(*(place - target)[:, :2].T)
        above = (place - target)[:, 2] - glide * away + 0.5
        tan = np.append(np.full(samples, tan_tilt), tan_end)
        good = (thrust <= most) & (thrust >= least) & (side <= tan * pull[:, 2]) & (above >= 0)
        increment = simpson(size, x=t)
        if good.all() and increment < found[0]:
            found = [increment, total, thrust.max(), (side / pull[:, 2]).max()]
    return found


def reachable(r, v, target, v_f, a_f, gravity, mass, exhaust, least, most, tan_tilt, glide, dry,
              powers=(1.0, 2.0), times=600, samples=72):  # fmt: skip
    """Return the least propellant (kg) of a path to a target by brute force; inf for none.

    Everything is sampled finely, and all times at once.
    """
    total = np.geomspace(2.0, 400.0, times)
    t = np.linspace(0.0, 1.0, samples + 1) * total[:, None]  # (times, samples)
    left = total[:, None] - t
    # Two equations a time: the speed and the way that are to be made up.
    m = np.array([[total ** (p + k) / (p + k) for p in powers] for k in (1.0, 2.0)])
    asked = np.stack((
        (v_f - v) - a_f * total[:, None],
        # The moment of the acceleration about the end is the way less that of the speed now.
        target - r - v * total[:, None] - 0.5 * a_f * total[:, None] ** 2,
    ))  # fmt: skip
    k = np.linalg.solve(m.transpose(2, 0, 1), asked.transpose(1, 0, 2))  # (times, 2, 3)
    pull = a_f + sum(k[:, None, n] * left[..., None] ** p for n, p in enumerate(powers))
    back = sum(
        k[:, None, n] * left[..., None] ** (p + 2.0) / ((p + 1.0) * (p + 2.0))
        for n, p in enumerate(powers)
    )
    place = target - v_f * left[..., None] + 0.5 * a_f * left[..., None] ** 2 + back
    pull = pull + [0.0, 0.0, gravity]
    size = np.linalg.norm(pull, axis=-1)
    side = np.hypot(pull[..., 0], pull[..., 1])
    thrust = mass * np.exp(-cumulative_trapezoid(size, t, axis=1, initial=0.0) / exhaust) * size
    away = np.hypot(place[..., 0] - target[0], place[..., 1] - target[1])
    above = place[..., 2] - target[2] - glide * away + 0.5
    good = (thrust <= most) & (thrust >= least) & (side <= tan_tilt * pull[..., 2]) & (above >= 0)
    burnt = mass * (1.0 - np.exp(-simpson(size, x=t, axis=1) / exhaust))
    good = good.all(axis=1) & (burnt <= mass - dry)
    return burnt[good].min() if good.any() else np.inf


def steepness(r, v, target, v_f, a_f, total):
    """Return the greatest jerk and the snap of the one quartic that meets all at both ends.

    Its fifth derivative is nought: position is a polynomial of degree four an axis.
    """
    m = np.array([[total**3 / 6.0, total**4 / 24.0], [total**2 / 2.0, total**3 / 6.0]])
    # r + v t + a t^2/2 + j t^3/6 + s t^4/24, with a from the end: a = a_f - j t - s t^2/2.
    m = m - np.array([[total**2 / 2.0], [total]]) * np.array([total, total**2 / 2.0])
    asked = np.array([
        target - r - v * total - 0.5 * a_f * total**2, v_f - v - a_f * total,
    ])  # fmt: skip
    jerk, snap = np.linalg.solve(m, asked)
    ends = np.linalg.norm([jerk, jerk + snap * total], axis=1)
    return ends.max(), np.linalg.norm(snap)
