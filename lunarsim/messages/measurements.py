"""What sensors tell the onboard computer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim._frame_kernels import points_along
from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.models.camera import CameraModel

Array = NDArray[np.float64]

# Tangent of the slope that is taken for moderate.
_MODERATE = 0.1


@dataclass(frozen=True)
class AltimeterReading:
    """One reading.

    Attributes
    ----------
    time
        s.
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
    """Speeds and ranges along the beams of a velocimeter.

    Attributes
    ----------
    time
        s.
    speed
        Of the lander along each beam (n,), m/s, positive towards the ground; NaN without a return.
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
    """Attitude as a star tracker sees it.

    Attributes
    ----------
    time
        s.
    attitude
        Quaternion, body to ENU (4,); NaN while it sees no stars.
    covariance
        Of its noise, small rotation in body axes (3, 3), rad^2.
    """

    time: float
    attitude: Array
    covariance: Array


@dataclass(frozen=True)
class LidarScan:
    """One flash of a LiDAR.

    Attributes
    ----------
    time
        Of the flash, s.
    range
        Measured range of each pixel (rows * cols,), m; NaN for no return.
    direction
        Unit vectors of the pixels, sensor frame (rows * cols, 3).
    mount
        Rotation (3, 3), sensor to body, read from the gimbal.
    sigma
        Standard deviation of each range (rows * cols,), m.
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
        """Refuse arrays that do not belong together, or whose numbers are not real.

        Raises
        ------
        InputError
            If shapes do not belong together, or an array is masked or of other than real numbers.
        """
        shape = self.shape
        if not (np.shape(shape) == (2,) and all(isinstance(k, int | np.integer) for k in shape)
                and min(shape) >= 0):  # fmt: skip
            raise InputError("scan.shape", shape, "two whole numbers: rows and columns")
        n = int(np.prod(shape))
        wanted = {"range": (n,), "sigma": (n,), "direction": (n, 3), "mount": (3, 3)}
        for name, size in wanted.items():
            value = getattr(self, name)
            if np.shape(value) != size:
                told = f"of shape {size} for {shape[0]} x {shape[1]} pixels"
                raise InputError(f"scan.{name}", np.shape(value), told)
            kind = type(value).__name__
            if isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray):
                kind = str(value.dtype)
                if value.dtype.kind in "fiu":
                    continue
            raise InputError(f"scan.{name}", kind, "an array of real numbers; NaN for no return")

    def check(self, position: Array, attitude: Array) -> None:
        """Refuse what no scanner gives, and a pose that is none.

        Parameters
        ----------
        position, attitude
            At which the scan is taken to have been made, (3,) and (4,).

        Raises
        ------
        InputError
            If shapes do not belong together, numbers are not real, ranges or deviations of returns
            are not positive and finite, the mount is no rotation, or the pose not finite.
        """
        self.check_arrays()
        returned = ~np.isnan(self.range)
        for name in ("range", "sigma"):
            values = getattr(self, name)[returned]
            wrong = ~((values > 0.0) & np.isfinite(values))
            if wrong.any():
                told = "positive and finite where there is a return, NaN for no return"
                raise InputError(f"scan.{name}", float(values[wrong][0]), told)
        if not np.allclose(self.mount @ self.mount.T, np.eye(3), atol=1e-6):
            raise InputError("scan.mount", np.asarray(self.mount).tolist(), "a rotation (3, 3)")
        if not (np.shape(position) == (3,) and np.isfinite(position).all()):
            raise InputError("estimate.position", np.asarray(position).tolist(), "finite (3,)")
        if not (np.shape(attitude) == (4,) and abs(np.linalg.norm(attitude) - 1.0) < 1e-3):
            told = "a quaternion (4,) of norm 1"
            raise InputError("estimate.attitude", np.asarray(attitude).tolist(), told)

    def points(self, position: Array, attitude: Array) -> Array:
        """Return the returns (rows * cols, 3) in ENU; NaN for no return.

        Parameters
        ----------
        position, attitude
            Pose of the lander, (3,) and (4,).

        Raises
        ------
        InputError
            If there are not as many ranges as rays.
        """
        count = np.shape(self.direction)[:1]
        if np.shape(self.range) != count:
            raise InputError("scan.range", np.shape(self.range), f"one a ray {count}")
        parts = (position, quat_to_matrix(attitude) @ self.mount, self.direction, self.range)
        return np.asarray(points_along(*(np.ascontiguousarray(of, np.float64) for of in parts)))

    def height_sigma(self, attitude: Array) -> Array:
        """Return the standard deviation of the returns' heights (rows * cols,), m.

        An error of range moves a return along its ray, and so off ground of moderate slope.

        Parameters
        ----------
        attitude
            Of the lander (4,).
        """
        rotation = quat_to_matrix(attitude) @ self.mount
        down = np.einsum("j,...j->...", rotation[2], self.direction)
        across = np.sqrt(np.maximum(1.0 - down**2, 0.0))
        return np.asarray(self.sigma * np.hypot(down, _MODERATE * across))

    def spacing(self, attitude: Array) -> Array:
        """Return how far apart neighbouring returns lie on level ground (rows * cols,), m.

        Along the line of sight, where they lie farthest apart; NaN for no return.

        Parameters
        ----------
        attitude
            Of the lander (4,).
        """
        rotation = quat_to_matrix(attitude) @ self.mount
        down = np.abs(np.einsum("j,...j->...", rotation[2], self.direction))
        rays = self.direction.reshape(*self.shape, 3)
        pitch = np.zeros(self.shape)
        for axis in (0, 1):
            if self.shape[axis] < 2:
                continue
            step = np.linalg.norm(np.diff(rays, axis=axis), axis=2)
            # The last pixel has the pitch of the one before it.
            last = np.take(step, [-1], axis=axis)
            pitch = np.maximum(pitch, np.concatenate((step, last), axis=axis))
        return np.asarray(self.range * pitch.ravel() / np.maximum(down, 1e-3))


@dataclass(frozen=True)
class Picture:
    """A picture with the camera that took it.

    Attributes
    ----------
    time
        Middle of the exposure, s.
    counts
        What the detector's converter gives (height, width): uint8 up to 8 bits, else uint16.
    camera
        Its geometry, with the mount as the gimbal's encoders tell.
    """

    time: float
    counts: NDArray[np.unsignedinteger[Any]]
    camera: CameraModel


@dataclass(frozen=True)
class InertialSamples:
    """Consecutive increments of an inertial unit over one control cycle.

    Attributes
    ----------
    time
        End of the last sample, s.
    angle, velocity
        Increments (n, 3), body axes, rad and m/s; NaN for a sample that was lost.
    """

    time: float
    angle: Array
    velocity: Array


@dataclass(frozen=True)
class NavigationFix:
    """The state as a navigation system known by its error budget gives it.

    Attributes
    ----------
    time
        s.
    position, velocity
        ENU (3,), m and m/s.
    attitude
        Quaternion, body to ENU (4,).
    covariance
        Of position, velocity and small rotation in ENU (9, 9), m, m/s, rad.
    """

    time: float
    position: Array
    velocity: Array
    attitude: Array
    covariance: Array


@dataclass(frozen=True)
class Measurements:
    """What the plant gave over one control cycle.

    Attributes
    ----------
    time
        Now, s.
    items
        Name of the sensor and what it measured, in the order in which it was.
    """

    time: float
    items: tuple[tuple[str, Any], ...] = ()
