"""Local frame of the filter and its transformation to the site frame.

The local frame is defined by the initial estimate: in it, the initial position and azimuth have no
error. The errors of this estimate become errors of the target and the prior map in the local frame,
four states in their own block. Scan-to-scan odometry does not depend on these states, so it leaves
the uncertainty of position and azimuth unchanged. Absolute measurements (a map, stars, ranges to
terrain of known height) correct these states, and the lander as far as it is correlated with them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.frames import (
    SiteToLocal,
    quat_from_rotation_vector,
    quat_to_matrix,
    rotation_about_up,
)
from lunarsim.onboard.navigation.corrected_scan import CorrectedScan
from lunarsim.onboard.navigation.error_state import MAP, POSE, ErrorState
from lunarsim.onboard.navigation.inertial import (
    ATTITUDE,
    POSITION,
    VELOCITY,
    StrapdownState,
)
from lunarsim.typing import Array, IntArray

_UP = np.array([0.0, 0.0, 1.0])


def empty_map_block() -> dict[str, Array]:
    """Return a zero covariance (4, 4) of the map offset, by name of its error block.

    `LocalFrame` sets the covariance.
    """
    return {MAP: np.zeros((4, 4))}


class LocalFrame:
    """Estimated transformation between the filter's local frame and the site frame.

    Site coordinates of a local point x are c + R (x - c - d). Here c is the initial position
    estimate; d and the angle of R about up are the values of a block of four errors in the error
    state.

    Parameters
    ----------
    state
        Error state with the block and the initial estimate in the site frame. The constructor moves
        the errors of position and azimuth from the lander to the block.
    """

    def __init__(self, state: ErrorState) -> None:
        self.state = state
        self.pivot = state.inertial.position.copy()
        block = state.block(MAP)
        self.columns = np.arange(block.start, block.stop)
        _move_initial_errors(state, self.columns)

    # --- estimate -------------------------------------------------------------------------

    @property
    def azimuth(self) -> float:
        """Rotation angle about up that converts local to site-frame vectors, rad.

        A site-frame vector is the local vector, rotated counterclockwise by this angle.
        """
        return float(self.state.value(MAP)[3])

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3) that converts local to site-frame vectors."""
        return rotation_about_up(self.azimuth)

    @property
    def site_to_local(self) -> SiteToLocal:
        """Transformation from the site frame to the local frame."""
        d = self.state.value(MAP)[:3]
        return SiteToLocal(self.pivot + d - self.rotation.T @ self.pivot, -self.azimuth)

    def to_site(self, points: ArrayLike) -> Array:
        """Return local points (..., 3), m, in the site frame."""
        d = self.state.value(MAP)[:3]
        local = np.asarray(points, np.float64)
        return np.asarray((local - self.pivot - d) @ self.rotation.T + self.pivot)

    def in_site(self, corrected: CorrectedScan) -> CorrectedScan:
        """Return a scan, given in the local frame, in the site frame."""
        turn = quat_from_rotation_vector(self.azimuth * _UP)
        return corrected.transformed(self.rotation, turn, self.to_site(np.zeros(3)))

    # --- errors ---------------------------------------------------------------------------

    def pose_columns(self) -> IntArray:
        """Return the state indices that a pose in the site frame depends on (10,)."""
        return np.concatenate((POSE, self.columns))

    def pose_jacobian(self) -> Array:
        """Return the Jacobian (6, 10) of the site-frame pose with respect to state errors.

        Columns: the errors of `pose_columns`. Rows: position (ENU) and small rotation (body axes).
        """
        r, own = self.rotation, self.state.inertial
        out = np.zeros((6, 10))
        out[:3, 0:3], out[:3, 6:9] = r, -r
        out[:3, 9] = np.cross(_UP, self.to_site(own.position) - self.pivot)
        out[3:, 3:6] = np.eye(3)
        out[3:, 9] = quat_to_matrix(own.attitude)[2]
        return out

    def covariance_in_site(self) -> Array:
        """Return the covariance (9, 9) of position, velocity and rotation, site frame.

        The rotation is about body axes.
        """
        r, own = self.rotation, self.state.inertial
        pose = self.pose_jacobian()
        at = np.concatenate((POSE, self.columns, np.arange(VELOCITY.start, VELOCITY.stop)))
        out = np.zeros((9, 13))
        out[0:3, :10], out[6:9, :10] = pose[:3], pose[3:]
        out[3:6, 10:13] = r
        out[3:6, 9] = np.cross(_UP, r @ own.velocity)
        return np.asarray(out @ self.state.covariance_of(at) @ out.T)

    def anchor(self, jacobian: Array, columns: IntArray, other_positions: list[slice]) -> None:
        """Anchor the local frame to a terrain point instead of the initial position.

        The covariance of the state is transformed; the estimates do not change. A correction of
        the attitude then leaves the mapped terrain near this point in place, and moves the lander.
        The operation adds no information: it only changes the reference point of the errors.

        Parameters
        ----------
        jacobian, columns
            Jacobian of the point (3, k) with respect to errors of the state, and their indices
            (k,).
        other_positions
            Slices of all other positions in the local frame in the state, without the lander's
            position.
        """
        row = np.zeros((3, self.state.size))
        row[:, columns] = jacobian
        change = np.eye(self.state.size)
        moved = slice(int(self.columns[0]), int(self.columns[0]) + 3)
        for place in (POSITION, moved, *other_positions):
            change[place] -= row
        p = self.state.covariance
        p[:] = change @ p @ change.T


def _move_initial_errors(state: ErrorState, columns: IntArray) -> None:
    """Move initial errors of position and azimuth from the lander to the map offset.

    The covariance of `state` is transformed in place. `columns` (4,) are the indices of the map
    offset in the error state. The initial errors z = (position, velocity, body rotation, ...)
    refer to the site frame. The local frame is rotated by the azimuth error. In the local frame,
    the position has no error, the attitude error is the tilt, and the velocity error includes the
    effect of the rotation.
    """
    own: StrapdownState = state.inertial
    p = state.covariance
    up = quat_to_matrix(own.attitude)[2]
    transform = np.zeros((state.size, state.size))
    np.fill_diagonal(transform, 1.0)
    transform[columns] = 0.0
    # The position of the lander in the site frame has the error -d; see `LocalFrame`.
    transform[columns[:3], POSITION] = -np.eye(3)
    transform[POSITION] = 0.0
    transform[columns[3], ATTITUDE] = up
    transform[ATTITUDE, ATTITUDE] -= np.outer(up, up)
    transform[VELOCITY, ATTITUDE] -= np.outer(np.cross(_UP, own.velocity), up)
    p[:] = transform @ p @ transform.T
