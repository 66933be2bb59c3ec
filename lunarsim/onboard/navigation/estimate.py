"""Interface of navigation filters, and the estimate that they return."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from lunarsim._frame_kernels import rotate_quaternion
from lunarsim.frames import SiteToLocal, quat_from_rotation_vector, quat_multiply
from lunarsim.messages.briefing import Briefing
from lunarsim.typing import Array


@dataclass(frozen=True)
class Estimate:
    """State of the lander as estimated on board, with its covariance.

    Attributes
    ----------
    time
        Time of the estimate, s.
    position, velocity
        Local frame (3,), m and m/s.
    attitude
        Quaternion, body to ENU (4,).
    rate
        Body rate (3,), rad/s.
    mass
        Mass, kg.
    covariance
        Covariance (9, 9) of position (site frame, m), velocity (m/s) and small rotation in ENU
        (rad).
    lost
        Whether the measurements contradict the estimate: the other fields are then unreliable.
    """

    time: float
    position: Array
    velocity: Array
    attitude: Array
    rate: Array
    mass: float
    covariance: Array
    lost: bool = False

    def extrapolate(self, seconds: float) -> Estimate:
        """Return the estimate `seconds` later, for constant velocity and body rate.

        The covariance stays unchanged.
        """
        attitude = self.attitude.copy()
        rotate_quaternion(attitude, self.rate * seconds)
        return replace(
            self, time=self.time + seconds, position=self.position + seconds * self.velocity,
            attitude=attitude,
        )  # fmt: skip

    def in_site(self, site_to_local: SiteToLocal) -> Estimate:
        """Return the estimate with position, velocity and attitude in the site frame."""
        turn = SiteToLocal(turn=site_to_local.turn)
        return replace(
            self,
            position=site_to_local.to_site(self.position),
            velocity=turn.to_site(self.velocity),
            attitude=quat_multiply(
                quat_from_rotation_vector(np.array([0.0, 0.0, -turn.turn])), self.attitude
            ),
        )

    @property
    def tilt_sigma(self) -> float:
        """Larger of the standard deviations of the tilt about east and north, rad."""
        return float(np.sqrt(max(np.diag(self.covariance)[6:8].max(), 0.0)))


@dataclass(frozen=True)
class MapRotation:
    """Rotation of the terrain map that results from corrections of the lander's tilt.

    A map built with a tilt error is itself tilted. When the filter corrects the tilt, everything
    mapped before rotates about one point, the anchor of the local frame.

    Attributes
    ----------
    rotation
        Product of all corrections so far (3, 3), ENU.
    pivot
        Centre of the rotation, local frame (3,), m.
    """

    rotation: Array
    pivot: Array

    def rotation_since(self, earlier: Array) -> tuple[Array, float]:
        """Return the rotation (3, 3) since an earlier one, and its angle, rad.

        `earlier` (3, 3) is the earlier value of `rotation`.
        """
        turn = self.rotation @ earlier.T
        return turn, float(np.linalg.norm(turn - turn.T) / np.sqrt(8.0))


@dataclass(frozen=True)
class NavigationEvent:
    """Event reported by navigation, for instance that the estimate is lost.

    Attributes
    ----------
    time
        Time of the event, s.
    name
        For instance "lock", "lock-lost" or "relock".
    details
        Values for the flight record.
    """

    time: float
    name: str
    details: dict[str, Any]


class Navigation(ABC):
    """Interface of navigation filters: measurements in, `Estimate` out.

    Attributes
    ----------
    events
        Events reported so far.
    has_local_azimuth
        Whether the azimuth of the local frame is the lander's initial estimate and not that of the
        site frame.
    has_position_steps
        Whether measurements change the estimated position in steps.
    """

    events: list[NavigationEvent]
    has_local_azimuth: ClassVar[bool] = False
    has_position_steps: ClassVar[bool] = True

    @property
    @abstractmethod
    def site_to_local(self) -> SiteToLocal:
        """Estimated transformation from the site frame to the local frame."""

    @abstractmethod
    def take(self, sensor: str, measurement: Any, time: float) -> None:
        """Update the filter with one measurement of a named sensor.

        A measurement that the filter cannot use is ignored. `time` is the current time, s.
        """

    @abstractmethod
    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the estimate at `time` (s).

        `mass` (kg) is the mass that the onboard computer assumes; filters that do not estimate the
        mass return it.
        """

    def estimate_in_site(self, time: float, mass: float) -> Estimate:
        """Return `estimate` in the site frame; the arguments are the same."""
        return self.estimate(time, mass).in_site(self.site_to_local)

    @property
    def is_drifting(self) -> bool:
        """Whether neither a map nor tracked rocks bound the position error.

        Velocity errors then accumulate until touchdown. True unless a filter overrides it.
        """
        return True

    def correct_measurement(
        self, sensor: str, measurement: Any, now: Estimate
    ) -> tuple[Any, Estimate]:
        """Return a measurement and its pose, corrected for the estimated sensor errors.

        Mappers use the result. A navigation without estimates of sensor errors returns its
        arguments.

        Parameters
        ----------
        sensor, measurement
            Name of the sensor, and its measurement.
        now
            Estimate after the measurement was processed.
        """
        return measurement, now

    @property
    def map_rotation(self) -> MapRotation | None:
        """Rotation of the mapped terrain by tilt corrections; None if not estimated."""
        return None


@runtime_checkable
class ThrustAware(Protocol):
    """Interface of a navigation filter that uses the commanded thrust."""

    def record_thrust(self, thrust: float, seconds: float) -> None:
        """Record the thrust (N) commanded over the last `seconds`.

        The method is called before the measurements of that time are processed.
        """
        ...


class NavigationPart(Protocol):
    """Settings of a navigation filter in the scenario: a frozen dataclass.

    Attributes
    ----------
    needs
        Measurement types that the navigation requires.
    accepts
        Measurement types that the navigation uses if available.
    needs_prior_map, uses_prior_map
        Whether the navigation requires a prior map, and whether it uses one if available.
    """

    needs: ClassVar[tuple[type, ...]]
    accepts: ClassVar[tuple[type, ...]]
    needs_prior_map: ClassVar[bool]
    uses_prior_map: ClassVar[bool]

    def build(self, briefing: Briefing) -> Navigation:
        """Return the navigation filter of one flight, built from its briefing."""
        ...
