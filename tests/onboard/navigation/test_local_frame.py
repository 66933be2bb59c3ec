"""Test that the local frame gives the same estimates as the site frame."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import (
    attitude_from_thrust,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
    quat_to_rotation_vector,
)
from lunarsim.onboard.navigation.error_state import MAP, ErrorState
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.local_frame import LocalFrame, empty_map_block
from lunarsim.onboard.navigation.measurement_models import (
    update_with_attitude,
    update_with_range,
    update_with_speeds,
)

ERRORS = StartSigmas(20.0, 0.3, np.deg2rad(0.6))
START = np.array([-300.0, 40.0, 220.0])
VELOCITY = np.array([12.0, -3.0, -5.0])
ATTITUDE = attitude_from_thrust([0.3, -0.1, 1.0], 1.2)
KEEP = np.r_[0:6, 9:12]
BEAMS = np.array([[0.3, 0.1, -0.95], [-0.3, 0.2, -0.93], [0.0, -0.35, -0.94]])
BEAMS /= np.linalg.norm(BEAMS, axis=1)[:, None]


def strapdown():
    return StrapdownState(START, VELOCITY, ATTITUDE, 1.62)


def told():
    """Return a filter in the site frame, without a local frame."""
    return ErrorState(strapdown(), ERRORS, blocks={"ground": np.diag([4.0])})


def own():
    """Return the same filter in a local frame."""
    state = ErrorState(strapdown(), ERRORS, blocks={"ground": np.diag([4.0])} | empty_map_block())
    return state, LocalFrame(state)


def flown(state, seed, steps=40):
    """Propagate a filter over 1 s of thrust and rotation."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        push = 0.01 * (np.array([0.2, -0.1, 2.5]) + 0.3 * rng.standard_normal(3))
        state.propagate(0.01 * 0.05 * rng.standard_normal((1, 3)), push[None])


def test_initial_site_covariance_is_that_of_briefing():
    plain, (_, frame) = told(), own()
    expected = plain.covariance[np.ix_(KEEP, KEEP)]
    assert frame.covariance_in_site() == pytest.approx(expected, rel=1e-9, abs=1e-12)
    # In the local frame, the lander has no error of position or azimuth.
    state, _ = own()
    up = quat_to_matrix(ATTITUDE)[2]
    assert not state.covariance[:3, :3].any()
    assert up @ state.covariance[9:12, 9:12] @ up == pytest.approx(0.0, abs=1e-18)
    block = state.covariance[state.block(MAP), state.block(MAP)]
    assert np.sqrt(np.diag(block)) == pytest.approx([20.0, 20.0, 20.0, ERRORS.attitude])


def measure(state, off, at):
    """Process an attitude, a range and speeds with offsets from those of the pose `at`."""
    attitude = quat_multiply(
        at.attitude, quat_from_rotation_vector(off * np.array([1.0, 2.0, -3.0]))
    )
    rotation = quat_to_matrix(at.attitude)
    down = rotation[2] @ [0.0, 0.0, -1.0]
    speeds = BEAMS @ (rotation.T @ at.velocity)
    return [
        update_with_attitude(state, attitude, 1e-6 * np.eye(3)),
        update_with_range(
            state, -at.position[2] / down + 1e4 * off, 0.5, [0.0, 0.0, -1.0], 0.0, block="ground"
        ),
        update_with_speeds(state, speeds, np.full(3, 0.05), BEAMS),
    ]


@pytest.mark.parametrize(("off", "close"), [(0.0, 1e-4), (2e-4, 0.02)])
def test_both_frames_agree_after_flight(off, close):
    plain, (state, frame) = told(), own()
    at, outcomes = strapdown(), []
    pilot = ErrorState(at, ERRORS)
    for one in (pilot, plain, state):
        flown(one, 5)
    for one in (plain, state):
        # Twice: the second time the innovations are smaller.
        outcomes.append(measure(one, off, at) + measure(one, off, at))
    for one in (plain, state):
        flown(one, 6)
    p = frame.covariance_in_site()
    expected = plain.covariance[np.ix_(KEEP, KEEP)]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # With innovations, the linearisation points differ slightly.
    assert p / scale == pytest.approx(expected / scale, abs=close)
    for one, other in zip(*outcomes, strict=True):
        assert one.is_accepted
        assert other.nis == pytest.approx(one.nis, rel=0.1, abs=1e-3)
    sigma = np.sqrt(np.diag(expected))
    found = frame.to_site(state.inertial.position)
    assert np.abs(found - plain.inertial.position).max() < (0.02 if off else 1e-9) * sigma[:3].max()
    attitude = quat_multiply(
        quat_from_rotation_vector([0.0, 0.0, frame.azimuth]), state.inertial.attitude
    )
    between = quat_multiply(quat_conjugate(plain.inertial.attitude), attitude)
    assert np.linalg.norm(quat_to_rotation_vector(between)) < 0.1 * sigma[6:].max()
    # An attitude reading rotates the site, not the lander.
    assert (abs(frame.azimuth) > off) == (off > 0.0)


