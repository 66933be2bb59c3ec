"""Sensor calibrations known to the onboard computer; they exclude the true errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lunarsim.models.inertial_unit import TriadErrors


@dataclass(frozen=True)
class PointedInstrument:
    """Calibration of a sensor on a gimbal.

    Attributes
    ----------
    gimbal_limit
        Maximum angle of the boresight from body -z, rad.
    """

    gimbal_limit: float


@dataclass(frozen=True)
class CameraInstrument(PointedInstrument):
    """Calibration of a camera on a gimbal; each image carries its complete geometry.

    Attributes
    ----------
    blur_sigma
        Standard deviation of the point spread function, pixels.
    pixel
        Angle of a pixel at the image centre, rad.
    tan_half_fov
        Tangent of half the field of view along the narrower side.
    """

    blur_sigma: float = 0.6
    pixel: float = 1.0 / 554.3
    tan_half_fov: float = 0.433


@dataclass(frozen=True)
class LidarInstrument(PointedInstrument):
    """Calibration of a LiDAR on a gimbal: sizes of constant errors, geometry.

    Attributes
    ----------
    range_bias_sigma
        Standard deviation of the bias of all ranges, m.
    boresight_sigma
        Standard deviation of the misalignment between sensor and gimbal encoders, per axis, rad.
    latency_sigma
        Standard deviation of the error of a flash's time stamp, s.
    pixel
        Angle of a pixel at the image centre, rad.
    tan_half_fov
        Tangent of half the field of view along the narrower side.
    max_range
        Maximum range with a return, m.
    max_incidence
        Maximum angle between ray and surface normal with a return, rad.
    divergence
        Half angle of the beam at 1/e^2 of its peak intensity, rad; 0: a line.
    """

    range_bias_sigma: float = 0.0
    boresight_sigma: float = 0.0
    latency_sigma: float = 0.0
    pixel: float = 0.1 / 128.0
    tan_half_fov: float = 0.1
    max_range: float = 2000.0
    max_incidence: float = 0.5 * math.pi
    divergence: float = 0.0

    @property
    def beam_ratio(self) -> float:
        """Standard deviation of the beam's intensity over the spacing of the pixels."""
        # The intensity exp(-2 r^2 / w^2) has the standard deviation w / 2 along each axis.
        return 0.5 * self.divergence / self.pixel


@dataclass(frozen=True)
class InertialInstrument:
    """Calibration of an inertial measurement unit: statistics of its errors.

    Attributes
    ----------
    gyroscopes, accelerometers
        Error models of the triads: standard deviations of constant errors, densities of white
        noise and of the bias random walk, and the quantization step.
    """

    gyroscopes: TriadErrors
    accelerometers: TriadErrors


@dataclass(frozen=True)
class AltimeterInstrument:
    """Calibration of an altimeter: direction of its beam.

    Attributes
    ----------
    boresight
        Unit vector (3,), body axes.
    """

    boresight: tuple[float, float, float]


@dataclass(frozen=True)
class VelocimeterInstrument:
    """Calibration of a Doppler velocimeter: directions and biases of its beams.

    Attributes
    ----------
    directions
        Unit vectors (n, 3), body axes.
    speed_bias_sigma
        Standard deviation of each beam's speed bias at the start, m/s.
    speed_bias_walk
        Standard deviation of the change of the speed bias in one second, m/s.
    """

    directions: tuple[tuple[float, float, float], ...]
    speed_bias_sigma: float = 0.0
    speed_bias_walk: float = 0.0


@dataclass(frozen=True)
class StarTrackerInstrument:
    """Calibration of a star tracker: statistics of its misalignment.

    Attributes
    ----------
    misalignment
        Standard deviation of the constant misalignment, per axis, rad.
    """

    misalignment: float


@dataclass(frozen=True)
class NavigationFixInstrument:
    """Empty calibration of external navigation; each fix has its covariance."""
