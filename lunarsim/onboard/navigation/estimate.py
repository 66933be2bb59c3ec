"""The contract of navigation: an estimate with its covariance."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lunarsim._frame_kernels import turned
from lunarsim.frames import Shift
from lunarsim.messages.briefing import Briefing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """What the onboard computer knows of the lander.

    Attributes
    ----------
    time
        s.
    position, velocity
        Local frame (3,), m and m/s.
    attitude
        Quaternion, body to ENU (4,).
    rate
        Body rate (3,), rad/s.
    mass
        kg.
    covariance
        Of position (in the site frame), velocity and small rotation in ENU (9, 9), m, m/s, rad.
    lost
        Whether what is measured can no longer be explained: the rest is not to be trusted.
    """

    time: float
    position: Array
    velocity: Array
    attitude: Array
    rate: Array
    mass: float
    covariance: Array
    lost: bool = False

    def ahead(self, seconds: float) -> Estimate:
        """Return it carried on with present velocity and rate."""
        attitude = self.attitude.copy()
        turned(attitude, self.rate * seconds)
        return replace(
            self, time=self.time + seconds, position=self.position + seconds * self.velocity,
            attitude=attitude,
        )  # fmt: skip

    @property
    def tilt_sigma(self) -> float:
        """Greatest standard deviation of the tilt about a level axis, rad."""
        return float(np.sqrt(max(np.diag(self.covariance)[6:8].max(), 0.0)))


@dataclass(frozen=True)
class GroundTurn:
    """By what the ground as it was seen has turned, since the lander's tilt was corrected.

    What was seen with a tilt that is known to be wrong now lies where it does by that tilt; scans
    that lie one on the other all turn alike, about the point on which the local frame hangs.

    Attributes
    ----------
    rotation
        Sum of all corrections so far (3, 3), ENU.
    pivot
        Of the turn, local frame (3,), m.
    """

    rotation: Array
    pivot: Array

    def since(self, before: Array) -> tuple[Array, float]:
        """Return the turn (3, 3) since the rotation was another (3, 3), and its angle, rad."""
        turn = self.rotation @ before.T
        return turn, float(np.linalg.norm(turn - turn.T) / np.sqrt(8.0))


@dataclass(frozen=True)
class NavigationEvent:
    """Something that navigation reports.

    Attributes
    ----------
    time
        s.
    name
        For instance "lock", "lock-lost" or "relock".
    details
        Figures for the record.
    """

    time: float
    name: str
    details: dict[str, Any]


class Navigation(ABC):
    """Anything that turns measurements into an `Estimate`.

    Attributes
    ----------
    events
        What it has reported so far.
    own_azimuth
        Whether the local frame points where the lander says that it began to, not as the site
        frame does.
    steps
        Whether measurements move its position in steps.
    """

    events: list[NavigationEvent]
    own_azimuth: ClassVar[bool] = False
    steps: ClassVar[bool] = True

    @property
    @abstractmethod
    def site_to_local(self) -> Shift:
        """Where the site frame is taken to lie in the local one."""

    @abstractmethod
    def take(self, sensor: str, measurement: Any, time: float) -> None:
        """Take in one measurement of a named sensor; what it cannot use changes nothing."""

    @abstractmethod
    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the estimate at `time` with the mass (kg) that the computer keeps."""

    @property
    def adrift(self) -> bool:
        """Whether nothing holds the lander to the ground that it has mapped.

        What its velocity errs by then adds up until touchdown.
        """
        return True

    def corrected(self, sensor: str, measurement: Any, now: Estimate) -> tuple[Any, Estimate]:
        """Return a measurement and where it was taken, less what its sensor is known to err by.

        As mappers are to take it. Without an estimate of such errors it is as it came.

        Parameters
        ----------
        sensor, measurement
            What was measured.
        now
            The estimate after it was taken in.
        """
        return measurement, now

    @property
    def ground_turn(self) -> GroundTurn | None:
        """By what mapped ground has turned; None where nothing is known of it."""
        return None


@runtime_checkable
class ThrustAware(Protocol):
    """A navigation that makes something of the thrust that the engine was asked for."""

    def commanded(self, thrust: float, seconds: float) -> None:
        """Note the thrust (N) over the last so many seconds, before what was measured in them."""
        ...


class NavigationPart(Protocol):
    """What the registry knows of a navigation: a frozen dataclass of its settings.

    Attributes
    ----------
    needs
        Types of measurements without which it cannot work.
    takes
        Types that it uses if there are any, besides.
    needs_prior_map, uses_prior_map
        Whether it cannot work without a prior map, and whether it makes something of one.
    """

    needs: ClassVar[tuple[type, ...]]
    takes: ClassVar[tuple[type, ...]]
    needs_prior_map: ClassVar[bool]
    uses_prior_map: ClassVar[bool]

    def build(self, briefing: Briefing) -> Navigation:
        """Return the navigation of one flight."""
        ...
