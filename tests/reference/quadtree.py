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
    """Return share of exceptions, and how far points reach, by the squares (n, n) of a cell.

    Off the mesh through `on_mesh`, or off the plane parallel to it in the middle of the points
    (m, 3). Gaps are left out, see `gaps`.
    """
    d = (points - on_mesh) @ normal
    off_middle = np.abs(d - np.median(d))
    far = np.maximum(np.abs(d), off_middle)
    reach = np.where(far > tolerance, far, off_middle)
    place = np.floor((points[:, :2] - corner) / (side / squares)).astype(int)
    ratio, relief = np.zeros((squares, squares)), np.zeros((squares, squares))
    for row in range(squares):
        for col in range(squares):
            mine = (place[:, 0] == col) & (place[:, 1] == row)
            if mine.any():
                ratio[row, col] = np.mean(far[mine] > tolerance)
                relief[row, col] = np.max(reach[mine])
    return ratio, relief


def gaps(number):
    """Tell which squares of a raster of numbers of points (rows, cols) should hold some and do not.

    Along the row or along the column the first two squares of four with points, on either side,
    hold twelve; where one side has none in four, the other side's do. Or no side has any.
    """
    out = np.zeros(number.shape, bool)
    for row, col in np.argwhere(number == 0):
        near = 0
        for line, at in ((number[row], col), (number[:, col], row)):
            sides = []
            for side in (line[at + 1 : at + 5], line[:at][::-1][:4]):
                first = np.flatnonzero(side)
                sides += [side[first[0] : first[0] + 2].max()] if len(first) else []
            out[row, col] |= bool(sides) and min(sides) >= 12
            near += len(sides)
        out[row, col] |= near == 0
    return out


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


def surface(cells, centres, posting):
    """Return the ground at the centres (rows, cols, 2) of a raster from cells x, y, size, height.

    Cells larger than the raster's have the slope of a bell of 3 postings over all cells, each in
    the raster's cell just north-east of its middle.
    """
    bells = np.exp(-0.5 * (np.arange(-12, 13) / 3.0) ** 2)
    bells /= bells.sum()
    rows, cols = centres.shape[:2]
    trend = np.full((rows, cols), np.nan)
    corner = centres[0, 0] - 0.5 * posting
    place = np.floor((cells[:, :2] + 1e-6 - corner) / posting).astype(int)
    for row in range(rows):
        for col in range(cols):
            total = weight = 0.0
            for (i, j), z in zip(place, cells[:, 3], strict=True):
                if abs(i - col) <= 12 and abs(j - row) <= 12:
                    w = bells[12 + i - col] * bells[12 + j - row]
                    total, weight = total + w * z, weight + w
            if weight > 1e-3:
                trend[row, col] = total / weight
    out = trend.copy()
    for x, y, size, z in cells:
        inside = (np.abs(centres - (x, y)) < 0.5 * size).all(axis=-1)
        out[inside] = z if size < 1.5 * posting else z + trend[inside] - np.mean(trend[inside])
    return out


def without_holes(height: np.ndarray, reach: int) -> np.ndarray:
    """Return a raster (rows, cols) raised, cell by cell, to the lowest of the highest about it.

    Squares reach so many cells to each side; what is NaN counts as lowest and stays NaN. Beside
    the raster its edge goes on.
    """
    rows, cols = height.shape

    def about(z: np.ndarray, i: int, j: int) -> list[float]:
        return [
            z[min(max(i + a, 0), rows - 1), min(max(j + b, 0), cols - 1)]
            for a in range(-reach, reach + 1)
            for b in range(-reach, reach + 1)
        ]

    low = np.where(np.isnan(height), -np.inf, height)
    high, out = np.empty_like(height), np.full_like(height, np.nan)
    for i in range(rows):
        for j in range(cols):
            high[i, j] = max(about(low, i, j))
    for i in range(rows):
        for j in range(cols):
            if not np.isnan(height[i, j]):
                out[i, j] = min(about(high, i, j))
    return out
