"""What a mission tells the onboard computer before the descent, and all that it tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.prior_map import PriorMap
from lunarsim.models.gravity import GravityModel, UniformGravity
from lunarsim.models.lander import Lander
from lunarsim.rocks.population import RockExpectation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StartEstimate:
    """Where the descent begins, as the mission knows it.

    Attributes
    ----------
    position, velocity
        Site frame (3,), m and m/s.
    attitude
        Quaternion, body to ENU (4,).
    position_sigma, velocity_sigma, attitude_sigma
        Standard deviations an axis, m, m/s, rad.
    ground_sigma
        Of the target's elevation, m.
    """

    position: Array
    velocity: Array
    attitude: Array
    position_sigma: float
    velocity_sigma: float
    attitude_sigma: float
    ground_sigma: float = 0.0


@dataclass(frozen=True)
class Software:
    """The parts that run on the computer, chosen and set by the scenario.

    Attributes
    ----------
    navigation, guidance, control
        One part each.
    tasking
        By the name of the sensor that it points.
    mappers
        By name.
    approach
        Where its phases end, and what paths must respect.
    decisions
        When a policy is asked, on which mapper's map, and what it chooses from.
    descent
        How to come down after the approach; None: straight down at a constant speed.
    braking
        What comes before the approach; None: nothing.
    window
        Look angles within which a site can be designated; None: any.
    """

    navigation: Any
    guidance: Any
    control: Any
    tasking: Mapping[str, Any]
    mappers: Mapping[str, Any]
    approach: Any
    decisions: Any
    descent: Any = None
    braking: Any = None
    window: Any = None


@dataclass(frozen=True)
class Briefing:
    """All that an onboard computer is built from.

    Attributes
    ----------
    software
        Its parts.
    lander
        Figures of the vehicle.
    instruments
        Calibrations of the sensors, by name.
    gravity
        By position.
    target
        Where to land, site frame (3,), m.
    heading
        Azimuth of body x, to be held, rad.
    start
        Where the descent begins.
    time_to_go
        Planned duration of the approach, s.
    sun
        Direction towards the Sun (3,), ENU.
    rocks
        What rocks are expected.
    prior_map
        Elevations known beforehand, site frame; None for none.
    step, cycle
        Between inertial samples and between control cycles, s.
    """

    software: Software
    lander: Lander
    instruments: Mapping[str, Any]
    gravity: GravityModel
    target: Array
    heading: float
    start: StartEstimate
    time_to_go: float
    sun: Array
    rocks: RockExpectation
    prior_map: PriorMap | None
    step: float
    cycle: float

    @property
    def field(self) -> GravityModel | None:
        """Gravity where it is not the same everywhere; else None."""
        return None if isinstance(self.gravity, UniformGravity) else self.gravity

    @property
    def weight(self) -> float:
        """Downward acceleration at the target, m/s^2."""
        return float(-self.gravity.at(self.target)[2])
