"""Test the Jacobian of scan points against scans with small errors."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.navigation.corrected_scan import CorrectedScan

DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def seen() -> CorrectedScan:
    """Return a scan of ten rays from a moving, rotating lander with a tilted mount."""
    rng = np.random.default_rng(4)
    rays = np.column_stack((rng.uniform(-0.3, 0.3, (10, 2)), np.ones(10)))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    mount = DOWN @ quat_to_matrix(quat_from_rotation_vector([0.1, -0.2, 0.3]))
    scan = LidarScan(0.0, rng.uniform(40.0, 90.0, 10), rays, mount, np.full(10, 0.02), (1, 10))
    attitude = quat_from_rotation_vector([0.2, 0.1, -0.4])
    return CorrectedScan(
        scan, np.array([5.0, -3.0, 60.0]), attitude, np.array([8.0, -2.0, -5.0]),
        np.array([0.01, 0.04, -0.02]),
    )  # fmt: skip


@pytest.mark.parametrize("error", range(11))
def test_points_move_as_the_scan_does_with_a_small_error(error):
    scan, change = seen(), np.zeros(11)
    change[error] = 1e-5
    ahead, behind = scan.corrected_by(change).points(), scan.corrected_by(-change).points()
    wanted = (ahead - behind) / 2e-5
    for point, way in zip(scan.points(), wanted, strict=True):
        assert scan.point_jacobian(point)[:, error] == pytest.approx(way, abs=1e-5)


def test_points_move_along_many_vectors_as_along_three():
    scan, rng = seen(), np.random.default_rng(5)
    points, normals = scan.points(), rng.normal(size=(10, 3))
    wanted = [n @ scan.point_jacobian(p) for p, n in zip(points, normals, strict=True)]
    assert scan.jacobian(points, normals) == pytest.approx(np.array(wanted), abs=1e-9)


def test_points_lie_where_the_rays_end():
    scan = seen()
    rotation = quat_to_matrix(scan.attitude) @ scan.scan.mount
    wanted = [
        scan.position + r * (rotation @ d)
        for r, d in zip(scan.scan.range, scan.scan.direction, strict=True)
    ]
    assert scan.points() == pytest.approx(np.array(wanted), abs=1e-12)
    with pytest.raises(InputError, match="must have shape"):
        LidarScan(0.0, np.ones(3), np.ones((2, 3)), DOWN, np.ones(3), (1, 3)).points(
            np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
        )


def test_a_range_below_its_correction_is_no_return():
    scan, change = seen(), np.zeros(11)
    change[6] = -50.0
    wanted = np.where(scan.scan.range > 50.0, scan.scan.range - 50.0, np.nan)
    corrected = scan.corrected_by(change).scan
    np.testing.assert_array_equal(corrected.range, wanted)
    assert 0 < np.isnan(wanted).sum() < 10
    corrected.check(scan.position, scan.attitude)
