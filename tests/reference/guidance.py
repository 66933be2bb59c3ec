"""Guidance laws written plainly with NumPy."""

from __future__ import annotations

import numpy as np


def vertical_descent(position, velocity, end, nominal, law):
    """Return the thrust acceleration of the vertical descent (3,), m/s^2.

    `end` is the position of the centre of mass at touchdown and `nominal` the nominal vertical
    velocity; `law` has the settings of `VerticalDescent`.
    """

    def tangent(height, full_tilt_height):
        share = np.clip(height / full_tilt_height, 0.0, 1.0)
        low, high = law.max_tilt_at_touchdown, law.max_tilt
        return np.tan(low + share * (high - low))

    height = position[2] - end[2]
    excess = max(np.hypot(velocity[0], velocity[1]) - law.tolerated_speed, 0.0)
    stopping_time = excess / (0.5 * law.gravity * tangent(height, law.full_tilt_height))
    slowed = excess > 0.0 and -nominal * stopping_time > height
    wanted = min(-height / stopping_time, law.min_speed_fraction * nominal) if slowed else nominal
    up = max(law.gravity + law.speed_gain * (wanted - velocity[2]), 0.3 * law.gravity)
    offset = np.asarray(position)[:2] - np.asarray(end)[:2]
    horizontal = -(law.frequency**2) * offset
    horizontal = horizontal - 2.0 * law.damping * law.frequency * np.asarray(velocity)[:2]
    limit = up * tangent(height, law.low_height if wanted != nominal else law.full_tilt_height)
    size = np.hypot(*horizontal)
    if size > limit:
        horizontal = horizontal * limit / size
    return np.append(horizontal, up)
