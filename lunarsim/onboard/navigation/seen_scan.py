"""A scan with all that its points depend on: the lander's pose and what the scanner errs by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.instruments import LidarInstrument
from lunarsim.onboard.navigation import _registration_kernels as kernels
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.onboard.navigation.surface import Surface, surface_of

Array = NDArray[np.float64]

# Errors of a scan: position (ENU, m), small rotation (body axes), then the scanner's: range (m),
# boresight (small rotation, sensor axes, rad), latency (s).
SCANNER = slice(6, 11)
# No scanner is known better than this, whatever is said of it, m, rad, s. Claims beyond it make an
# error that nobody told of look like one of pose, and nothing then contradicts it.
LEAST = np.array([0.1, *np.full(3, np.deg2rad(0.15)), 0.01])
# What is let go where innovations drift and nothing was said of the scanner: m, rad, s.
LET_GO = np.array([0.5, *np.full(3, np.deg2rad(0.5)), 0.02])


def scanner_block(name: str) -> str:
    """Return the name of the block of what a scanner errs by."""
    return f"lidar {name}"


def scanner_covariance(instrument: LidarInstrument) -> Array:
    """Return that of what a scanner errs by (5, 5), by its calibration and by what is likely."""
    i = instrument
    stated = np.array([i.range_bias, *np.full(3, i.boresight), i.latency])
    return np.diag(np.maximum(stated, LEAST) ** 2)


@dataclass(frozen=True)
class SeenScan:
    """A scan at a pose.

    Attributes
    ----------
    scan
        Ranges and mount as they are thought to be.
    position, attitude
        Of the lander at the flash (3,), (4,).
    velocity, rate
        (3,), m/s, same frame; (3,), rad/s, body axes.
    """

    scan: LidarScan
    position: Array
    attitude: Array
    velocity: Array
    rate: Array

    @classmethod
    def of(cls, scan: LidarScan, own: StrapdownState, scanner: Array) -> SeenScan:
        """Return a scan from where the lander is thought to be, with a scanner's errors (5,)."""
        seen = cls(scan, own.position.copy(), own.attitude.copy(), own.velocity.copy(), own.rate)
        return seen.moved(np.concatenate((np.zeros(6), scanner))) if scanner.any() else seen

    def turned(self, rotation: Array, attitude: Array, position: Array) -> SeenScan:
        """Return it in another frame, to which a rotation (3, 3) leads from this one.

        Parameters
        ----------
        rotation
            From this frame to that.
        attitude, position
            Quaternion (4,) of the same rotation, and where this frame's origin lies there (3,).
        """
        return replace(
            self,
            position=rotation @ self.position + position,
            attitude=quat_multiply(attitude, self.attitude),
            velocity=rotation @ self.velocity,
        )

    def moved(self, error: Array) -> SeenScan:
        """Return it with errors (11,) added."""
        late = float(error[10])
        turn = quat_from_rotation_vector(error[3:6])
        attitude = quat_multiply(self.attitude, turn)
        if late:
            attitude = quat_multiply(attitude, quat_from_rotation_vector(-late * self.rate))
        scan = self.scan
        if np.any(error[6:10]):
            aim = quat_to_matrix(quat_from_rotation_vector(error[7:10]))
            scan = replace(scan, range=scan.range + error[6], mount=scan.mount @ aim)
        position = self.position + error[:3] - late * self.velocity
        return replace(self, scan=scan, position=position, attitude=attitude)

    def points(self) -> Array:
        """Return its points (n, 3), NaN for no return."""
        return self.scan.points(self.position, self.attitude)

    def surface(self, grid: Grid) -> Surface:
        """Return it averaged over the squares of a grid."""
        return surface_of(self.points(), grid)

    def point_jacobian(self, point: Array) -> Array:
        """Return how a point of it (3,) moves with its errors (3, 11)."""
        return self.jacobian(np.broadcast_to(point, (3, 3)), np.eye(3))

    def jacobian(self, points: Array, normals: Array) -> Array:
        """Return how points (m, 3) move along vectors (m, 3) with its errors (m, 11).

        With normals (-dz/dx, -dz/dy, 1): the surface's height over fixed places.
        """
        rotation = quat_to_matrix(self.attitude)
        return np.asarray(
            kernels.scan_jacobian(
                np.ascontiguousarray(points), np.ascontiguousarray(normals), self.position,
                rotation, rotation @ self.scan.mount, self.velocity, self.rate,
            )
        )  # fmt: skip
