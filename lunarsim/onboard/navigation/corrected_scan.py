"""LiDAR scan with the pose and the scanner errors that its points depend on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.instruments import LidarInstrument
from lunarsim.onboard.navigation import _registration_kernels as kernels
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.typing import Array, IntArray


@dataclass(frozen=True)
class ScanSurface:
    """LiDAR scan averaged over the squares of a grid, at the square centres.

    Attributes
    ----------
    col, row
        Grid indices of the squares (n,); they can lie outside the grid.
    position
        Square centres at the height of the scan (n, 3), ENU, m.
    normal
        (-dz/dx, -dz/dy, 1) of the scan (n, 3). Slopes of the map are not used: the noise of the map
        would look like slope, and flat terrain would seem to give position information.
    """

    col: IntArray
    row: IntArray
    position: Array
    normal: Array

    def __len__(self) -> int:
        return len(self.col)


def average_scan(points: Array, grid: Grid, min_points: int = 4) -> ScanSurface:
    """Average scan points (n, 3), m, over the squares of a grid; NaN is missing.

    `min_points` is the minimum number of points in a square. The averages are extrapolated to the
    square centres along the slopes. Squares are omitted if they have no neighbours on all four
    sides, or if their mean point is farther than a quarter of the grid spacing from the centre.
    """
    col, row, mean, _ = kernels.average_points(
        np.ascontiguousarray(points), grid.x0, grid.y0, grid.posting, min_points
    )
    height, slope, good = kernels.centre_heights(
        col, row, mean, grid.x0, grid.y0, grid.posting, 0.25 * grid.posting
    )
    col, row, height, slope = col[good], row[good], height[good], slope[good]
    position = np.stack(
        (grid.x0 + grid.posting * col, grid.y0 + grid.posting * row, height), axis=-1
    )
    return ScanSurface(col, row, position, np.column_stack((-slope, np.ones(len(col)))))


# Indices of the scanner errors among the 11 errors of a scan: position (ENU, m), small rotation
# (body axes, rad), range (m), boresight (small rotation, sensor axes, rad), latency (s).
SCANNER_ERRORS = slice(6, 11)
# Minimum standard deviations of range, boresight and latency; m, rad, s. If a scanner is specified
# better than it is, its error is attributed to the pose, and no measurement contradicts this.
MIN_SCANNER_SIGMAS = np.array([0.1, *np.full(3, np.deg2rad(0.15)), 0.01])
# Standard deviations of the scanner errors after a drift of the innovations; m, rad, s.
DRIFTED_SCANNER_SIGMAS = np.array([0.5, *np.full(3, np.deg2rad(0.5)), 0.02])


def scanner_block(name: str) -> str:
    """Return the name of a LiDAR's block of errors in the error state."""
    return f"lidar {name}"


def scanner_covariance(instrument: LidarInstrument) -> Array:
    """Return the prior covariance (5, 5) of a LiDAR's calibration errors.

    The errors are range (m), boresight (3, rad) and latency (s). Their variances follow from the
    specification, but are at least realistic minima.
    """
    i = instrument
    stated = np.array([i.range_bias_sigma, *np.full(3, i.boresight_sigma), i.latency_sigma])
    return np.diag(np.maximum(stated, MIN_SCANNER_SIGMAS) ** 2)


