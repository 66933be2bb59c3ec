"""Sensor calibrations known to the onboard computer; they exclude the true errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lunarsim.models.inertial_unit import TriadErrors


@dataclass(frozen=True)
class PointedInstrument:
    """Sensor on a gimbal.

    Attributes
    ----------
    gimbal_limit
        Maximum angle of the boresight from body -z, rad.
    """

    gimbal_limit: float


@dataclass(frozen=True)
class CameraInstrument(PointedInstrument):
    """Camera on a gimbal; each image carries its complete geometry.

    Attributes
    ----------
    blur_sigma
        Point spread function, 1 sigma, pixels.
    pixel
        Angle of a pixel at the image centre, rad.
    half_field
        Tangent of half the field of view along the narrower side.
    """

    blur_sigma: float = 0.6
    pixel: float = 1.0 / 554.3
    half_field: float = 0.433


@dataclass(frozen=True)
class LidarInstrument(PointedInstrument):
    """LiDAR on a gimbal, with its constant errors over a flight, 1 sigma each.

    Attributes
    ----------
    range_bias
        Bias of all ranges, m.
    boresight
        Misalignment between sensor and gimbal encoders, per axis, rad.
    latency
        Error of the time stamp of a flash, s.
    pixel
        Angle of a pixel at the image centre, rad.
    half_field
        Tangent of half the field of view along the narrower side.
    max_range
        Maximum range with a return, m.
    max_incidence
        Maximum angle between ray and surface normal with a return, rad.
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
    """Inertial measurement unit.

    Attributes
    ----------
    gyroscopes, accelerometers
        Standard deviations of the errors.
    """

    gyroscopes: TriadErrors
    accelerometers: TriadErrors


@dataclass(frozen=True)
class AltimeterInstrument:
    """Ranging beam fixed to the body.

    Attributes
    ----------
    boresight
        Unit vector (3,), body axes.
    """

    boresight: tuple[float, float, float]


@dataclass(frozen=True)
class VelocimeterInstrument:
    """Doppler beams fixed to the body.

    Attributes
    ----------
    directions
        Unit vectors (n, 3), body axes.
    speed_bias
        Standard deviation of each beam's speed bias at the start, m/s.
    speed_wander
        Standard deviation of the change of that bias after one second, m/s.
    """

    directions: tuple[tuple[float, float, float], ...]
    speed_bias: float = 0.0
    speed_wander: float = 0.0


@dataclass(frozen=True)
class StarTrackerInstrument:
    """Star tracker.

    Attributes
    ----------
    misalignment
        Standard deviation of its constant misalignment, per axis, rad.
    """

    misalignment: float
