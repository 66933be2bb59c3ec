"""Where the site frame lies in the local one: four errors of the state, a block of their own.

The local frame is where the lander says that it began: its position at the start and its azimuth
then have no error in it. What the mission tells of them errs, and so does the place of the target
and of a prior map in the local frame. Scans against scans say nothing of that: no such measurement
has these errors in its Jacobian, so that position and azimuth stay as unknown as they were. What
does say something (a map, the stars, ranges to ground of known height) moves the site, and the
lander as far as it errs with it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.frames import (
    Shift,
    quat_from_rotation_vector,
    quat_multiply,
    quat_to_matrix,
    turned_about_up,
)
from lunarsim.onboard.navigation.error_state import MAP, POSE, ErrorState
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.navigation.inertial import (
    ATTITUDE,
    POSITION,
    VELOCITY,
    StrapdownState,
)
from lunarsim.onboard.navigation.seen_scan import SeenScan

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_UP = np.array([0.0, 0.0, 1.0])


def blank_block() -> dict[str, Array]:
    """Return the block for an error state; `LocalFrame` gives it its covariance."""
    return {MAP: np.zeros((4, 4))}


class LocalFrame:
    """The transform between local and site frame, as the error state knows it.

    Site coordinates of a local point x are c + R (x - c - d): c is where the lander was told to
    begin, d and the angle of R (about up) are the block's values.

    Parameters
    ----------
    state
        Error state with the block; its lander is as the mission told, in the site frame. Moves
        what position and azimuth err by from the lander to the block.
    """

    def __init__(self, state: ErrorState) -> None:
        self.state = state
        self.pivot = state.inertial.position.copy()
        block = state.block(MAP)
        self.columns = np.arange(block.start, block.stop)
        _begin(state, self.columns)

    # --- what is believed -----------------------------------------------------------------

    @property
    def azimuth(self) -> float:
        """By which the local frame is turned against the site frame, rad."""
        return float(self.state.value(MAP)[3])

    @property
    def rotation(self) -> Array:
        """From the local to the site frame (3, 3)."""
        return turned_about_up(self.azimuth)

    @property
    def shift(self) -> Shift:
        """From the site frame to the local frame."""
        d = self.state.value(MAP)[:3]
        return Shift(self.pivot + d - self.rotation.T @ self.pivot, -self.azimuth)

    def to_site(self, points: ArrayLike) -> Array:
        """Return site coordinates of local points (..., 3), m."""
        d = self.state.value(MAP)[:3]
        local = np.asarray(points, np.float64)
        return np.asarray((local - self.pivot - d) @ self.rotation.T + self.pivot)

    def in_site(self, seen: SeenScan) -> SeenScan:
        """Return a scan of the local frame in the site frame."""
        turn = quat_from_rotation_vector(self.azimuth * _UP)
        return seen.turned(self.rotation, turn, self.to_site(np.zeros(3)))

    def estimate_in_site(self, estimate: Estimate) -> Estimate:
        """Return an estimate of the local frame in the site frame."""
        turn = quat_from_rotation_vector(self.azimuth * _UP)
        return replace(
            estimate,
            position=self.to_site(estimate.position),
            velocity=self.rotation @ estimate.velocity,
            attitude=quat_multiply(turn, estimate.attitude),
        )

    # --- how it errs ----------------------------------------------------------------------

    def pose_columns(self) -> Index:
        """Return where what a pose in the site frame depends on lies in the state (10,)."""
        return np.concatenate((POSE, self.columns))

    def pose_jacobian(self) -> Array:
        """Return how the errors of the pose in the site frame depend on those (6, 10).

        Rows: position (ENU) and small rotation (body axes).
        """
        r, own = self.rotation, self.state.inertial
        out = np.zeros((6, 10))
        out[:3, 0:3], out[:3, 6:9] = r, -r
        out[:3, 9] = np.cross(_UP, self.to_site(own.position) - self.pivot)
        out[3:, 3:6] = np.eye(3)
        out[3:, 9] = quat_to_matrix(own.attitude)[2]
        return out

    def covariance_in_site(self) -> Array:
        """Return that of position, velocity and small rotation (body axes), site frame (9, 9)."""
        r, own = self.rotation, self.state.inertial
        pose = self.pose_jacobian()
        at = np.concatenate((POSE, self.columns, np.arange(VELOCITY.start, VELOCITY.stop)))
        out = np.zeros((9, 13))
        out[0:3, :10], out[6:9, :10] = pose[:3], pose[3:]
        out[3:6, 10:13] = r
        out[3:6, 9] = np.cross(_UP, r @ own.velocity)
        return np.asarray(out @ self.state.own(at) @ out.T)

    def hang(self, jacobian: Array, columns: Index, places: list[slice]) -> None:
        """Let the local frame hang on a point on the ground instead of where the lander began.

        What is mapped about the point then stays where it is when the attitude is corrected, and
        the lander moves. Nothing is learnt by it: errors are counted from another point.

        Parameters
        ----------
        jacobian, columns
            How the point's error (3,) depends on errors of the state (3, k), (k,).
        places
            Where other positions in the local frame lie in the state, besides the lander's.
        """
        row = np.zeros((3, self.state.size))
        row[:, columns] = jacobian
        change = np.eye(self.state.size)
        moved = slice(int(self.columns[0]), int(self.columns[0]) + 3)
        for place in (POSITION, moved, *places):
            change[place] -= row
        p = self.state.covariance
        p[:] = change @ p @ change.T


def _begin(state: ErrorState, columns: Index) -> None:
    """Give the block what the mission's word on position and azimuth errs by.

    What is told errs in the site frame: z = (position, velocity, body rotation, ...). In the local
    one, turned by the error of azimuth a, the lander's position has no error, its attitude errs by
    the tilt that is left, and its velocity besides by what the turn does to it.
    """
    own: StrapdownState = state.inertial
    p = state.covariance
    up = quat_to_matrix(own.attitude)[2]
    from_told = np.zeros((state.size, state.size))
    np.fill_diagonal(from_told, 1.0)
    from_told[columns] = 0.0
    # The lander's position in the site frame errs by -d: see `LocalFrame`.
    from_told[columns[:3], POSITION] = -np.eye(3)
    from_told[POSITION] = 0.0
    from_told[columns[3], ATTITUDE] = up
    from_told[ATTITUDE, ATTITUDE] -= np.outer(up, up)
    from_told[VELOCITY, ATTITUDE] -= np.outer(np.cross(_UP, own.velocity), up)
    p[:] = from_told @ p @ from_told.T
