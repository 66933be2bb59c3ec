"""A divert's paths sampled one by one: which time-to-go is admissible and takes least."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid, simpson


def path(r, v, target, v_f, a_f, total, t):
    """Return positions and accelerations (n, 3) of the quartic path that ends as asked."""
    # a(t) = c0 + c1 t + c2 t^2, integrated once and twice, against what is asked at the end.
    ends = np.array(
        [
            [1.0, total, total**2],
            [total, total**2 / 2.0, total**3 / 3.0],
            [total**2 / 2.0, total**3 / 6.0, total**4 / 12.0],
        ]
    )
    c = np.linalg.solve(ends, [a_f, v_f - v, target - r - v * total])
    t = t[:, None]
    acceleration = c[0] + c[1] * t + c[2] * t**2
    return r + v * t + c[0] * t**2 / 2 + c[1] * t**3 / 6 + c[2] * t**4 / 12, acceleration


def best(
    r, v, target, v_f, a_f, times, samples, gravity, mass, exhaust, least, most, tan_tilt, glide
):
    """Return increment, time, greatest thrust and lean of the cheapest admissible time, or NaN."""
    found = [np.inf, np.nan, np.nan, np.nan]
    for total in times:
        t = np.linspace(0.0, total, samples + 1)
        place, pull = path(r, v, target, v_f, a_f, total, t)
        pull = pull + [0.0, 0.0, gravity]
        size = np.linalg.norm(pull, axis=1)
        side = np.hypot(pull[:, 0], pull[:, 1])
        thrust = mass * np.exp(-cumulative_trapezoid(size, t, initial=0.0) / exhaust) * size
        away = np.hypot(*(place - target)[:, :2].T)
        above = (place - target)[:, 2] - glide * away + 0.5
        good = (thrust <= most) & (thrust >= least) & (side <= tan_tilt * pull[:, 2]) & (above >= 0)
        increment = simpson(size, x=t)
        if good.all() and increment < found[0]:
            found = [increment, total, thrust.max(), (side / pull[:, 2]).max()]
    return found
