"""Compute the shaping potential: deviation from a velocity towards the target."""

from __future__ import annotations

import numpy as np

from lunarsim.typing import Array
from lunarsim_envs.descent.batch import DescentBatch

# Deceleration of the reference velocity over the maximum one (full thrust minus gravity, full
# tanks). Touchdown speed over the vertical speed limit.
_BRAKES, _LANDS = 0.38, 0.4
# Near the target, the reference speed is the distance over _LAST, s. The horizontal speed is
# increased by _SOONER, so that the lander is above the target before it is down.
_LAST, _SOONER = 4.0, 1.5


def reference_velocity(lanes: DescentBatch) -> Array:
    """Return each lander's reference velocity towards its target (n, 3), ENU, m/s.

    It is the vector to the target divided by T + sqrt(r / 2 a), where r is the distance, a is 0.38
    of the maximum deceleration and T is 4 s. Far away its norm is about sqrt(2 a r), which
    corresponds to a constant deceleration a; near the target it is r / T. The horizontal part is
    increased, by up to 2.5 times near the target, so that the lander is above the target before
    touchdown. Vertically it aims at a point slightly below the terrain, so that touchdown occurs at
    a speed within the limit. Rewards based on a velocity field: Gaudet, Linares and Furfaro, "Deep
    reinforcement learning for six degree-of-freedom planetary landing", Advances in Space Research
    65, 2020.
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


def velocity_deviation(lanes: DescentBatch) -> Array:
    """Return how far the velocity of each lander is from its reference velocity (n,).

    The deviation is log(1 + error / horizontal speed limit). The logarithm distinguishes 1 from 2
    m/s near the end as well as 10 from 20 m/s earlier.
    """
    error = np.linalg.norm(lanes.y[:, 3:6] - reference_velocity(lanes), axis=1)
    limit = lanes.craft.dynamics.lander.horizontal_speed_limit
    return np.asarray(np.log1p(error / limit))
