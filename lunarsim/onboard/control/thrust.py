"""From a wanted thrust acceleration to a throttle and an attitude."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import attitude_from_thrust
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


def thrust_along(
    acceleration: NDArray[np.float64],
    mass: float,
    lander: Lander,
    heading: float,
    max_tilt: float,
) -> Command:
    """Return the command that thrusts along an acceleration, whatever the engine can give of it.

    The direction is kept, the size held in the throttle range. A direction more than `max_tilt`
    (which may be over a quarter turn) from the vertical is turned towards it, one straight down
    over the heading. For the parameters see `thrust_to_command`.
    """
    size = float(np.linalg.norm(acceleration))
    if size == 0.0:
        return Command(lander.thrust_min, attitude_from_thrust([0.0, 0.0, 1.0], heading))
    along = acceleration / size
    aside = float(np.hypot(along[0], along[1]))
    if np.arctan2(aside, along[2]) > max_tilt:
        ahead = np.array([np.sin(heading), np.cos(heading)])
        east, north = np.sin(max_tilt) * (along[:2] / aside if aside > 0.0 else ahead)
        along = np.array([east, north, np.cos(max_tilt)])
    thrust = min(max(size * mass, lander.thrust_min), lander.thrust_max)
    return Command(thrust, attitude_from_thrust(along, heading))


def thrust_lift_first(
    acceleration: NDArray[np.float64],
    mass: float,
    lander: Lander,
    heading: float,
    max_tilt: float,
) -> Command:
    """Return the command that keeps the vertical part, up or down, where the engine falls short.

    As the lunar module's computer did in braking (Luminary 099, AFCCALC2): the vertical part stays,
    the horizontal part takes what thrust is left. There the part across the track stays too and
    only the downrange one gives way; here both give way alike, which is the same in the plane.
    Unlike `thrust_to_command` it may lean more than a quarter turn from the site's vertical, as it
    must beyond the horizon. For the parameters see there.
    """
    most = lander.thrust_max / mass
    up = min(max(float(acceleration[2]), -most), most)
    # However little is left aside, it says where a pull down beyond `max_tilt` is turned to.
    left = max(float(np.sqrt(most**2 - up**2)), 1e-15 * most)
    size = float(np.hypot(*acceleration[:2]))
    kept = acceleration[:2] * min(1.0, left / max(size, 1e-12))
    return thrust_along(np.array([*kept, up]), mass, lander, heading, max_tilt)
