"""How far a lander is off a velocity that leads to its target: what shaping is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim_envs.descent.lanes import Lanes

Array = NDArray[np.float64]

# Share of what full thrust can brake by, against the weight and with full tanks, that the wanted
# velocity needs; a share of the limit of the speed downward, with which it reaches the ground.
_BRAKES, _LANDS = 0.38, 0.4
# Near the target the wanted speed is the distance over this time, s; along the ground it is so
# much faster, by when the lander is over the target before it is down.
_LAST, _SOONER = 4.0, 1.5


def wanted_velocity(lanes: Lanes) -> Array:
    """Return the velocity that leads to the target, braking evenly (n, 3), ENU, m/s.

    The way that is left over T + sqrt(r / 2 a), r the distance: from far off the root of 2 a r,
    which braking at `a` keeps to, near by r / T. Downward it is meant for a point a little below
    the ground, which is reached at a speed that the legs take.
    A field of velocities to reward is of Gaudet, Linares and Furfaro, "Deep reinforcement learning
    for six degree-of-freedom planetary landing", Advances in Space Research 65, 2020.
    """
    dynamics = lanes.craft.dynamics
    lander = dynamics.lander
    brakes = _BRAKES * (lander.thrust_max / lander.wet_mass - dynamics.gravity)
    away = lanes.y[:, :3] - lanes.target
    away[:, 2] = np.maximum(away[:, 2] - lander.com_height, 0.0)
    time = _LAST + np.sqrt(np.linalg.norm(away, axis=1) / (2.0 * brakes))
    away[:, 2] += _LAST * _LANDS * lander.vertical_speed_limit
    away[:, :2] *= (1.0 + _SOONER * _LAST / time)[:, None]
    return np.asarray(-away / time[:, None])


def off(lanes: Lanes) -> Array:
    """Return how far each lander is off the wanted velocity (n,).

    The logarithm of 1 + the difference over the limit of speed along the ground: it tells a metre
    a second from two at the end as well as ten from twenty on the way.
    """
    error = np.linalg.norm(lanes.y[:, 3:6] - wanted_velocity(lanes), axis=1)
    limit = lanes.craft.dynamics.lander.horizontal_speed_limit
    return np.asarray(np.log1p(error / limit))