def test_the_pose_in_the_site_frame_moves_as_its_jacobian_says():
    state, frame = own()
    flown(state, 3)
    state.correct(_error(state, 0.01))

    def pose(small):
        other, its = own()
        flown(other, 3)
        other.correct(_error(other, 0.01))
        change = np.zeros(other.size)
        change[its.pose_columns()] = small
        other.correct(change)
        turn = quat_from_rotation_vector([0.0, 0.0, its.azimuth])
        return its.to_site(other.inertial.position), quat_multiply(turn, other.inertial.attitude)

    at, attitude = pose(np.zeros(10))
    columns = []
    for i in range(10):
        small = np.zeros(10)
        small[i] = 1e-6
        there, turned = pose(small)
        body = quat_to_rotation_vector(quat_multiply(quat_conjugate(attitude), turned))
        columns.append(np.concatenate((there - at, body)) / 1e-6)
    assert frame.pose_jacobian() == pytest.approx(np.array(columns).T, abs=2e-3)


def _error(state, size):
    change = np.zeros(state.size)
    change[state.block(MAP)] = [3.0, -2.0, 1.0, size]
    change[:3] = [1.0, 2.0, -1.0]
    return change


def test_the_shift_is_the_transform_both_ways():
    state, frame = own()
    state.correct(_error(state, 0.02))
    points = np.random.default_rng(0).normal(0.0, 100.0, (5, 3))
    there = frame.site_to_local.to_local(points)
    assert frame.to_site(there) == pytest.approx(points)
    assert frame.site_to_local.to_site(there) == pytest.approx(points)
    # By hand: a rotation about the initial position estimate, and a shift.
    turn = quat_from_rotation_vector([0.0, 0.0, 0.02])
    by_hand = quat_rotate(turn, there[0] - START - [3.0, -2.0, 1.0]) + START
    assert points[0] == pytest.approx(by_hand)


def test_anchored_frame_correlates_tilt_and_position():
    state, frame = own()
    before = frame.covariance_in_site()
    away = np.array([300.0, -40.0, -220.0])
    cross = np.cross(np.eye(3), away)
    rotation = quat_to_matrix(ATTITUDE)
    # A small turn t (ENU) moves a point of a scan by t x away.
    jacobian = np.hstack((np.eye(3), cross.T @ rotation))
    jacobian[:, 3:] = np.column_stack([np.cross(rotation[:, i], away) for i in range(3)])
    columns = np.r_[0:3, 9:12]
    frame.anchor(jacobian, columns, [])
    p = state.covariance
    # The point has no error any more, the lander has that of the tilt; the estimate is the same.
    assert np.abs(jacobian @ p[np.ix_(columns, columns)] @ jacobian.T).max() < 1e-9
    assert 2.0 < np.sqrt(p[0, 0]) < 6.0
    assert frame.covariance_in_site() == pytest.approx(before, rel=1e-9, abs=1e-9)


def test_an_estimate_in_the_site_frame_is_turned_whole():
    state, frame = own()
    state.correct(_error(state, 0.5))
    local = state.inertial.estimate(state.covariance, 1.0, 2.0)
    there = local.in_site(frame.site_to_local)
    turn = quat_from_rotation_vector([0.0, 0.0, 0.5])
    assert there.velocity == pytest.approx(quat_rotate(turn, local.velocity))
    assert there.position == pytest.approx(frame.to_site(local.position))
    assert quat_rotate(there.attitude, [0.0, 1.0, 0.0]) == pytest.approx(
        quat_rotate(turn, quat_rotate(local.attitude, [0.0, 1.0, 0.0]))
    )


def test_velocity_in_the_site_frame_has_the_error_of_its_azimuth():
    """An azimuth error a causes the velocity error a times up x velocity in the site frame."""
    state, frame = own()
    state.covariance[:] = 0.0
    turned = state.block(MAP).start + 3
    state.covariance[turned, turned] = 0.04**2
    p = frame.covariance_in_site()
    across = np.cross([0.0, 0.0, 1.0], VELOCITY)
    assert p[3:6, 3:6] == pytest.approx(0.04**2 * np.outer(across, across), abs=1e-12)
    assert not p[0:3, 0:3].any()  # it is at the centre of the rotation


def test_other_positions_are_anchored_too():
    blocks = {"key": np.zeros((6, 6))} | empty_map_block()
    state = ErrorState(strapdown(), ERRORS, blocks=blocks)
    frame = LocalFrame(state)
    state.clone("key", np.r_[0:3, 9:12])
    columns, key = np.r_[0:3, 9:12], state.block("key")
    jacobian = np.hstack((np.eye(3), 100.0 * np.eye(3)))
    frame.anchor(jacobian, columns, [slice(key.start, key.start + 3)])
    # The reference pose is the current pose: their errors are equal before and after.
    p = state.covariance
    same = np.zeros((3, state.size))
    same[:, :3], same[:, key.start : key.start + 3] = np.eye(3), -np.eye(3)
    assert np.abs(same @ p @ same.T).max() < 1e-12
    assert p[key.start, key.start] > 0.1
