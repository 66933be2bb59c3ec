"""Mission data that the onboard computer receives before the descent."""

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
class InitialStateEstimate:
    """Estimate of the state at the start of the descent, with its uncertainty.

    Attributes
    ----------
    position, velocity
        Site frame, ENU (3,), m and m/s.
    attitude
        Quaternion, body to ENU (4,).
    position_sigma, velocity_sigma, attitude_sigma
        Standard deviations per axis, m, m/s, rad.
    target_elevation_sigma
        Standard deviation of the target's elevation, m.
    """

    position: Array
    velocity: Array
    attitude: Array
    position_sigma: float
    velocity_sigma: float
    attitude_sigma: float
    target_elevation_sigma: float = 0.0


@dataclass(frozen=True)
class FlightSoftware:
    """Parts of the onboard software that the scenario selects and configures.

    Attributes
    ----------
    navigation, guidance, control
            One part each.
        tasking
            Tasking parts by the name of the sensor that they point.
        mappers
            Mapping parts by name.
        approach
            Ends of the approach phases and constraints on its paths.
        decisions
            Decision times, the mapper whose map the policy uses, and its candidate sites.
        descent
            Terminal descent law; None: vertical descent at constant speed.
        braking
            Braking phase before the approach; None: no such phase.
        window
            Look angles within which a site can be designated; None: no limit.
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
    """Configuration of an onboard computer.

    Attributes
    ----------
    software
        Parts of the onboard software.
    lander
        Parameters of the vehicle.
    instruments
        Calibrations of the sensors by name.
    gravity
        Gravity model.
    target
        Landing target, site frame (3,), m.
    heading
        Azimuth of body x to be held, rad.
    start
        Estimate of the initial state.
    time_to_go
        Planned duration of the approach, s.
    sun
        Unit vector towards the Sun (3,), ENU.
    rocks
        Expected rock population.
    prior_map
        Elevation map known before the flight, site frame; None: no map.
    step, cycle
        Periods of the inertial samples and of the control cycle, s.
    """

    software: FlightSoftware
    lander: Lander
    instruments: Mapping[str, Any]
    gravity: GravityModel
    target: Array
    heading: float
    start: InitialStateEstimate
    time_to_go: float
    sun: Array
    rocks: RockExpectation
    prior_map: PriorMap | None
    step: float
    cycle: float

    @property
    def field(self) -> GravityModel | None:
        """Gravity model if gravity varies with position; else None."""
        return None if isinstance(self.gravity, UniformGravity) else self.gravity

    @property
    def weight(self) -> float:
        """Gravitational acceleration at the target, downward, m/s^2."""
        return float(-self.gravity.at(self.target)[2])
