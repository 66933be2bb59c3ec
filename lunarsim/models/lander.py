"""What the lander is: geometry, masses, engine, tolerances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.parts.quantity import check_bounds, quantity

STANDARD_GRAVITY = 9.80665  # m/s^2, by definition; turns specific impulse into exhaust speed
# Squared radii of gyration of a lander whose moments are not given, m^2: of what is left when the
# tanks are empty, about each body axis, and of the propellant. 1,100 kg and 400 kg of propellant
# have 1100, 1100, 1300 and 1400, 1400, 1600 kg m^2.
_DRY_GYRATION = (1.0, 1.0, 13.0 / 11.0)
_PROPELLANT_GYRATION = 0.75


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
        Principal moments about the centre of mass (3,), kg m^2, with tanks empty and full; those
        left out follow the masses.
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

    Examples
    --------
    >>> lander = Lander(leg_radius=1.8)
    >>> lander.wet_mass, lander.pads.shape
    (1500.0, (4, 3))
    """

    dry_mass: float = quantity(1100.0, "kg", gt=0, help="without propellant")
    propellant_mass: float = quantity(400.0, "kg", gt=0, help="full tanks")
    inertia_dry: tuple[float, float, float] | None = quantity(
        None, "kg m^2", gt=0,
        help="principal moments, tanks empty; left out: 1, 1 and 1.18 m^2 times dry_mass_kg",
    )  # fmt: skip
    inertia_full: tuple[float, float, float] | None = quantity(
        None, "kg m^2", gt=0,
        help="principal moments, tanks full; left out: 0.75 m^2 times propellant_mass_kg more",
    )  # fmt: skip
    thrust_min: float = quantity(600.0, "N", ge=0, help="of the running engine")
    thrust_max: float = quantity(6000.0, "N", gt=0, help="of the engine")
    specific_impulse: float = quantity(311.0, "s", gt=0, help="of the engine")
    thrust_lag: float = quantity(0.1, "s", ge=0, help="time constant of the engine")
    torque_max: tuple[float, float, float] = quantity(
        (600.0, 600.0, 300.0), "N m", gt=0, help="of the thrusters about each body axis"
    )
    legs: Literal[3, 4] = quantity(4, help="number of legs")
    leg_radius: float = quantity(2.35, "m", gt=0, help="circle of the pads' centres")
    pad_diameter: float = quantity(0.3, "m", gt=0, help="of each pad")
    com_height: float = quantity(1.6, "m", gt=0, help="centre of mass above the pads")
    belly_clearance: float = quantity(0.25, "m", gt=0, help="underside above the pads")
    slope_limit: float = quantity(10.0, "deg", gt=0, lt=45, help="of the ground landed on")
    roughness_limit: float = quantity(0.25, "m", gt=0, help="of the ground landed on")
    vertical_speed_limit: float = quantity(3.0, "m/s", gt=0, help="at touchdown")
    horizontal_speed_limit: float = quantity(1.0, "m/s", gt=0, help="at touchdown")
    tilt_limit: float = quantity(6.0, "deg", gt=0, lt=90, help="at touchdown")
    rate_limit: float = quantity(6.0, "deg/s", gt=0, help="at touchdown")

    def __post_init__(self) -> None:
        check_bounds(self, "vehicle")
        if self.legs not in (3, 4):
            raise InputError("vehicle.legs", self.legs, "3 or 4")
        if self.thrust_min >= self.thrust_max:
            raise InputError("vehicle.thrust_min", self.thrust_min, f"less than {self.thrust_max}")
        self._follow_mass()
        for name in ("inertia_dry", "inertia_full"):
            a, b, c = sorted(getattr(self, name))
            if a + b < c:
                raise InputError(
                    f"vehicle.{name}",
                    getattr(self, name),
                    "three positive moments, none larger than the sum of the others",
                )
        if self.pad_diameter >= self.leg_radius:
            raise InputError(
                "vehicle.pad_diameter", self.pad_diameter, f"less than {self.leg_radius}"
            )

    def _follow_mass(self) -> None:
        """Set the moments that are left out."""
        if self.inertia_dry is None:
            dry = tuple(round(self.dry_mass * k, 9) for k in _DRY_GYRATION)
            object.__setattr__(self, "inertia_dry", dry)
        if self.inertia_full is None:
            more = _PROPELLANT_GYRATION * self.propellant_mass
            full = tuple(round(moment + more, 9) for moment in self.inertia_dry or ())
            object.__setattr__(self, "inertia_full", full)

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

    def inertia(self, mass: float) -> NDArray[np.float64]:
        """Return the principal moments (3,) at a mass (kg), kg m^2; linear in the propellant."""
        full = (mass - self.dry_mass) / self.propellant_mass
        dry, wet = np.asarray(self.inertia_dry), np.asarray(self.inertia_full)
        return np.asarray(dry + full * (wet - dry))

    def check_hover(self, gravity: float) -> None:
        """Raise `InputError` unless the engine can hold the full lander against `gravity`."""
        weight = self.wet_mass * gravity
        if self.thrust_max <= weight:
            raise InputError(
                "vehicle.thrust_max_n",
                self.thrust_max,
                f"more than the lander's weight of {weight:.0f} N: it cannot hover",
            )
        if self.thrust_min >= self.dry_mass * gravity:
            raise InputError(
                "vehicle.thrust_min_n",
                self.thrust_min,
                f"less than the empty lander's weight of {self.dry_mass * gravity:.0f} N: "
                "it cannot descend",
            )
