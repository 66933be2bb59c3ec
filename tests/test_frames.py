from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from lunarsim import frames

component = st.floats(-1.0, 1.0, allow_nan=False)
vectors = arrays(np.float64, 3, elements=component)
quaternions = (
    arrays(np.float64, 4, elements=component)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


@given(quaternions, quaternions)
def test_product_is_composition(p, q):
    ours = Rotation.from_quat(frames.quat_multiply(p, q))
    assert (ours.inv() * Rotation.from_quat(p) * Rotation.from_quat(q)).magnitude() < 1e-9


@given(quaternions, vectors)
def test_rotation_agrees_with_scipy(q, v):
    assert np.allclose(frames.quat_rotate(q, v), Rotation.from_quat(q).apply(v), atol=1e-12)


@given(quaternions)
def test_matrix_round_trip(q):
    assert frames.quat_angle(frames.matrix_to_quat(frames.quat_to_matrix(q)), q) < 1e-7


@given(vectors.filter(lambda v: np.linalg.norm(v) < 3.0))
def test_rotation_vector_round_trip(phi):
    assert np.allclose(
        frames.quat_to_rotation_vector(frames.quat_from_rotation_vector(phi)), phi, atol=1e-9
    )


@given(quaternions)
def test_conjugate_undoes(q):
    back = frames.quat_multiply(frames.quat_conjugate(q), q)
    assert np.allclose(back, [0.0, 0.0, 0.0, 1.0], atol=1e-12)


@given(vectors.filter(lambda v: np.linalg.norm(v) > 0.1), st.floats(-np.pi, np.pi))
def test_thrust_attitude_points_body_z(direction, heading):
    q = frames.attitude_from_thrust(direction, heading)
    up = frames.quat_rotate(q, [0.0, 0.0, 1.0])
    assert np.allclose(up, direction / np.linalg.norm(direction), atol=1e-9)
    assert np.isclose(np.linalg.norm(q), 1.0)


@pytest.mark.parametrize("heading", [-2.0, 0.0, 0.3, 1.5])
def test_upright_attitude_keeps_heading(heading):
    q = frames.attitude_from_thrust([0.0, 0.0, 1.0], heading)
    assert frames.heading_of(q) == pytest.approx(heading)


def test_zero_vector_has_no_direction():
    with pytest.raises(ValueError, match="zero length"):
        frames.normalised([0.0, 0.0, 0.0])


@given(vectors.filter(lambda v: np.linalg.norm(v) > 0.1))
def test_sensor_axes_are_a_rotation(boresight):
    axes = frames.sensor_axes(boresight)
    assert np.allclose(axes.T @ axes, np.eye(3), atol=1e-9)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert np.allclose(axes[:, 2], frames.normalised(boresight), atol=1e-12)


def test_nadir_image_has_north_up():
    axes = frames.sensor_axes([0.0, 0.0, -1.0])
    assert np.allclose(axes[:, 0], [1.0, 0.0, 0.0])
    assert np.allclose(axes[:, 1], [0.0, -1.0, 0.0])


def test_azimuth_is_clockwise_from_north():
    east = frames.direction_from_angles(np.pi / 2, 0.0)
    assert np.allclose(east, [1.0, 0.0, 0.0])
    assert np.allclose(frames.direction_from_angles(0.0, np.pi / 2), [0.0, 0.0, 1.0], atol=1e-12)
