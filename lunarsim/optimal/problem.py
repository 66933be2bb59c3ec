"""Minimum-propellant landing problem: initial state, final state and constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.optimal.validation import LARGEST, check_numbers, is_number
from lunarsim.typing import Array


@dataclass(frozen=True)
class Cone:
    """Cone of half-spaces above a path's end: ``normals @ (r - end) >= -apex_depth``.

    The first and the last interval are exempt: the start may be below a majorant of terrain.

    Attributes
    ----------
    normals
        Upward normals of the half-spaces (n, 3), dimensionless.
    apex_depth
        Depth of the apex below the end, m; 0 or more.

    Raises
    ------
    InputError
        If there is no half-space, a value is not finite, or the apex is above the end.
    """

    normals: Array
    apex_depth: float = 0.0

    def __post_init__(self) -> None:
        expected = "must be an array of one or more normals, shape (n, 3)"
        rows = len(self.normals) if np.ndim(self.normals) == 2 else 0
        object.__setattr__(
            self, "normals", check_numbers("cone", self.normals, (rows, 3), expected)
        )
        if rows == 0:
            raise InputError("optimal.cone", self.normals, expected)
        if not (is_number(self.apex_depth) and self.apex_depth >= 0.0):
            raise InputError(
                "optimal.cone.apex_depth", self.apex_depth, "must be a finite number of 0 or more"
            )


@dataclass(frozen=True)
class Descent:
    """Landing problem: minimum-propellant descent of a point mass in uniform gravity.

    Attributes
    ----------
    position, velocity
        Initial state (3,), ENU, m and m/s.
    mass
        Initial mass, kg.
    end_position, end_velocity
        Final state (3,), ENU, m and m/s.
    gravity
        Downward acceleration, m/s^2.
    thrust_min, thrust_max
        Thrust range, N; the engine cannot be shut down before touchdown.
    exhaust_velocity
        Thrust over mass flow, m/s; below the specific impulse times g0 if nozzles are canted.
    dry_mass
        Minimum final mass, reserve included, kg.
    max_tilt
        Maximum tilt of the thrust from the vertical, rad; None: no limit.
    max_final_tilt, tilt_rate
        Maximum tilt at the end, rad, and its growth backward in time, rad/s, because a lander
        needs time to turn upright. None: `max_tilt` to the end.
    glideslope
        Minimum angle of the path above the horizontal, seen from its end, rad; None: no limit.
    apex_depth
        Depth of the apex of the glideslope cone below the end, m.
    cone
        Additional half-spaces over the end (a majorant of the terrain); None: none.
    region
        Radius of the horizontal disc around `end_position` in which the path may end, m; 0: point.
    thrust_slack
        Thrust above `thrust_max` that is available at a penalty, newtons.
    thrust_slack_penalty
        Penalty for using all of `thrust_slack`, expressed as delta-v (m/s); it applies to the peak
        excess, independent of its duration.

    Raises
    ------
    InputError
        If a value is not finite or not admissible.
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
    apex_depth: float = 0.0
    cone: Cone | None = None
    region: float = 0.0
    max_final_tilt: float | None = None
    tilt_rate: float = np.deg2rad(10.0)
    thrust_slack: float = 0.0
    thrust_slack_penalty: float = 5.0

    def __post_init__(self) -> None:
        for name in ("position", "velocity", "end_position", "end_velocity"):
            value = check_numbers(name, getattr(self, name), (3,), "must be three finite numbers")
            for i, component in enumerate(value):
                if abs(component) > LARGEST:
                    raise InputError(
                        f"optimal.{name}[{i}]", float(component),
                        f"must be between {-LARGEST:g} and {LARGEST:g}",
                    )  # fmt: skip
            object.__setattr__(self, name, value)
        for name in ("mass", "gravity", "thrust_max", "exhaust_velocity", "dry_mass"):
            value = getattr(self, name)
            if not (is_number(value) and 0.0 < value <= LARGEST):
                raise InputError(
                    f"optimal.{name}", value, f"must be a positive number of at most {LARGEST:g}"
                )
        for name in (
            "thrust_min",
            "apex_depth",
            "region",
            "thrust_slack",
            "thrust_slack_penalty",
            "tilt_rate",
        ):
            value = getattr(self, name)
            if not (is_number(value) and 0.0 <= value <= LARGEST):
                raise InputError(f"optimal.{name}", value, f"must be between 0 and {LARGEST:g}")
        if not self.thrust_min < self.thrust_max:
            raise InputError(
                "optimal.thrust_min",
                self.thrust_min,
                f"must be less than thrust_max, which is {self.thrust_max} N",
            )
        if not self.dry_mass < self.mass:
            raise InputError(
                "optimal.mass",
                self.mass,
                f"must be more than dry_mass, which is {self.dry_mass} kg",
            )
        if self.region > 0.0 and self.thrust_slack > 0.0:
            raise InputError(
                "optimal.thrust_slack", self.thrust_slack, "must be 0 if `region` is more than 0"
            )
        if not (self.cone is None or isinstance(self.cone, Cone)):
            raise InputError("optimal.cone", type(self.cone), "must be a Cone or None")
        for name in ("max_tilt", "glideslope", "max_final_tilt"):
            angle = getattr(self, name)
            if angle is not None and not (is_number(angle) and 0.0 <= angle < 0.5 * np.pi):
                raise InputError(
                    f"optimal.{name}",
                    angle,
                    "must be a number of 0 or more and less than pi/2 rad (90 degrees)",
                )

    @property
    def displacement(self) -> Array:
        """Displacement from the end to the start (3,), m."""
        return np.asarray(self.position - self.end_position)

    @property
    def violates_glideslope(self) -> bool:
        """Whether the start lies below the glideslope cone of every admissible end."""
        if self.glideslope is None:
            return False
        gap, slack = self.displacement, 1e-9 * (1.0 + float(np.linalg.norm(self.displacement)))
        horizontal = max(float(np.hypot(gap[0], gap[1])) - self.region, 0.0)
        return bool(gap[2] + self.apex_depth < np.tan(self.glideslope) * horizontal - slack)

    def tilts(self, times_to_go: Array) -> Array | None:
        """Return the maximum tilts of the thrust (n,), rad, for times-to-go.

        `times_to_go` (n,) are in s. The result is None without a limit.
        """
        if self.max_tilt is None and self.max_final_tilt is None:
            return None
        # Tilts above 90 deg are not convex and not needed for a landing.
        most = np.full(len(times_to_go), 0.5 * np.pi if self.max_tilt is None else self.max_tilt)
        if self.max_final_tilt is None:
            return most
        return np.asarray(np.minimum(most, self.max_final_tilt + self.tilt_rate * times_to_go))

    @property
    def delta_v_available(self) -> float:
        """Delta-v until the mass reaches `dry_mass`, m/s."""
        return float(self.exhaust_velocity * np.log(self.mass / self.dry_mass))

    def propellant_used(self, delta_v: float) -> float:
        """Return the propellant (kg) consumed by a delta-v (m/s)."""
        return float(self.mass * -np.expm1(-delta_v / self.exhaust_velocity))