@dataclass(frozen=True)
class CorrectedScan:
    """LiDAR scan with the estimated pose, corrected for estimated scanner errors.

    The points of a scan depend on 11 errors: position (m), small rotation in body axes (rad), range
    (m), boresight (3, rad) and latency (s).

    Attributes
    ----------
    scan
        Scan with corrected ranges and mount.
    position, attitude
        Pose of the lander at the time of the scan: ENU (3,), m, and quaternion, body to ENU (4,).
    velocity, rate
        Velocity (3,), m/s, in the same frame, and body rate (3,), rad/s.
    """

    scan: LidarScan
    position: Array
    attitude: Array
    velocity: Array
    rate: Array

    @classmethod
    def of(cls, scan: LidarScan, state: StrapdownState, scanner_errors: Array) -> CorrectedScan:
        """Return a scan with the estimated pose, corrected for estimated scanner errors.

        `state` is the estimated state of the lander; `scanner_errors` (5,) are the errors of range
        (m), boresight (3, rad) and latency (s).
        """
        corrected = cls(
            scan, state.position.copy(), state.attitude.copy(), state.velocity.copy(), state.rate
        )
        return (
            corrected.corrected_by(np.concatenate((np.zeros(6), scanner_errors)))
            if scanner_errors.any()
            else corrected
        )

    def transformed(self, rotation: Array, attitude: Array, position: Array) -> CorrectedScan:
        """Return the scan with its pose and velocity in another frame.

        `rotation` (3, 3) and `attitude` (4,) are the rotation from this frame to the other, as a
        matrix and as a quaternion; `position` (3,), m, is the origin of this frame in the other.
        """
        return replace(
            self,
            position=rotation @ self.position + position,
            attitude=quat_multiply(attitude, self.attitude),
            velocity=rotation @ self.velocity,
        )

    def corrected_by(self, error: Array) -> CorrectedScan:
        """Return the scan with estimated errors (11,) of pose and scanner added.

        The errors are position (3, m), small rotation in body axes (3, rad), range (m), boresight
        (3, rad) and latency (s). The pose changes by the first six and by the motion during the
        latency; ranges and mount of the scan change by range error and boresight error.
        """
        latency = float(error[10])
        turn = quat_from_rotation_vector(error[3:6])
        attitude = quat_multiply(self.attitude, turn)
        if latency:
            attitude = quat_multiply(attitude, quat_from_rotation_vector(-latency * self.rate))
        scan = self.scan
        if np.any(error[6:10]):
            boresight = quat_to_matrix(quat_from_rotation_vector(error[7:10]))
            corrected = scan.range + error[6]
            corrected[corrected <= 0.0] = np.nan  # a false return close to the sensor
            scan = replace(scan, range=corrected, mount=scan.mount @ boresight)
        position = self.position + error[:3] - latency * self.velocity
        return replace(self, scan=scan, position=position, attitude=attitude)

    def points(self) -> Array:
        """Return the points of the scan (n, 3), m; NaN marks missing returns.

        They are in the frame of the pose (usually the local frame), and follow from one pose for
        the entire scan and from the corrected ranges and mount.
        """
        return self.scan.points(self.position, self.attitude)

    def surface(self, grid: Grid) -> ScanSurface:
        """Return the scan averaged over the squares of a grid, by `average_scan`."""
        return average_scan(self.points(), grid)

    def point_jacobian(self, point: Array) -> Array:
        """Return the Jacobian of a point (3,) with respect to the scan's errors (3, 11).

        The errors are position (m), small rotation in body axes (rad), range (m), boresight (3,
        rad) and latency (s).
        """
        return self.jacobian(np.broadcast_to(point, (3, 3)), np.eye(3))

    def jacobian(self, points: Array, vectors: Array) -> Array:
        """Return the Jacobian (n, 11) of points by the scan's errors, along given vectors.

        The errors are position (m), small rotation in body axes (rad), range (m), boresight (3,
        rad) and latency (s). Row i is the displacement of `points` i by each error, projected on
        `vectors` i; both are (n, 3). With vectors (-dz/dx, -dz/dy, 1) this is the Jacobian of the
        terrain height at fixed horizontal positions.
        """
        rotation = quat_to_matrix(self.attitude)
        return np.asarray(
            kernels.scan_jacobian(
                np.ascontiguousarray(points), np.ascontiguousarray(vectors), self.position,
                rotation, rotation @ self.scan.mount, self.velocity, self.rate,
            )
        )  # fmt: skip
