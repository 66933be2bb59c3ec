"""Gravity models: uniform, and central in a rotating frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array


class GravityModel(Protocol):
    """Interface of gravity models.

    They give gravity, free-fall acceleration and the height above the datum.
    """

    def at(self, position: ArrayLike) -> Array:
        """Return the acceleration (3,), ENU, m/s^2, at a position (3,), m."""
        ...

    def free_fall_acceleration(self, position: ArrayLike, velocity: ArrayLike) -> Array:
        """Return the acceleration (..., 3), ENU, m/s^2, of a body without thrust.

        The acceleration includes gravity and the inertial accelerations of a rotating frame.

        Parameters
        ----------
        position, velocity
            Position and velocity (..., 3), ENU, m and m/s.
        """
        ...

    def height(self, position: ArrayLike) -> Array:
        """Return heights (...,), m, of positions (..., 3), ENU, above the datum.

        The datum is the sphere through the origin, or the plane z = 0 for uniform gravity.
        """
        ...


@dataclass(frozen=True)
class UniformGravity:
    """Uniform gravity, for a descent that spans about a kilometre.

    Attributes
    ----------
    magnitude
        Downward acceleration, m/s^2.

    Examples
    --------
    >>> UniformGravity(1.622).at([0.0, 0.0, 100.0])
    array([ 0.   ,  0.   , -1.622])
    """

    magnitude: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.magnitude) and self.magnitude > 0.0):
            raise InputError("gravity_m_s2", self.magnitude, "must be positive and finite")

    def at(self, position: ArrayLike) -> Array:
        """Return the constant acceleration (3,), ENU, m/s^2; `position` has no effect."""
        return np.array([0.0, 0.0, -self.magnitude])

    def free_fall_acceleration(self, position: ArrayLike, velocity: ArrayLike) -> Array:
        """Return the constant acceleration (..., 3), ENU, m/s^2, for each position."""
        return np.zeros(np.shape(position)) + self.at(position)

    def height(self, position: ArrayLike) -> Array:
        """Return the third coordinate (...,), m, of positions (..., 3)."""
        return np.asarray(np.asarray(position, dtype=np.float64)[..., 2])


@dataclass(frozen=True)
class RoundMoon:
    """Settings of a spherical, rotating Moon with central gravity.

    The sphere touches the horizontal plane of the site at the origin of the frame.

    Attributes
    ----------
    radius
        Distance of the frame's origin from the Moon's centre, m.
    spin
        Rotation rate of the Moon, rad/s.
    latitude
        Latitude of the frame's origin, rad, positive north.
    """

    radius: float = quantity(
        1_737_400.0, "m", gt=1e3, help="distance of the site frame's origin from the Moon's centre"
    )
    spin: float = quantity(1.5250414e-4, "deg/s", ge=0, lt=1, help="rotation rate of the Moon")
    latitude: float = quantity(
        0.0, "deg", ge=-90, le=90, help="latitude of the site frame's origin; positive: north"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "moon")

    def gravity(self, magnitude: float) -> CentralGravity:
        """Return the central gravity of a given magnitude (m/s^2) at the frame's origin."""
        return CentralGravity(magnitude, self.radius, self.axis)

    @property
    def axis(self) -> Array:
        """Angular velocity of the frame (3,), ENU, rad/s."""
        return self.spin * np.array([0.0, np.cos(self.latitude), np.sin(self.latitude)])


@dataclass(frozen=True)
class CentralGravity:
    """Inverse-square gravity in a frame that rotates with the Moon.

    Attributes
    ----------
    magnitude
        Gravitational acceleration at the frame's origin, without centrifugal acceleration, m/s^2.
    radius
        Distance of the origin from the Moon's centre, which lies straight below it, m.
    spin
        Angular velocity of the frame (3,), ENU, rad/s.

    Examples
    --------
    >>> gravity = CentralGravity(1.622, 1_737_400.0, np.zeros(3))
    >>> round(float(gravity.at([0.0, 0.0, 1_737_400.0])[2]), 4)
    -0.4055
    >>> round(float(gravity.height([1_000.0, 0.0, 0.0])), 4)
    0.2878
    """

    magnitude: float
    radius: float
    spin: Array

    def position_from_centre(self, position: ArrayLike) -> Array:
        """Return positions (..., 3), ENU, m, relative to the Moon's centre."""
        centre = np.array([0.0, 0.0, -self.radius])
        return np.asarray(np.asarray(position, dtype=np.float64) - centre)

    def at(self, position: ArrayLike) -> Array:
        """Return the gravitational acceleration (..., 3), ENU, m/s^2, at positions."""
        r = self.position_from_centre(position)
        distance = np.linalg.norm(r, axis=-1, keepdims=True)
        return np.asarray(-self.magnitude * self.radius**2 * r / distance**3)

    def free_fall_acceleration(self, position: ArrayLike, velocity: ArrayLike) -> Array:
        """Return gravity plus Coriolis and centrifugal acceleration (..., 3), ENU, m/s^2.

        `position` and `velocity` (..., 3) are in the rotating frame, m and m/s.
        """
        about = np.cross(self.spin, self.position_from_centre(position))
        v = np.asarray(velocity, dtype=np.float64)
        turning = 2.0 * np.cross(self.spin, v) + np.cross(self.spin, about)
        return np.asarray(self.at(position) - turning)

    def height(self, position: ArrayLike) -> Array:
        """Return heights (...,), m, of positions (..., 3) above the sphere."""
        return np.asarray(
            np.linalg.norm(self.position_from_centre(position), axis=-1) - self.radius
        )

    def up(self, position: ArrayLike) -> Array:
        """Return the local vertical at positions (..., 3) as unit vectors (..., 3), ENU."""
        r = self.position_from_centre(position)
        return np.asarray(r / np.linalg.norm(r, axis=-1, keepdims=True))

    def inertial_velocity(self, position: ArrayLike, velocity: ArrayLike) -> Array:
        """Convert velocities (..., 3), m/s, of the rotating frame to inertial velocities.

        `position` (..., 3) is in m, ENU. The result is in a non-rotating frame with the same axes.
        """
        about = np.cross(self.spin, self.position_from_centre(position))
        return np.asarray(np.asarray(velocity, dtype=np.float64) + about)
