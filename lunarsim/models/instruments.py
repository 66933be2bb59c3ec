"""What an onboard computer knows of the sensors on its lander: calibrations, not truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lunarsim.models.inertial_unit import TriadErrors


@dataclass(frozen=True)
class PointedInstrument:
    """A sensor on a gimbal.

    Attributes
    ----------
    gimbal_limit
        Greatest angle of the boresight from straight down through the lander, rad.
    """

    gimbal_limit: float


@dataclass(frozen=True)
class CameraInstrument(PointedInstrument):
    """A camera on a gimbal; pictures bring the whole of their geometry.

    Attributes
    ----------
    blur_sigma
        Point spread, 1 sigma, pixels.
    pixel
        Angle of a pixel in the middle, rad.
    half_field
        Tangent of half the narrower side of the field of view.
    """

    blur_sigma: float = 0.6
    pixel: float = 1.0 / 554.3
    half_field: float = 0.433


@dataclass(frozen=True)
class LidarInstrument(PointedInstrument):
    """A LiDAR on a gimbal, with what it may err by over a whole flight, 1 sigma each.

    Attributes
    ----------
    range_bias
        Of all ranges, m.
    boresight
        Between the sensor and what the gimbal's encoders tell, an axis, rad.
    latency
        Between the flash and the time that it is given, s.
    pixel
        Angle of a pixel in the middle, rad.
    half_field
        Tangent of half the narrower side of the field of view.
    max_range
        Longest range that gives a return, m.
    max_incidence
        Greatest angle between ray and surface normal that gives one, rad.
    """

    range_bias: float = 0.0
    boresight: float = 0.0
    latency: float = 0.0
    pixel: float = 0.1 / 128.0
    half_field: float = 0.1
    max_range: float = 2000.0
    max_incidence: float = 0.5 * math.pi


@dataclass(frozen=True)
class InertialInstrument:
    """An inertial unit.

    Attributes
    ----------
    gyroscopes, accelerometers
        Standard deviations of its errors.
    """

    gyroscopes: TriadErrors
    accelerometers: TriadErrors


@dataclass(frozen=True)
class FixedBeam:
    """A ranging beam fixed to the body.

    Attributes
    ----------
    boresight
        Unit vector (3,), body axes.
    """

    boresight: tuple[float, float, float]


@dataclass(frozen=True)
class FixedBeams:
    """Doppler beams fixed to the body.

    Attributes
    ----------
    directions
        Unit vectors (n, 3), body axes.
    speed_bias
        Standard deviation of what the speeds of each beam are off by at the start, m/s.
    speed_wander
        And by how much that has wandered a second later, m/s.
    """

    directions: tuple[tuple[float, float, float], ...]
    speed_bias: float = 0.0
    speed_wander: float = 0.0


@dataclass(frozen=True)
class StarInstrument:
    """A star tracker.

    Attributes
    ----------
    misalignment
        Standard deviation of how it is mounted, constant over a flight, an axis, rad.
    """

    misalignment: float
