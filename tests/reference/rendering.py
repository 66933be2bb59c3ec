"""Plain choice of what a picture draws."""

from __future__ import annotations

import itertools

import numpy as np


def coarsest_level(error, most):
    """Return the last level of the first run whose error (levels,) is at most `most`."""
    fits = list(itertools.takewhile(lambda e: e <= most, error))
    return max(len(fits) - 1, 0)


def tile_in_view(low, high, eye, axes, bounds, near):
    """Return whether no side of the view has all eight corners of a box outside."""
    corners = np.array(list(itertools.product(*zip(low, high, strict=True)))) - eye
    x, y, z = (corners @ axes).T
    left, right, upper, lower = bounds
    outside = [z < near, x < left * z, x > right * z, y < upper * z, y > lower * z]
    return not any(side.all() for side in outside)


def distance_of_box(low, high, eye):
    """Return how far a point is from a box."""
    return float(np.linalg.norm(np.clip(eye, low, high) - eye))


def cell_corners(z, ground):
    """Return the elevations over `ground` at the corners SW, SE, NW and NE of each cell."""
    wider = np.pad(z, ((0, 1), (0, 1)), mode="edge") - ground
    return np.stack([wider[:-1, :-1], wider[:-1, 1:], wider[1:, :-1], wider[1:, 1:]], axis=-1)


def least_map(points, hit, height, width):
    """Return the least depth of the points of each texel, 1 where there is none."""
    out = np.ones((height, width), np.float32)
    for column, row, depth in points[hit]:
        out[int(row), int(column)] = min(out[int(row), int(column)], depth)
    return out


def corners_of_rock(rock, reach, foot):
    """Return the corners (8, 3) of the upright box around a rock (a row of the rocks' array)."""
    x, y, base, a, b, height, cos, sin = rock[:8]
    along, across = np.array([cos, sin]), np.array([-sin, cos])
    half = np.array([a, b]) * reach / max(a, b)
    out = []
    for e, f, z in itertools.product((-1, 1), (-1, 1), (foot, base + height)):
        out.append([*(np.array([x, y]) + e * half[0] * along + f * half[1] * across), z])
    return np.array(out)


def lowest_under_rock(rock, reach, z, corner, posting):
    """Return the least of base and posts less than a posting from the square about a rock."""
    (cols,) = np.nonzero(
        np.abs(corner[0] + posting * np.arange(z.shape[1]) - rock[0]) < reach + posting
    )
    (rows,) = np.nonzero(
        np.abs(corner[1] + posting * np.arange(z.shape[0]) - rock[1]) < reach + posting
    )
    under = z[np.ix_(rows, cols)].astype(float)
    return min([rock[2], *under.ravel()])


def whole_pixels(u, v, width, height):
    """Return the first and last column and row with centres in the box of points, or None."""
    cols = [j for j in range(width) if min(u) - 0.005 <= j <= max(u) + 0.005]
    rows = [i for i in range(height) if min(v) - 0.005 <= i <= max(v) + 0.005]
    return (cols[0], rows[0], cols[-1], rows[-1]) if cols and rows else None


def ball_in_view(centre, radius, focal, principal, width, height, near):
    """Return whether no side of the view has a ball (in sensor axes) wholly outside."""
    sides = [(0.0, 0.0, 1.0, near)]
    for axis, last in ((0, width), (1, height)):
        for edge, sign in ((-0.5, 1.0), (last - 0.5, -1.0)):
            normal = np.zeros(3)
            normal[axis] = sign
            normal[2] = -sign * (edge - principal[axis]) / focal[axis]
            sides.append((*(normal / np.linalg.norm(normal)), 0.0))
    return all(np.dot(side[:3], centre) - side[3] >= -radius for side in sides)


def triangles_of(rows, cols):
    """Yield the corners (3, 2), row and column, of the triangles between rows and columns."""
    for south, north in itertools.pairwise(rows):
        for west, east in itertools.pairwise(cols):
            yield np.array([[south, west], [south, east], [north, east]])
            yield np.array([[south, west], [north, west], [north, east]])


def slope_and_heights(z, corners):
    """Return the gradient (a cell) of the plane through posts, and its heights at all posts."""
    values = [z[i, j] for i, j in corners]
    base, north, east = np.linalg.solve(np.column_stack((np.ones(3), corners)), values)
    i, j = np.indices(z.shape)
    return np.hypot(north, east), base + north * i + east * j


def steepest(z):
    """Return the greatest gradient of a relief, a cell."""
    whole = triangles_of(range(z.shape[0]), range(z.shape[1]))
    return max(slope_and_heights(z, corners)[0] for corners in whole)


def decimation_error(z, step):
    """Return how far a relief is at most from that through every n-th post and the last."""
    rows, cols = ([*range(0, n - 1, step), n - 1] for n in z.shape)
    worst = 0.0
    i, j = np.indices(z.shape)
    for corners in triangles_of(rows, cols):
        (south, west), (north, east) = corners[0], corners[2]
        along, across = (j - west) / (east - west), (i - south) / (north - south)
        below = corners[1, 0] == south
        within = (along >= 0) & (along <= 1) & (across >= 0) & (across <= 1)
        within &= (along >= across) if below else (along <= across)
        worst = max(worst, np.abs(slope_and_heights(z, corners)[1] - z)[within].max())
    return worst


def corners_of_box(low, high):
    """Return the corners (8, 3) of a box."""
    return np.array(list(itertools.product(*zip(low, high, strict=True))))


def bounds_of_rocks(rocks, reach, foot):
    """Return the box of rocks' places and elevations, the largest ball's radius and the margin."""
    tops = rocks[:, 2] + rocks[:, 5]
    low = [*rocks[:, :2].min(axis=0), min(rocks[:, 2].min(), foot.min())]
    high = [*rocks[:, :2].max(axis=0), tops.max()]
    tall = np.maximum(rocks[:, 5], rocks[:, 2] - foot)
    return low, high, (1.5 * reach + tall).max(), 1.5 * reach.max()


def sides_of_view(to_sensor, focal, principal, width, height, near):
    """Return inward unit normals and distances (5, 4) of the sides of a view about the camera."""
    sides = [[*to_sensor[2], near]]
    for axis, last in ((0, width), (1, height)):
        for edge, sign in ((-0.5, 1.0), (last - 0.5, -1.0)):
            normal = np.zeros(3)
            normal[axis] = sign
            normal[2] = -sign * (edge - principal[axis]) / focal[axis]
            normal = normal @ to_sensor / np.linalg.norm(normal)
            sides.append([*normal, 0.0])
    return np.array(sides)


def is_read(u, v, width, height, normal, least, most):
    """Return whether the box of points (texels) meets all strips, or is near the map's border."""
    if min(u) < 4 or min(v) < 4 or max(u) > width - 4 or max(v) > height - 4:
        return True
    corners = np.array(list(itertools.product((min(u), max(u)), (min(v), max(v)))))
    along = corners @ normal.T
    return bool(((along.max(axis=0) >= least) & (along.min(axis=0) <= most)).all())


def all_lit(z, posting, sun, share):
    """Return whether all triangles between posts rise towards the Sun less than its rays do.

    By `share` of that at most; not where a post is missing.
    """
    for corners in triangles_of(range(z.shape[0]), range(z.shape[1])):
        points = np.column_stack(
            (posting * corners[:, 1], posting * corners[:, 0], [float(z[i, j]) for i, j in corners])
        )
        if np.isnan(points).any():
            return False
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        normal /= normal[2]
        if -(normal[:2] @ sun[:2]) > share * sun[2]:
            return False
    return True
