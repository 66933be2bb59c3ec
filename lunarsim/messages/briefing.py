"""Mission data that the onboard computer receives before the descent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lunarsim.messages.prior_map import PriorMap
from lunarsim.models.gravity import GravityModel, UniformGravity
from lunarsim.models.lander import Lander
from lunarsim.rocks.population import RockExpectation
from lunarsim.typing import Array


@dataclass(frozen=True)
class InitialStateEstimate:
    """Initial estimate of the lander's state, with its uncertainty.

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
    """Onboard software of a flight: its selected and configured components.

    Attributes
    ----------
    navigation, guidance, control
        Settings of state estimation, of the approach guidance law and of attitude control.
    tasking
        Settings of the pointing and timing of each sensor, by the name of the sensor.
    mappers
        Settings of the hazard mappers, by name.
    approach
        Ends of the approach phases and constraints on the paths of the approach.
    decisions
        Decision times, the mapper whose map the site selection uses, and the candidate sites.
    terminal_descent
        Guidance law of the terminal descent; None: vertical descent at constant speed.
    braking
        Settings of the braking phase before the approach; None: no such phase.
    designation_window
        Look angles within which a site can be designated; None: no limit.
    computer
        Settings of an external onboard computer; None: the onboard computer of lunarsim.
    """

    navigation: Any
    guidance: Any
    control: Any
    tasking: Mapping[str, Any]
    mappers: Mapping[str, Any]
    approach: Any
    decisions: Any
    terminal_descent: Any = None
    braking: Any = None
    designation_window: Any = None
    computer: Any = None


@dataclass(frozen=True)
class Briefing:
    """Data that the onboard computer knows before the descent.

    Attributes
    ----------
    software
        Selected components of the onboard software, with their settings.
    lander
        Parameters of the vehicle.
    instruments
        Calibrations of the sensors by name.
    gravity
        Gravity model.
    target
        Landing target, site frame (3,), m.
    heading
        Azimuth at which the lander holds its body x axis, rad, clockwise from north.
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
    def nonuniform_gravity(self) -> GravityModel | None:
        """Gravity model if gravity varies with position; None for uniform gravity."""
        return None if isinstance(self.gravity, UniformGravity) else self.gravity

    @property
    def surface_gravity(self) -> float:
        """Gravitational acceleration at the target, downward, m/s^2."""
        return float(-self.gravity.at(self.target)[2])
