"""Test local planes against a least-squares fit of each neighbourhood."""

from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.local_planes import LocalPlaneGrid


def test_planes_are_least_squares_of_five_by_five_squares():
    """Check every square of a map off the origin, including edges and points off the map."""
    rng = np.random.default_rng(3)
    grid = Grid(x0=12.0, y0=-7.0, posting=0.5, rows=18, cols=26)
    squares = LocalPlaneGrid(grid, 3)
    west, east, south, north = grid.extent
    points = rng.uniform((west - 2.0, south - 2.0, -1.0), (east + 2.0, north + 2.0, 1.0), (900, 3))
    found = squares.fit_planes(points)
    rows, cols = squares.shape
    side = 3 * 0.5
    middle = np.array([west, south]) + 0.5 * side * np.array([cols, rows])
    at = np.floor((points[:, :2] - [west, south]) / side).astype(int)
    there = ((at >= 0) & (at < [cols, rows])).all(axis=1)
    for i in range(rows):
        for j in range(cols):
            near = there & (np.abs(at - [j, i]) <= 2).all(axis=1)
            x = points[near, :2] - middle
            design = np.column_stack((np.ones(len(x)), x))
            plain = np.linalg.lstsq(design, points[near, 2], rcond=None)[0]
            assert np.allclose(found[i, j], plain, atol=1e-9)
    heights = squares.plane_heights(found, points[there])
    own = found[at[there, 1], at[there, 0]]
    x = points[there, :2] - middle
    assert np.allclose(heights, own[:, 0] + (own[:, 1:] * x).sum(axis=1), atol=1e-12)


def test_few_points_give_no_plane_but_a_height():
    squares = LocalPlaneGrid(Grid(0.0, 0.0, 1.0, 12, 12), 4)
    points = np.array([[1.0, 1.0, 3.0], [2.0, 1.0, 5.0]])
    assert np.allclose(squares.fit_planes(points)[0, 0], [4.0, 0.0, 0.0])
