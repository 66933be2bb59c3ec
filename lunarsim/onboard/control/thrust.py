"""From a wanted thrust acceleration to a throttle and an attitude."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import attitude_from_thrust
from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander


def thrust_to_command(
    acceleration: NDArray[np.float64],
    mass: float,
    lander: Lander,
    heading: float,
    max_tilt: float,
) -> Command:
    """Return the command that gives a thrust acceleration within the vehicle's limits.

    The direction is kept to `max_tilt` from the vertical. Where the engine cannot give the whole
    vector the vertical part comes first, and the horizontal part takes what thrust is left: a
    lander that falls short sideways corrects later, one that falls short upwards does not.

    Parameters
    ----------
    acceleration
        Wanted thrust acceleration (3,), ENU, m/s^2.
    mass
        Estimated mass, kg.
    lander
        Throttle range.
    heading
        Azimuth of body x, rad.
    max_tilt
        Largest tilt of the thrust from the vertical, rad.
    """
    most = lander.thrust_max / mass
    up = min(max(float(acceleration[2]), 1e-3), most)
    sideways = np.array(acceleration[:2], dtype=np.float64)
    size = float(np.hypot(*sideways))
    limit = min(np.sqrt(max(most * most - up * up, 0.0)), up * np.tan(max_tilt))
    if size > limit:
        sideways *= limit / size
    vector = np.array([sideways[0], sideways[1], up])
    thrust = float(np.clip(np.linalg.norm(vector) * mass, lander.thrust_min, lander.thrust_max))
    return Command(thrust, attitude_from_thrust(vector, heading))
