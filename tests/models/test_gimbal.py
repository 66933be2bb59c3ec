"""Where a gimbal lets a sensor look."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix, sensor_axes
from lunarsim.models.gimbal import gimbal_mount, limit_mount

vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3)
limits = st.floats(0.01, 3.1)


def is_rotation(mount) -> bool:
    return np.allclose(mount @ mount.T, np.eye(3), atol=1e-12) and np.linalg.det(mount) > 0.0


def off_rest(mount) -> float:
    """Return the angle (rad) of the boresight from straight down through the lander."""
    x, y, z = mount[:, 2]
    return float(np.arctan2(np.hypot(x, y), -z))


@given(vectors, vectors, limits)
def test_a_mount_points_where_it_is_wanted_or_stops_at_the_limit(turn, boresight, limit):
    attitude = quat_from_rotation_vector(turn)
    mount = gimbal_mount(attitude, boresight, limit)
    assert is_rotation(mount)
    wanted = quat_to_matrix(attitude).T @ np.array(boresight) / np.linalg.norm(boresight)
    asked = np.arctan2(np.hypot(wanted[0], wanted[1]), -wanted[2])
    if asked <= limit:
        assert mount[:, 2] == pytest.approx(wanted, abs=1e-9)
    else:
        assert off_rest(mount) == pytest.approx(limit, abs=1e-7)
        # On the side of what was wanted: no closer place is within reach.
        assert np.arccos(mount[:, 2] @ wanted) == pytest.approx(asked - limit, abs=1e-6)


@given(vectors, limits)
def test_within_turns_back_to_the_limit_by_the_least_angle(boresight, limit):
    mount = np.asarray(sensor_axes(boresight))
    held = limit_mount(mount, limit)
    asked = off_rest(mount)
    if asked <= limit:
        assert held is mount
        return
    assert is_rotation(held)
    assert off_rest(held) == pytest.approx(limit, abs=1e-7)
    turned = np.arccos(np.clip(0.5 * (np.trace(held @ mount.T) - 1.0), -1.0, 1.0))
    assert turned == pytest.approx(asked - limit, abs=1e-6)


def test_at_the_limit_nothing_is_turned():
    limit = np.deg2rad(30.0)
    mount = gimbal_mount([0.0, 0.0, 0.0, 1.0], [1.0, 0.2, -0.1], limit)
    assert limit_mount(mount, limit) is mount


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [1e-13, 0.0, 1.0]])
def test_a_boresight_straight_up_comes_to_the_limit_on_some_side(up):
    held = limit_mount(np.asarray(sensor_axes(up)), 0.5)
    assert is_rotation(held)
    assert off_rest(held) == pytest.approx(0.5, abs=1e-7)
    assert off_rest(gimbal_mount([0.0, 0.0, 0.0, 1.0], up, 0.5)) == pytest.approx(0.5, abs=1e-7)
