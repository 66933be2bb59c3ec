"""From a wanted thrust acceleration to a throttle and an attitude."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander
from lunarsim.onboard.control import _kernels as k


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
    attitude = np.empty(4)
    thrust = k.steer(
        np.ascontiguousarray(acceleration, dtype=np.float64), mass, lander.thrust_min,
        lander.thrust_max, heading, max_tilt, attitude,
    )  # fmt: skip
    return Command(float(thrust), attitude)
