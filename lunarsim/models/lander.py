"""Lander model: geometry, masses, engine and landing tolerances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.parts.quantity import check_bounds, hidden, quantity
from lunarsim.typing import Array

STANDARD_GRAVITY = 9.80665  # m/s^2, by definition; turns specific impulse into exhaust speed
# Squared radii of gyration (m^2) for a lander without given moments of inertia: of the dry lander
# about each body axis, and of the propellant. With 1,100 kg dry mass and 400 kg of propellant the
# moments are 1100, 1100, 1300 kg m^2 (empty) and 1400, 1400, 1600 kg m^2 (full).
_DRY_GYRATION = (1.0, 1.0, 13.0 / 11.0)
_PROPELLANT_GYRATION = 0.75


@dataclass(frozen=True)
class Lander:
    """Legged lander with one throttleable engine along body z.

    Geometry and landing tolerances default to Table 2 of the Gaussian DEM paper: 5 m diameter,
    pads of 0.3 m, 10 deg, 0.25 m. The pad centres lie on a circle of radius (5.0 - 0.3) / 2 m.

    Attributes
    ----------
    dry_mass, propellant_mass
        Mass without propellant, and propellant in full tanks, kg.
    inertia_dry, inertia_full
        Principal moments about the centre of mass (3,), kg m^2, with tanks empty and full; if
        omitted, they are computed from the masses.
    thrust_min, thrust_max
        Throttle range of the running engine, N.
    specific_impulse
        Specific impulse of the engine, s.
    thrust_lag
        Time constant of the engine's first-order response, s.
    torque_max
        Maximum torque of the reaction control system about each body axis (3,), N m.
    legs, leg_radius, pad_diameter
        Number of legs, radius of the circle of pad centres, and diameter of a pad, m.
    com_height
        Height of the centre of mass above the plane of the pads, m.
    belly_clearance
        Height of the underside above the plane of the pads, inside the polygon of the legs, m.
    slope_limit, roughness_limit
        Maximum terrain slope and roughness of a safe site, rad and m.
    vertical_speed_limit, horizontal_speed_limit
        Maximum speeds at touchdown, m/s.
    tilt_limit
        Maximum tilt of the body from the vertical at first pad contact, rad.
    rate_limit
        Maximum angular rate at touchdown, rad/s.
    thrust_scale, torque_scale, thrust_misalignment, com_offset
        Deviations of a true lander (`VehicleDeviations`): true thrust and torque divided by the
        commanded ones, rotation of the thrust axis about body x and y (2,), rad, and position of
        the centre of mass relative to the body's origin (3,), body axes, m.

    Examples
    --------
    >>> lander = Lander(leg_radius=1.8)
    >>> lander.wet_mass, lander.pads.shape
    (1500.0, (4, 3))
    """

    dry_mass: float = quantity(1100.0, "kg", gt=0, help="mass without propellant")
    propellant_mass: float = quantity(400.0, "kg", gt=0, help="propellant mass in full tanks")
    inertia_dry: tuple[float, float, float] | None = quantity(
        None, "kg m^2", gt=0,
            help="moments of inertia about body x, y and z with empty tanks; omitted: 1, 1 and "
            "1.18 m^2 times dry_mass_kg",
    )  # fmt: skip
    inertia_full: tuple[float, float, float] | None = quantity(
        None, "kg m^2", gt=0,
            help="moments of inertia about body x, y and z with full tanks; omitted: "
            "inertia_dry_kg_m2 plus 0.75 m^2 times propellant_mass_kg",
    )  # fmt: skip
    thrust_min: float = quantity(600.0, "N", ge=0, help="minimum thrust of the running engine")
    thrust_max: float = quantity(6000.0, "N", gt=0, help="maximum thrust of the engine")
    specific_impulse: float = quantity(311.0, "s", gt=0, help="specific impulse of the engine")
    thrust_lag: float = quantity(
        0.1, "s", ge=0, help="time constant of the engine's first-order response to thrust commands"
    )
    torque_max: tuple[float, float, float] = quantity(
        (600.0, 600.0, 300.0), "N m", gt=0, help="maximum control torque about each body axis"
    )
    legs: Literal[3, 4] = quantity(4, help="number of legs")
    leg_radius: float = quantity(
        2.35, "m", gt=0, help="radius of the circle through the centres of the landing pads"
    )
    pad_diameter: float = quantity(0.3, "m", gt=0, help="diameter of each landing pad")
    com_height: float = quantity(
        1.6, "m", gt=0, help="height of the centre of mass above the landing pads"
    )
    belly_clearance: float = quantity(
        0.25, "m", gt=0, help="height of the body's underside above the landing pads"
    )
    slope_limit: float = quantity(
        10.0, "deg", gt=0, lt=45, help="maximum terrain slope of a safe site"
    )
    roughness_limit: float = quantity(
        0.25, "m", gt=0, help="maximum terrain roughness of a safe site"
    )
    vertical_speed_limit: float = quantity(
        3.0, "m/s", gt=0, help="maximum vertical speed at a safe touchdown"
    )
    horizontal_speed_limit: float = quantity(
        1.0, "m/s", gt=0, help="maximum horizontal speed at a safe touchdown"
    )
    tilt_limit: float = quantity(6.0, "deg", gt=0, lt=90, help="maximum tilt at a safe touchdown")
    rate_limit: float = quantity(
        6.0, "deg/s", gt=0, help="maximum angular rate at a safe touchdown"
    )
    thrust_scale: float = hidden(1.0)
    torque_scale: float = hidden(1.0)
    thrust_misalignment: tuple[float, float] = hidden((0.0, 0.0))
    com_offset: tuple[float, float, float] = hidden((0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        check_bounds(self, "vehicle")
        if self.legs not in (3, 4):
            raise InputError("vehicle.legs", self.legs, "must be 3 or 4")
        if self.thrust_min >= self.thrust_max:
            raise InputError(
                "vehicle.thrust_min", self.thrust_min,
                f"must be less than the maximum thrust, {self.thrust_max:g} N",
            )  # fmt: skip
        self._set_default_inertia()
        for name in ("inertia_dry", "inertia_full"):
            a, b, c = sorted(getattr(self, name))
            if a + b < c:
                raise InputError(
                    f"vehicle.{name}",
                    getattr(self, name),
                    "must be three principal moments, none larger than the sum of the other two",
                )
        if self.pad_diameter >= self.leg_radius:
            raise InputError(
                "vehicle.pad_diameter", self.pad_diameter,
                f"must be less than the leg radius, {self.leg_radius:g} m",
            )  # fmt: skip

    def _set_default_inertia(self) -> None:
        """Set omitted moments of inertia to values computed from the masses."""
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
    def pads(self) -> Array:
        """Centres of the landing pads (legs, 3), body axes, m.

        The first pad is 45 deg from body x, or on body x if there are three legs.
        """
        first = np.pi / 4 if self.legs == 4 else 0.0
        angle = first + 2.0 * np.pi * np.arange(self.legs) / self.legs
        return np.column_stack(
            (
                self.leg_radius * np.cos(angle),
                self.leg_radius * np.sin(angle),
                np.full(self.legs, -self.com_height),
            )
        )

    def com(self, mass: float) -> Array:
        """Return the centre of mass (3,), body axes, m, for a total mass (kg)."""
        return np.asarray(self.com_offset)

    def inertia(self, mass: float) -> Array:
        """Return the principal moments of inertia (3,), kg m^2, for a total mass (kg)."""
        full = (mass - self.dry_mass) / self.propellant_mass
        dry, wet = np.asarray(self.inertia_dry), np.asarray(self.inertia_full)
        return np.asarray(dry + full * (wet - dry))

    def check_hover(self, gravity: float, reserve: float = 0.0) -> None:
        """Raise InputError unless the engine can hover and descend in `gravity` (m/s^2).

        Raises
        ------
        InputError
            If the maximum thrust is below the full weight, or the minimum above the weight at
            touchdown with the propellant `reserve`, kg.
        """
        weight = self.wet_mass * gravity
        if self.thrust_max <= weight:
            raise InputError(
                "vehicle.thrust_max_n",
                self.thrust_max,
                f"must be more than the weight of {weight:.0f} N, "
                "otherwise the lander cannot hover",
            )
        weight = (self.dry_mass + reserve) * gravity
        if self.thrust_min >= weight:
            raise InputError(
                "vehicle.thrust_min_n",
                self.thrust_min,
                f"must be less than the weight at touchdown with approach.reserve_kg, {weight:.0f} "
                "N, otherwise the lander cannot descend",
            )
