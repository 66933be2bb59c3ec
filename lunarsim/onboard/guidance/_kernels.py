"""Compiled survey of polynomial trajectories."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def survey(
    r, v, targets, v_f, a_f, times, samples, gravity, mass, exhaust, thrust_least, thrust_most,
    tan_tilt, glide, out,
):  # fmt: skip
    """Find for each target the admissible time-to-go that takes the least velocity increment.

    Writes (n, 4): the increment (inf where no time is admissible), the time, the greatest thrust
    (N) and the greatest tangent of its lean. A path is admissible when its thrust, with the mass
    that is left by then, stays within [thrust_least, thrust_most], leans no more than tan_tilt, and
    it stays above the cone of slope `glide` around the target.
    """
    for n in range(targets.shape[0]):
        out[n, 0] = np.inf
        out[n, 1:] = np.nan
        for m in range(times.shape[1]):
            big_t = times[n, m]
            c0 = a_f + 12.0 * (targets[n] - r) / big_t**2 - 6.0 * (v_f + v) / big_t
            da = a_f - c0
            dv = v_f - v - c0 * big_t
            c1 = (6.0 * dv - 2.0 * da * big_t) / big_t**2
            c2 = (3.0 * da * big_t - 6.0 * dv) / big_t**3
            total = 0.0
            burnt = 0.0
            before = 0.0
            peak = 0.0
            lean = 0.0
            good = True
            for s in range(samples + 1):
                t = big_t * s / samples
                ax = c0[0] + t * (c1[0] + t * c2[0])
                ay = c0[1] + t * (c1[1] + t * c2[1])
                az = c0[2] + t * (c1[2] + t * c2[2]) + gravity
                side = np.hypot(ax, ay)
                size = np.hypot(side, az)
                if s > 0:
                    # Trapezia are enough for the mass; the increment below is Simpson's.
                    burnt += 0.5 * (before + size) * big_t / samples
                before = size
                thrust = mass * np.exp(-burnt / exhaust) * size
                if thrust > thrust_most or thrust < thrust_least or side > tan_tilt * az:
                    good = False
                    break
                x = r[0] + t * (v[0] + t * (c0[0] / 2 + t * (c1[0] / 6 + t * c2[0] / 12)))
                y = r[1] + t * (v[1] + t * (c0[1] / 2 + t * (c1[1] / 6 + t * c2[1] / 12)))
                z = r[2] + t * (v[2] + t * (c0[2] / 2 + t * (c1[2] / 6 + t * c2[2] / 12)))
                away = np.hypot(x - targets[n, 0], y - targets[n, 1])
                if z - targets[n, 2] < glide * away - 0.5:
                    good = False
                    break
                peak = max(peak, thrust)
                lean = max(lean, side / az)
                # Simpson's rule over an even number of intervals.
                weight = 1.0 if s in (0, samples) else (4.0 if s % 2 == 1 else 2.0)
                total += weight * size
            total *= big_t / samples / 3.0
            if good and total < out[n, 0]:
                out[n, 0] = total
                out[n, 1] = big_t
                out[n, 2] = peak
                out[n, 3] = lean
