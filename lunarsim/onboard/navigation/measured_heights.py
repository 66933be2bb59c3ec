"""Rocks on ground that another eye has measured.

A LiDAR measures the ground from where it flies: how high rocks lie below the lander is then known
to decimetres, where pictures alone leave metres, and with it how far away they are. Seen from the
side a metre of height is a metre and more along the ground.

Ground and rocks are both laid down from the estimated pose. With m the measured height at a rock,
n the ground's normal there of which up is 1, and r the rock less the lander, in true errors
(estimate plus error is truth)

    m - z = n d(rock) - n d(position) - (r x n) d(attitude) + noise,

attitude errors being about body axes, in which r and n are taken there. Noise is a rock's own in
part and in part all rocks' of one scan.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim._blas import one_blas_thread
from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.error_state import POSE, ErrorState, Outcome

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# What a rock's height errs by on measured ground, by itself and with all others, 1 sigma, m.
OWN, COMMON = 0.15, 0.15
# A rock is laid down if its height below the lander has more than this many times the variance.
_VAGUE = 2.0
# So many rocks at most, those that are known worst.
_MOST = 100
# Normalised innovation squared a degree of freedom, beyond which the ground is another's.
_GATE = 10.0
# Slopes are taken between places so far to either side, m: each is a mean over 2 m.
_ASIDE = 4.0


class GroundHeights(Protocol):
    """Somebody who has measured the ground."""

    def heights(self, xy: Array) -> Array:
        """Return its heights (n,) at points (n, 2), local frame, m; NaN where it is not known."""
        ...


class Rocks(Protocol):
    """Rocks in an error state, as `RockStates` has them."""

    state: ErrorState

    @property
    def xyz(self) -> Array:
        """Their centres on the ground (n, 3), ENU, m."""
        ...

    @property
    def xy(self) -> Array:
        """East and north (n, 2), m."""
        ...

    def places(self, index: Index | None = None) -> Index:
        """Return where their coordinates lie in the error state (n, 3)."""
        ...


def lay(rocks: Rocks, ground: GroundHeights) -> Outcome:
    """Let rocks stand on ground that was measured from the lander just now.

    Of rocks whose height below the lander is known as well nothing is told; they move with the
    others by what they share. To be called once a scan, whose error is the same each time; called
    again it tells nothing of rocks that it has laid.

    Parameters
    ----------
    rocks
        The rocks.
    ground
        Who has measured it.

    Returns
    -------
    outcome
        Of the heights; one degree of freedom a rock.
    """
    height = ground.heights(rocks.xy)
    index = np.flatnonzero(np.isfinite(height))
    gradient, bend = _shape(ground, rocks.xy[index])
    by_pose, by_rock = _jacobians(rocks.state, rocks.xyz[index], gradient)
    own = OWN**2 + bend**2
    excess = _variances(rocks, index, by_pose, by_rock) / (own + COMMON**2)
    order = np.argsort(-excess, kind="stable")[:_MOST]
    told = order[excess[order] > _VAGUE]
    if not len(told):
        return Outcome(0.0, 0, False)
    index, by_pose, by_rock = index[told], by_pose[told], by_rock[told]
    state, columns = rocks.state, rocks.places(index)
    p = state.covariance
    with one_blas_thread():
        hp = by_pose @ p[POSE] + np.einsum("ka,kas->ks", by_rock, p[columns])
        s = hp[:, POSE] @ by_pose.T + np.einsum("jka,ka->jk", hp[:, columns], by_rock)
    s = 0.5 * (s + s.T) + np.diag(own[told]) + COMMON**2
    return state.absorb(hp, s, height[index] - rocks.xyz[index, 2], _GATE * len(index))


def pose_shares(state: ErrorState, point: Array) -> Array:
    """Return how a rock's height on measured ground at a point (3,) errs with the pose (6,).

    However that slopes: what moves it aside moves the rock, seen from the same pose, by as much.
    """
    by_pose, _ = _jacobians(state, point[None], np.zeros((1, 2)))
    return np.asarray(-by_pose[0])


def _jacobians(state: ErrorState, points: Array, gradient: Array) -> tuple[Array, Array]:
    """Return how the innovation errs with the pose (k, 6) and with the rock itself (k, 3)."""
    body = quat_to_matrix(state.inertial.attitude)
    normal = np.hstack((-gradient, np.ones((len(points), 1))))
    arm = (points - state.inertial.position) @ body
    return np.hstack((-normal, -np.cross(arm, normal @ body))), normal


def _variances(rocks: Rocks, index: Index, by_pose: Array, by_rock: Array) -> Array:
    """Return the variance of what the height of rocks (k,) on the ground errs by (k,), m^2."""
    p, columns = rocks.state.covariance, rocks.places(index)
    both = np.hstack((by_pose, by_rock))
    at = np.hstack((np.broadcast_to(POSE, (len(index), len(POSE))), columns))
    own = p[at[:, :, None], at[:, None, :]]
    return np.asarray(np.einsum("ka,kab,kb->k", both, own, both))


def _shape(ground: GroundHeights, xy: Array) -> tuple[Array, Array]:
    """Return the gradient of measured ground at points (k, 2), and how far it bends there (k,), m.

    The latter is what a rock's height errs by besides if it stands a little beside its place. Where
    the ground about is not known both are 0.
    """
    gradient, bend = np.zeros((len(xy), 2)), np.zeros(len(xy))
    middle = ground.heights(xy)
    for axis in range(2):
        step = _ASIDE * np.eye(2)[axis]
        more, less = ground.heights(xy + step), ground.heights(xy - step)
        known = np.isfinite(more - less)
        gradient[known, axis] = (more - less)[known] / (2.0 * _ASIDE)
        bend[known] = np.hypot(bend, 0.5 * (more + less) - middle)[known]
    return gradient, bend
