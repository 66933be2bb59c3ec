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


def divided(key, tree):
    """Tell whether a cell has children."""
    depth, column, row = key
    return (depth + 1, 2 * column, 2 * row) in tree


def stand_apart(z, tree, half, depths, many):
    """Return which points (n,) stand apart in height, from what each cell with sums holds.

    Cells with sums have children, or are least cells of `many` points. Such a cell answers for the
    points of its own, or of its children without sums.
    """
    apart = np.zeros(len(z), bool)
    owners = {key for key, index in tree.items()
              if divided(key, tree) or (key[0] == depths and len(index) >= many)}  # fmt: skip
    for key in sorted(owners, reverse=True):
        depth, column, row = key
        below = [key]
        if divided(key, tree):
            below = [(depth + 1, 2 * column + (q & 1), 2 * row + (q >> 1)) for q in range(4)]
        loose = [i for c in below if c not in owners or c == key for i in tree[c]]
        ranges = []
        for c in below:
            if c in owners and c != key:
                kept = [z[i] for i in tree[c] if not apart[i]]
                ranges += [(min(kept), max(kept), len(kept))]
        far = 0.3 + 0.25 * 2.0 * half / 2**depth
        alone = [
            i for i in loose
            if all(abs(z[i] - z[j]) > far for j in loose if j != i)
            and all(z[i] < low - far or z[i] > high + far for low, high, _ in ranges)
        ]  # fmt: skip
        total = len(loose) + sum(n for _, _, n in ranges)
        if total >= 5 and len(alone) <= total / 4:
            apart[alone] = True
    return apart


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


def exceptions(points, corner, side, squares, on_mesh, normal, tolerance):
    """Return share and greatest distance of exceptions by the squares (n, n) of a cell.

    Off the mesh through `on_mesh`, or off the plane parallel to it in the middle of the points
    (m, 3). A square without a point where twelve would be expected is NaN.
    """
    d = (points - on_mesh) @ normal
    far = np.maximum(np.abs(d), np.abs(d - np.median(d)))
    place = np.floor((points[:, :2] - corner) / (side / squares)).astype(int)
    ratio, relief = np.zeros((squares, squares)), np.zeros((squares, squares))
    for row in range(squares):
        for col in range(squares):
            mine = far[(place[:, 0] == col) & (place[:, 1] == row)]
            if len(mine):
                ratio[row, col] = np.mean(mine > tolerance)
                relief[row, col] = np.max(mine[mine > tolerance], initial=0.0)
            elif len(points) >= 12 * squares**2:
                ratio[row, col] = relief[row, col] = np.nan
    return ratio, relief


def mesh_point(xy, corners, heights):
    """Return the point (3,) of the first of the triangles (t, 3, 2) that holds xy."""
    for corner, z in zip(corners, heights, strict=True):
        a, b, c = np.asarray(corner, float)
        weights = np.linalg.solve(np.array([[*a, 1.0], [*b, 1.0], [*c, 1.0]]).T, [*xy, 1.0])
        if weights.min() >= -1e-9:
            return np.array([*xy, weights @ z])
    return None


def fitted_slope(points):
    """Return the slope of the least-squares plane of points (n, 3) and its standard error, rad."""
    a = np.column_stack((points[:, :2], np.ones(len(points))))
    found, *_ = np.linalg.lstsq(a, points[:, 2], rcond=None)
    left = np.sum((points[:, 2] - a @ found) ** 2) / (len(points) - 3)
    spread = left * np.linalg.inv(a.T @ a)
    return np.arctan(np.hypot(*found[:2])), np.sqrt(spread[0, 0] + spread[1, 1])


def roughness(points, r, normal, zone, printed):
    """Return Eq. 8 over the points in a square zone: root mean square, or as printed."""
    inside = (np.abs(points[:, :2] - r[:2]) <= zone).all(axis=1)
    d = (points[inside] - r) @ normal
    if printed:
        return float(np.sum(np.sqrt(d**2 / len(d))))
    return float(np.sqrt(np.mean(d**2)))
