"""Measurements that the sensors send to the onboard computer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim._frame_kernels import ray_points
from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.models.camera import CameraModel
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite, check_shape

# Tangent of the terrain slope assumed for height errors.
_ASSUMED_SLOPE = 0.1
# Side of the squares of pixels in which returns are counted for their local density.
_DENSITY_PIXELS = 8


@dataclass(frozen=True)
class AltimeterReading:
    """Slant range measured by an altimeter, with its standard deviation.

    Attributes
    ----------
    time
        Time of the measurement, s.
    range
        Slant range, m; NaN without a return.
    sigma
        Standard deviation, m; NaN without a return.
    """

    time: float
    range: float
    sigma: float


@dataclass(frozen=True)
class DopplerReading:
    """Speeds and ranges along the beams of a Doppler velocimeter.

    Attributes
    ----------
    time
        Time of the measurement, s.
    speed
        Lander speed along each beam (n,), m/s, positive towards the terrain; NaN without a return.
    range
        Slant ranges (n,), m; NaN without a return.
    speed_sigma, range_sigma
        Standard deviations (n,), m/s and m.
    """

    time: float
    speed: Array
    range: Array
    speed_sigma: Array
    range_sigma: Array


@dataclass(frozen=True)
class AttitudeReading:
    """Attitude measured by a star tracker.

    Attributes
    ----------
    time
        Time of the measurement, s.
    attitude
        Quaternion, body to ENU (4,); NaN if no stars are visible.
    covariance
        Covariance of the noise as a small rotation in body axes (3, 3), rad^2.
    """

    time: float
    attitude: Array
    covariance: Array


@dataclass(frozen=True)
class LidarScan:
    """Ranges of all pixels measured in one flash of a LiDAR.

    Attributes
    ----------
    time
        Time of the flash, s.
    range
        Measured range of each pixel (rows * cols,), m; NaN without a return.
    direction
        Unit vectors of the pixels, sensor frame (rows * cols, 3).
    mount
        Rotation (3, 3), sensor to body, as measured by the gimbal.
    sigma
        Standard deviation of each range as stated by the sensor (rows * cols,), m. It includes
        noise and rounding, but no false returns.
    shape
        Rows and columns of the detector.
    """

    time: float
    range: Array
    direction: Array
    mount: Array
    sigma: Array
    shape: tuple[int, int]

    def check_arrays(self) -> None:
        """Raise InputError unless all arrays have consistent shapes and real numbers.

        Raises
        ------
        InputError
            If shapes are inconsistent, or an array is masked or not of real numbers.
        """
        shape = self.shape
        if not (np.shape(shape) == (2,) and all(isinstance(k, int | np.integer) for k in shape)
                and min(shape) >= 0):  # fmt: skip
            raise InputError(
                "scan.shape", shape, "must be two integers of 0 or more: rows and columns"
            )
        n = int(np.prod(shape))
        wanted = {"range": (n,), "sigma": (n,), "direction": (n, 3), "mount": (3, 3)}
        for name, size in wanted.items():
            value = getattr(self, name)
            if np.shape(value) != size:
                problem = f"must have shape {size} for {shape[0]} x {shape[1]} pixels"
                raise InputError(f"scan.{name}", np.shape(value), problem)
            kind = type(value).__name__
            if isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray):
                kind = value.dtype.name
                if value.dtype.kind in "fiu":
                    continue
            problem = f"must be an array of real numbers, not of type {kind}"
            raise InputError(f"scan.{name}", kind, problem, "Use NaN for no return.", False)

    def check(self, position: Array, attitude: Array) -> None:
        """Raise InputError if the scan or the lander's pose at the flash is invalid.

        Parameters
        ----------
        position, attitude
            Pose of the lander at the flash, ENU (3,), m, and quaternion, body to ENU (4,).

        Raises
        ------
        InputError
            If shapes are inconsistent, values are not real, ranges or deviations of returns are not
            positive and finite, the mount is not a rotation, or the pose is not finite.
        """
        self.check_arrays()
        returned = ~np.isnan(self.range)
        for name in ("range", "sigma"):
            values = getattr(self, name)
            wrong = returned & ~((values > 0.0) & np.isfinite(values))
            if wrong.any():
                i = int(wrong.argmax())
                problem = "must be positive and finite"
                remedy = f"If the ray has no return, set scan.range[{i}] to NaN."
                raise InputError(f"scan.{name}[{i}]", float(values[i]), problem, remedy)
        is_orthogonal = np.allclose(self.mount @ self.mount.T, np.eye(3), atol=1e-6)
        if not (is_orthogonal and np.linalg.det(self.mount) > 0.0):
            problem = "must be a rotation matrix, with mount @ mount.T = identity, determinant 1"
            raise InputError("scan.mount", self.mount, problem, show_value=False)
        check_shape("estimate.position", position, (3,))
        check_finite("estimate.position", position)
        check_shape("estimate.attitude", attitude, (4,))
        norm = float(np.linalg.norm(attitude))
        if not abs(norm - 1.0) < 1e-3:
            problem = f"must be a unit quaternion, but its norm is {norm:g}"
            raise InputError("estimate.attitude", attitude, problem, show_value=False)

    def points(self, position: Array, attitude: Array) -> Array:
        """Return the measured points (rows * cols, 3) in ENU, m; NaN without a return.

        Parameters
        ----------
        position, attitude
            Pose of the lander, ENU (3,), m, and quaternion, body to ENU (4,).

        Raises
        ------
        InputError
            If the number of ranges differs from the number of rays.
        """
        count = np.shape(self.direction)[:1]
        if np.shape(self.range) != count:
            raise InputError(
                "scan.range", np.shape(self.range), f"must have shape {count}, one range per ray"
            )
        parts = (position, quat_to_matrix(attitude) @ self.mount, self.direction, self.range)
        return np.asarray(ray_points(*(np.ascontiguousarray(of, np.float64) for of in parts)))

    def height_sigma(self, attitude: Array) -> Array:
        """Return the standard deviation (rows * cols,), m, of the measured heights.

        A range error shifts a point along its ray; on sloping terrain, a horizontal shift also
        causes a height error. A slope of 0.1 is assumed.

        Parameters
        ----------
        attitude
            Quaternion of the lander, body to ENU (4,).
        """
        rotation = quat_to_matrix(attitude) @ self.mount
        down = np.einsum("j,...j->...", rotation[2], self.direction)
        across = np.sqrt(np.maximum(1.0 - down**2, 0.0))
        return np.asarray(self.sigma * np.hypot(down, _ASSUMED_SLOPE * across))

    def spacing(self, attitude: Array) -> Array:
        """Return the spacing (rows * cols,), m, of adjacent points on flat terrain.

        The spacing along the line of sight is returned, which is the largest; NaN without a return.
        If only a fraction f of the pixels around a pixel has a return, the spacing is that of all
        pixels over the square root of f (`local_return_fraction`).

        Parameters
        ----------
        attitude
            Quaternion of the lander, body to ENU (4,).
        """
        rotation = quat_to_matrix(attitude) @ self.mount
        down = np.abs(np.einsum("j,...j->...", rotation[2], self.direction))
        rays = self.direction.reshape(*self.shape, 3)
        pitch = np.zeros(self.shape)
        for axis in (0, 1):
            if self.shape[axis] < 2:
                continue
            step = np.linalg.norm(np.diff(rays, axis=axis), axis=2)
            # The last pixel has no successor; it takes the pitch of its predecessor.
            last = np.take(step, [-1], axis=axis)
            pitch = np.maximum(pitch, np.concatenate((step, last), axis=axis))
        share = local_return_fraction(np.isfinite(self.range).reshape(self.shape)).ravel()
        return np.asarray(self.range * pitch.ravel() / np.maximum(down, 1e-3) / np.sqrt(share))


def local_return_fraction(has_return: NDArray[np.bool_]) -> Array:
    """Return the fraction of pixels with a return around each pixel (rows, cols).

    It is the maximum over four squares of 8 x 8 pixels, of which the pixel is a corner. Next to a
    gap, such as an occlusion, one of them contains no gap and the fraction is 1. If returns are
    lost at random, all squares have nearly the same fraction. Pixels without a return count as one
    return in their squares.

    Parameters
    ----------
    has_return
        Whether each pixel has a return (rows, cols).
    """
    rows, cols = has_return.shape
    n = min(_DENSITY_PIXELS, rows, cols)
    if n == 0 or has_return.all():
        return np.ones(has_return.shape)
    total = np.zeros((rows + 1, cols + 1))
    total[1:, 1:] = np.cumsum(np.cumsum(has_return, axis=0), axis=1)
    square = total[n:, n:] - total[:-n, n:] - total[n:, :-n] + total[:-n, :-n]
    # Squares that extend beyond the detector do not count.
    square = np.pad(square, n - 1)
    ends = (slice(None, rows), slice(n - 1, None)), (slice(None, cols), slice(n - 1, None))
    corners = [square[down, right] for down in ends[0] for right in ends[1]]
    return np.asarray(np.maximum(np.maximum.reduce(corners), 1.0) / n**2)


@dataclass(frozen=True)
class CameraImage:
    """Camera image with the geometry of the camera at its exposure.

    Attributes
    ----------
    time
        Middle of the exposure, s.
    counts
        Pixel values of the detector (height, width): uint8 up to 8 bits, else uint16.
    camera
        Camera geometry; its mount is measured by the gimbal's encoders.
    exposure
        Exposure time, s; NaN if the camera does not report it.
    """

    time: float
    counts: NDArray[np.unsignedinteger[Any]]
    camera: CameraModel
    exposure: float = float("nan")


@dataclass(frozen=True)
class InertialSamples:
    """Angle and velocity increments of an inertial unit over one control cycle.

    Attributes
    ----------
    time
        End of the last sample, s.
    angle, velocity
        Increments (n, 3), body axes, rad and m/s; NaN for a lost sample.
    """

    time: float
    angle: Array
    velocity: Array


@dataclass(frozen=True)
class NavigationFix:
    """Position, velocity and attitude measured by an external navigation system.

    Attributes
    ----------
    time
        Time of the measurement, s.
    position, velocity
        ENU (3,), m and m/s.
    attitude
        Quaternion, body to ENU (4,).
    covariance
        Covariance of the errors of position, velocity and small rotation in ENU (9, 9), m, m/s,
        rad.
    """

    time: float
    position: Array
    velocity: Array
    attitude: Array
    covariance: Array


@dataclass(frozen=True)
class Measurements:
    """Measurements of all sensors over one control cycle.

    Attributes
    ----------
    time
        Current time, s.
    items
        Pairs of sensor name and measurement, in order of measurement.
    """

    time: float
    items: tuple[tuple[str, Any], ...] = ()
