"""Slow, plain counterparts of the quadtree and of site selection on it."""

from __future__ import annotations

import numpy as np


def cells(points, half, depths, split_count):
    """Return {(depth, column, row): indices of points} of a tree over points (n, 3)."""
    out = {}

    def visit(index, depth, column, row):
        out[depth, column, row] = index
        if len(index) < split_count or depth == depths:
            return
        size = 2.0 * half / 2**depth
        x, y = (column + 0.5) * size - half, (row + 0.5) * size - half
        quadrant = (points[index, 0] >= x) + 2 * (points[index, 1] >= y)
        for q in range(4):
            visit(index[quadrant == q], depth + 1, 2 * column + (q & 1), 2 * row + (q >> 1))

    visit(np.arange(len(points)), 0, 0, 0)
    return out


def band(tree, smallest, largest):
    """Return the smallest cells with points between two depths, as keys."""
    found = set()
    for (depth, column, row), index in tree.items():
        if len(index) == 0 or not largest <= depth <= smallest:
            continue
        if depth == smallest or (depth + 1, 2 * column, 2 * row) not in tree:
            found.add((depth, column, row))
    return found


def steepest_plane(xy, corners, normals):
    """Return the steepest normal among the closed triangles (t, 3, 2) that hold xy; or None."""
    best = None
    for corner, normal in zip(corners, normals, strict=True):
        a, b, c = corner
        turns = [
            (q[0] - p[0]) * (xy[1] - p[1]) - (q[1] - p[1]) * (xy[0] - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        if min(turns) >= 0 and (best is None or normal[2] < best[2]):
            best = normal
    return best


def exception_ratio(points, centre, normal, tolerance):
    """Return the share of points (n, 3) off the plane through their mean height at `centre`."""
    r = np.array([*centre, points[:, 2].mean()])
    return float(np.mean(np.abs((points - r) @ normal) > tolerance))


def roughness(points, r, normal, zone, printed):
    """Return Eq. 8 over the points in a square zone: root mean square, or as printed."""
    inside = (np.abs(points[:, :2] - r[:2]) <= zone).all(axis=1)
    d = (points[inside] - r) @ normal
    if printed:
        return float(np.sum(np.sqrt(d**2 / len(d))))
    return float(np.sqrt(np.mean(d**2)))
