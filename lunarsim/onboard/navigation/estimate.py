"""The contract of navigation: an estimate with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True)
class NavigationEvent:
    """Something that navigation reports.

    Attributes
    ----------
    time
        s.
    name
        For instance "lock", "lock-lost" or "relock".
    details
        Figures for the record.
    """

    time: float
    name: str
    details: dict[str, Any]


class Navigation(Protocol):
    """Anything that turns measurements into an `Estimate`.

    Attributes
    ----------
    events
        What it has reported so far.
    """

    events: list[NavigationEvent]

    def take(self, measurement: Any, time: float) -> None:
        """Take in one measurement; what it cannot use changes nothing."""
        ...

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the estimate at `time` with the mass (kg) that the computer keeps."""
        ...
