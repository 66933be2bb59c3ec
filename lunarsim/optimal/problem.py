"""A landing to be flown with the least propellant: where from, where to, and what it must keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.optimal.checks import LARGEST, is_number, numbers

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cone:
    """Half-spaces ``normals @ (r - end) >= -drop`` that a path keeps: a cone over its end.

    Its first and last piece are left out: a majorant of terrain may have the start under it.

    Attributes
    ----------
    normals
        (n, 3), dimensionless.
    drop
        By how much its tip lies under the end, m; 0 or more.

    Raises
    ------
    InputError
        If there is none, or a figure is not finite, or its tip lies above the end.
    """

    normals: Array
    drop: float = 0.0

    def __post_init__(self) -> None:
        expected = "at least one half-space: finite normals (n, 3)"
        rows = len(self.normals) if np.ndim(self.normals) == 2 else 0
        object.__setattr__(self, "normals", numbers("cone", self.normals, (rows, 3), expected))
        if rows == 0:
            raise InputError("optimal.cone", self.normals.shape, expected)
        if not (is_number(self.drop) and self.drop >= 0.0):
            raise InputError("optimal.cone", self.drop, "a drop of 0 m or more")


@dataclass(frozen=True)
class Descent:
    """A powered descent of a point mass under uniform gravity.

    Attributes
    ----------
    position, velocity
        At the start (3,), ENU, m and m/s.
    mass
        At the start, kg.
    end_position, end_velocity
        Where it ends (3,), m and m/s.
    gravity
        Downward acceleration, m/s^2.
    thrust_min, thrust_max
        Of the engine that burns all the way, along the lander, N.
    exhaust_velocity
        Thrust over mass flow, m/s: less than the specific impulse says where nozzles are canted.
    dry_mass
        Least mass at the end, reserve included, kg.
    max_tilt
        Of the thrust from the vertical, rad; None for none.
    end_tilt, tilt_rate
        Greatest tilt at the end, rad, and by how much it may grow a second before it, rad/s: a
        lander that has to be upright soon cannot turn at once. None: `max_tilt` to the end.
    glideslope
        Least elevation of the path as seen from its end, rad; None: it may pass under its end.
    drop
        By how much the glideslope's tip lies under the end, m.
    cone
        Half-spaces over the end besides (a majorant of the terrain); None for none.
    region
        Radius about `end_position` within which the path may end, level, m; 0: there alone.
    spare
        Thrust above `thrust_max` that may be had at a price, N.
    spare_price
        Increment that all of it is worth, however long it is had, m/s: the most of it that is had
        at any time counts.

    Raises
    ------
    InputError
        If something is not finite or cannot be: see the message.
    """

    position: Array
    velocity: Array
    mass: float
    end_position: Array
    end_velocity: Array
    gravity: float
    thrust_min: float
    thrust_max: float
    exhaust_velocity: float
    dry_mass: float
    max_tilt: float | None = None
    glideslope: float | None = None
    drop: float = 0.0
    cone: Cone | None = None
    region: float = 0.0
    end_tilt: float | None = None
    tilt_rate: float = np.deg2rad(10.0)
    spare: float = 0.0
    spare_price: float = 5.0

    def __post_init__(self) -> None:
        for name in ("position", "velocity", "end_position", "end_velocity"):
            value = numbers(name, getattr(self, name), (3,), "three finite coordinates")
            if np.abs(value).max() > LARGEST:
                raise InputError(f"optimal.{name}", value, f"coordinates up to {LARGEST:g}")
            object.__setattr__(self, name, value)
        for name in ("mass", "gravity", "thrust_max", "exhaust_velocity", "dry_mass"):
            value = getattr(self, name)
            if not (is_number(value) and 0.0 < value <= LARGEST):
                raise InputError(f"optimal.{name}", value, f"a positive number up to {LARGEST:g}")
        for name in ("thrust_min", "drop", "region", "spare", "spare_price", "tilt_rate"):
            value = getattr(self, name)
            if not (is_number(value) and 0.0 <= value <= LARGEST):
                raise InputError(f"optimal.{name}", value, f"a number from 0 to {LARGEST:g}")
        if not self.thrust_min < self.thrust_max:
            raise InputError("optimal.thrust_min", self.thrust_min, f"under {self.thrust_max} N")
        if not self.dry_mass < self.mass:
            raise InputError("optimal.mass", self.mass, f"more than the {self.dry_mass} kg left")
        if self.region > 0.0 and self.spare > 0.0:
            raise InputError("optimal.spare", self.spare, "0 where the end is a region")
        if not (self.cone is None or isinstance(self.cone, Cone)):
            raise InputError("optimal.cone", type(self.cone).__name__, "a Cone, or None")
        for name in ("max_tilt", "glideslope", "end_tilt"):
            angle = getattr(self, name)
            if angle is not None and not (is_number(angle) and 0.0 <= angle < 0.5 * np.pi):
                raise InputError(f"optimal.{name}", angle, "an angle from 0 to 90 deg, in rad")

    @property
    def gap(self) -> Array:
        """From the end to the start (3,), m."""
        return np.asarray(self.position - self.end_position)

    @property
    def outside(self) -> bool:
        """Whether it starts under the glideslope of every end that it may have."""
        if self.glideslope is None:
            return False
        gap, slack = self.gap, 1e-9 * (1.0 + float(np.linalg.norm(self.gap)))
        aside = max(float(np.hypot(gap[0], gap[1])) - self.region, 0.0)
        return bool(gap[2] + self.drop < np.tan(self.glideslope) * aside - slack)

    def tilts(self, left: Array) -> Array | None:
        """Return the greatest tilts (n,), rad, with so much time left (n,), s; None for none."""
        if self.max_tilt is None and self.end_tilt is None:
            return None
        # A right angle: any more is no convex set, and none is needed to land.
        most = np.full(len(left), 0.5 * np.pi if self.max_tilt is None else self.max_tilt)
        if self.end_tilt is None:
            return most
        return np.asarray(np.minimum(most, self.end_tilt + self.tilt_rate * left))

    @property
    def tanks(self) -> float:
        """Velocity increment that may be spent, m/s."""
        return float(self.exhaust_velocity * np.log(self.mass / self.dry_mass))

    def burnt(self, increment: float) -> float:
        """Return the propellant (kg) of a velocity increment (m/s)."""
        return float(self.mass * -np.expm1(-increment / self.exhaust_velocity))
