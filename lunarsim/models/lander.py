"""What the lander is: geometry, masses, engine, tolerances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError

STANDARD_GRAVITY = 9.80665  # m/s^2, by definition; turns specific impulse into exhaust speed


@dataclass(frozen=True)
class Lander:
    """A legged lander with one throttleable engine along body z.

    Geometry and landing tolerances default to Table 2 of the Gaussian DEM paper: 5 m across,
    pads of 0.3 m, 10 deg, 0.25 m. The pads' centres lie on a circle of (5.0 - 0.3) / 2 m.

    Attributes
    ----------
    dry_mass, propellant_mass
        kg.
    inertia_dry, inertia_full
        Principal moments about the centre of mass (3,), kg m^2, with tanks empty and full.
    thrust_min, thrust_max
        Throttle range of the running engine, N.
    specific_impulse
        s.
    thrust_lag
        Time constant of the engine's first-order response, s.
    torque_max
        Torque that the reaction control system can give about each body axis (3,), N m.
    legs, leg_radius, pad_diameter
        Number of legs; circle of the pads' centres and pads, m.
    com_height
        Centre of mass above the plane of the pads, m.
    belly_clearance
        Underside above the plane of the pads inside the polygon of the legs, m.
    slope_limit, roughness_limit
        Landing tolerances, rad and m.
    vertical_speed_limit, horizontal_speed_limit
        At touchdown, m/s.
    tilt_limit
        Of the body from the vertical when the first pad touches, rad.
    rate_limit
        Angular rate at touchdown, rad/s.
    """

    dry_mass: float = 1100.0
    propellant_mass: float = 400.0
    inertia_dry: tuple[float, float, float] = (1100.0, 1100.0, 1300.0)
    inertia_full: tuple[float, float, float] = (1400.0, 1400.0, 1600.0)
    thrust_min: float = 600.0
    thrust_max: float = 6000.0
    specific_impulse: float = 311.0
    thrust_lag: float = 0.1
    torque_max: tuple[float, float, float] = (600.0, 600.0, 300.0)
    legs: int = 4
    leg_radius: float = 2.35
    pad_diameter: float = 0.3
    com_height: float = 1.6
    belly_clearance: float = 0.25
    slope_limit: float = np.deg2rad(10.0)
    roughness_limit: float = 0.25
    vertical_speed_limit: float = 3.0
    horizontal_speed_limit: float = 1.0
    tilt_limit: float = np.deg2rad(6.0)
    rate_limit: float = np.deg2rad(6.0)

    def __post_init__(self) -> None:
        positive = (
            "dry_mass", "propellant_mass", "thrust_max", "specific_impulse", "leg_radius",
            "pad_diameter", "com_height", "slope_limit", "roughness_limit",
            "vertical_speed_limit", "horizontal_speed_limit", "tilt_limit", "rate_limit",
        )  # fmt: skip
        for name in positive:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"lander.{name}", value, "a positive number")
        if self.legs not in (3, 4):
            raise InputError("lander.legs", self.legs, "3 or 4")
        if not 0.0 <= self.thrust_min < self.thrust_max:
            raise InputError(
                "lander.thrust_min", self.thrust_min, f"0 or more and less than {self.thrust_max}"
            )
        if self.thrust_lag < 0.0:
            raise InputError("lander.thrust_lag", self.thrust_lag, "0 or more seconds")
        for name in ("inertia_dry", "inertia_full"):
            a, b, c = sorted(getattr(self, name))
            if not (a > 0.0 and a + b >= c):
                raise InputError(
                    f"lander.{name}",
                    getattr(self, name),
                    "three positive moments, none larger than the sum of the others",
                )
        if self.pad_diameter >= self.leg_radius:
            raise InputError(
                "lander.pad_diameter", self.pad_diameter, f"less than {self.leg_radius}"
            )
        if self.slope_limit >= np.pi / 4:
            raise InputError("lander.slope_limit", self.slope_limit, "less than 45 deg")

    @property
    def wet_mass(self) -> float:
        """Mass with full tanks, kg."""
        return self.dry_mass + self.propellant_mass

    @property
    def exhaust_velocity(self) -> float:
        """Effective exhaust velocity, m/s."""
        return self.specific_impulse * STANDARD_GRAVITY

    @property
    def pads(self) -> NDArray[np.float64]:
        """Pad centres in body axes (legs, 3), m; the first lies 45 deg (or 0) off body x."""
        first = np.pi / 4 if self.legs == 4 else 0.0
        angle = first + 2.0 * np.pi * np.arange(self.legs) / self.legs
        return np.column_stack(
            (
                self.leg_radius * np.cos(angle),
                self.leg_radius * np.sin(angle),
                np.full(self.legs, -self.com_height),
            )
        )

    def check_hover(self, gravity: float) -> None:
        """Raise `InputError` unless the engine can hold the full lander against `gravity`."""
        weight = self.wet_mass * gravity
        if self.thrust_max <= weight:
            raise InputError(
                "lander.thrust_max_n",
                self.thrust_max,
                f"more than the lander's weight of {weight:.0f} N: it cannot hover",
            )
        if self.thrust_min >= self.dry_mass * gravity:
            raise InputError(
                "lander.thrust_min_n",
                self.thrust_min,
                f"less than the empty lander's weight of {self.dry_mass * gravity:.0f} N: "
                "it cannot descend",
            )
