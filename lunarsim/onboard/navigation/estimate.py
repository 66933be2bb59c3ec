"""The contract of navigation: an estimate with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.vehicle.state import State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """What the onboard computer knows of the lander.

    Attributes
    ----------
    time
        s.
    position, velocity
        ENU (3,), m and m/s.
    attitude
        Quaternion, body to ENU (4,).
    rate
        Body rate (3,), rad/s.
    mass
        kg.
    covariance
        Of position, velocity and small rotation in ENU (9, 9), m, m/s, rad.
    """

    time: float
    position: Array
    velocity: Array
    attitude: Array
    rate: Array
    mass: float
    covariance: Array


class Navigation(Protocol):
    """Anything that turns truth or measurements into an `Estimate`."""

    def update(self, state: State, time: float) -> Estimate:
        """Return the estimate at `time`; called once a control cycle."""
        ...
