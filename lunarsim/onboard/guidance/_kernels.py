"""Compiled survey of polynomial trajectories."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def survey(
    r, v, targets, v_f, a_f, times, samples, gravity, thrust_least, thrust_most, tan_tilt, glide,
    out_dv, out_time,
):  # fmt: skip
    """Find for each target the admissible time-to-go that takes the least velocity increment.

    Writes the increment (inf where no time is admissible) and the time. A trajectory is
    admissible when its thrust acceleration stays within [thrust_least, thrust_most], leans no
    more than tan_tilt from the vertical, and its path stays above the cone of slope `glide`
    around the target.
    """
    for n in range(targets.shape[0]):
        out_dv[n] = np.inf
        out_time[n] = np.nan
        for m in range(times.size):
            big_t = times[m]
            c0 = a_f + 12.0 * (targets[n] - r) / big_t**2 - 6.0 * (v_f + v) / big_t
            da = a_f - c0
            dv = v_f - v - c0 * big_t
            c1 = (6.0 * dv - 2.0 * da * big_t) / big_t**2
            c2 = (3.0 * da * big_t - 6.0 * dv) / big_t**3
            total = 0.0
            good = True
            for s in range(samples + 1):
                t = big_t * s / samples
                ax = c0[0] + t * (c1[0] + t * c2[0])
                ay = c0[1] + t * (c1[1] + t * c2[1])
                az = c0[2] + t * (c1[2] + t * c2[2]) + gravity
                side = np.hypot(ax, ay)
                size = np.hypot(side, az)
                if size > thrust_most or size < thrust_least or side > tan_tilt * az:
                    good = False
                    break
                x = r[0] + t * (v[0] + t * (c0[0] / 2 + t * (c1[0] / 6 + t * c2[0] / 12)))
                y = r[1] + t * (v[1] + t * (c0[1] / 2 + t * (c1[1] / 6 + t * c2[1] / 12)))
                z = r[2] + t * (v[2] + t * (c0[2] / 2 + t * (c1[2] / 6 + t * c2[2] / 12)))
                away = np.hypot(x - targets[n, 0], y - targets[n, 1])
                if z - targets[n, 2] < glide * away - 0.5:
                    good = False
                    break
                # Simpson's rule over an even number of intervals.
                weight = 1.0 if s in (0, samples) else (4.0 if s % 2 == 1 else 2.0)
                total += weight * size
            total *= big_t / samples / 3.0
            if good and total < out_dv[n]:
                out_dv[n] = total
                out_time[n] = big_t
