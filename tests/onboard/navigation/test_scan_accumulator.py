"""Test the accumulation of scans that cover too few posts."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.navigation.corrected_scan import CorrectedScan
from lunarsim.onboard.navigation.submap import ScanAccumulator, count_covered_squares

DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
TILT = quat_from_rotation_vector([0.02, -0.03, 0.1])


def seen(east, half, position=(0.0, 0.0, 40.0), time=0.0) -> CorrectedScan:
    """Return a scan of terrain that rises to the north, from a tilted lander."""
    t = np.linspace(-half, half, 30)
    x, y = (a.ravel() for a in np.meshgrid(east + t, t))
    ground = np.column_stack((x, y, 0.1 * y))
    at = np.array(position, float)
    turn = quat_to_matrix(TILT) @ DOWN
    rays = (ground - at) @ turn
    reach = np.linalg.norm(rays, axis=1)
    scan = LidarScan(time, reach, rays / reach[:, None], DOWN, np.full(len(reach), 0.02), (30, 30))
    return CorrectedScan(scan, at, TILT, np.zeros(3), np.zeros(3))


def test_a_scan_that_covers_enough_goes_through_as_it_is():
    wide = seen(0.0, 8.0)
    assert count_covered_squares(wide.points(), 1.0) >= 200
    assert ScanAccumulator(1.0, 12, 5.0).take(wide, 0.0) is wide


def test_narrow_scans_are_held_until_together_they_cover_enough():
    gathering, went = ScanAccumulator(1.0, 12, 60.0), []
    for n in range(40):
        narrow = seen(1.5 * n, 1.0, position=(0.3 * n, 0.0, 40.0 - 0.2 * n), time=0.1 * n)
        went.append(gathering.take(narrow, 0.1 * n))
        if went[-1] is not None:
            break
    assert all(one is None for one in went[:-1])
    together = went[-1]
    assert len(went) > 3
    # Seen from the current pose, on the terrain of all scans.
    assert together.position == pytest.approx(narrow.position)
    points = together.points()
    assert count_covered_squares(points, 1.0) >= 30
    assert points[:, 0].min() < 0.0
    assert points[:, 0].max() > 1.5 * n
    assert points[:, 2] == pytest.approx(0.1 * points[:, 1], abs=0.02)
    assert np.isfinite(together.scan.sigma).all()
    # Accumulated scans are used once.
    assert gathering.take(narrow, 0.1 * n) is None


def test_old_scans_are_left_out():
    gathering = ScanAccumulator(1.0, 12, 5.0)
    assert gathering.take(seen(0.0, 1.0), 0.0) is None
    for n in range(40):
        found = gathering.take(seen(100.0 + 1.5 * n, 1.0), 6.0 + 0.01 * n)
        if found is not None:
            break
    assert found.points()[:, 0].min() > 90.0


def test_empty_scan_covers_no_post():
    assert count_covered_squares(np.full((5, 3), np.nan), 1.0) == 0


def test_posts_of_a_scan_that_grazes_the_terrain_are_counted_too():
    far = np.array([[0.0, 0.0, 0.0], [0.4, 0.3, 0.0], [1e5, 1e5, 0.0], [1e5, np.nan, 0.0]])
    assert count_covered_squares(far, 1.0) == 2
    assert count_covered_squares(far, 1.0, 1) == 1
