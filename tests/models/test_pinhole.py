import numpy as np

from lunarsim.models.camera import CameraModel
from lunarsim.models.pinhole import Pinhole, View

HOLE = Pinhole(500.0, 510.0, 319.5, 200.0)


def _points(count=50, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack((rng.uniform(-5.0, 5.0, (count, 2)), rng.uniform(2.0, 20.0, count)))


def test_a_point_on_a_pixels_line_of_sight_projects_to_that_pixel():
    right, down = HOLE.tangents(640, 400)
    depth = np.random.default_rng(1).uniform(1.0, 90.0, right.shape)
    points = np.stack((right * depth, down * depth, depth), axis=-1).reshape(-1, 3)
    v, u = np.indices(right.shape)
    np.testing.assert_allclose(HOLE.project(points), np.stack((u, v), -1).reshape(-1, 2), atol=1e-9)


def test_the_jacobian_is_the_derivative_of_the_projection():
    points, step = _points(), 1e-6
    shift = step * np.eye(3)
    ahead = np.stack([HOLE.project(points + s) for s in shift], axis=-1)
    back = np.stack([HOLE.project(points - s) for s in shift], axis=-1)
    np.testing.assert_allclose(HOLE.jacobian(points), (ahead - back) / (2.0 * step), rtol=1e-5)


def test_the_jacobian_by_other_coordinates_follows_the_chain_rule():
    points = _points()
    axes = np.random.default_rng(2).normal(size=(3, 2))
    chain = HOLE.jacobian(points) @ axes
    np.testing.assert_allclose(HOLE.jacobian(points, axes), chain, rtol=1e-9, atol=1e-9)


def test_the_border_lies_half_a_pixel_beyond_the_outer_pixels():
    view = View(np.zeros(3), np.eye(3), *HOLE, 640, 400)
    left, right, upper, lower = view.border_tangents
    corners = np.array([[left, upper, 1.0], [right, lower, 1.0]])
    np.testing.assert_allclose(HOLE.project(corners), [[-0.5, -0.5], [639.5, 399.5]], atol=1e-9)


def test_a_camera_and_its_view_share_one_projection():
    camera = CameraModel(width=320, height=200, fx=300.0, fy=310.0)
    assert camera.pinhole == (300.0, 310.0, 159.5, 99.5)
