"""Conversion of a commanded thrust acceleration to throttle and attitude."""

from __future__ import annotations

import numpy as np

from lunarsim.frames import attitude_from_thrust
from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander
from lunarsim.onboard.control import _kernels as k
from lunarsim.typing import Array


def thrust_to_command(
    acceleration: Array,
    mass: float,
    lander: Lander,
    heading: float,
    max_tilt: float,
) -> Command:
    """Return throttle and attitude commands for a thrust acceleration.

    The tilt is limited to `max_tilt`. If the engine cannot produce the complete vector, the
    vertical component has priority and the horizontal component gets the remaining thrust: a
    horizontal error can be corrected later, a vertical one cannot.

    Parameters
    ----------
    acceleration
        Commanded thrust acceleration (3,), ENU, m/s^2.
    mass
        Estimated mass, kg.
    lander
        Lander with the throttle range.
    heading
        Azimuth of body x, rad.
    max_tilt
        Maximum tilt of the thrust from the vertical, rad.
    """
    attitude = np.empty(4)
    thrust = k.limited_thrust_attitude(
        np.ascontiguousarray(acceleration, dtype=np.float64), mass, lander.thrust_min,
        lander.thrust_max, heading, max_tilt, attitude,
    )  # fmt: skip
    return Command(float(thrust), attitude)


def thrust_along(
    acceleration: Array,
    mass: float,
    lander: Lander,
    heading: float,
    max_tilt: float,
) -> Command:
    """Return the command for a thrust acceleration, keeping the vector's direction.

    The magnitude is clipped to the throttle range. A direction with a tilt above `max_tilt` (which
    may exceed 90 deg) is rotated to that tilt; a direction straight down is rotated towards the
    heading. The parameters are those of `thrust_to_command`.
    """
    size = float(np.linalg.norm(acceleration))
    if size == 0.0:
        return Command(lander.thrust_min, attitude_from_thrust([0.0, 0.0, 1.0], heading))
    direction = acceleration / size
    lateral = float(np.hypot(direction[0], direction[1]))
    if np.arctan2(lateral, direction[2]) > max_tilt:
        heading_direction = np.array([np.sin(heading), np.cos(heading)])
        east, north = np.sin(max_tilt) * (
            direction[:2] / lateral if lateral > 0.0 else heading_direction
        )
        direction = np.array([east, north, np.cos(max_tilt)])
    thrust = min(max(size * mass, lander.thrust_min), lander.thrust_max)
    return Command(thrust, attitude_from_thrust(direction, heading))


def thrust_lift_first(
    acceleration: Array,
    mass: float,
    lander: Lander,
    heading: float,
    max_tilt: float,
) -> Command:
    """Return the command for a thrust acceleration, keeping its vertical component.

    The vertical component may point up or down. As in braking by the lunar module's computer
    (Luminary 099, AFCCALC2), the horizontal component gets the remaining thrust. Luminary reduces
    only the downrange part; here downrange and crossrange parts are reduced alike, which is
    equivalent for planar descents. Unlike in `thrust_to_command`, the tilt from the site's vertical
    may exceed 90 deg, which is necessary beyond the horizon. The parameters are those of
    `thrust_to_command`.
    """
    max_acceleration = lander.thrust_max / mass
    up = min(max(float(acceleration[2]), -max_acceleration), max_acceleration)
    # A small horizontal part remains to define the azimuth if `max_tilt` rotates the thrust.
    horizontal_limit = max(float(np.sqrt(max_acceleration**2 - up**2)), 1e-15 * max_acceleration)
    size = float(np.hypot(*acceleration[:2]))
    kept = acceleration[:2] * min(1.0, horizontal_limit / max(size, 1e-12))
    return thrust_along(np.array([*kept, up]), mass, lander, heading, max_tilt)
