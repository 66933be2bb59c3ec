"""Delaunay triangulation of points, and faster of a detector's returns.

Coordinates are rounded to 2**-25 of their extent (3 micrometres over 100 m) and become integers.
Orientation and in-circle tests are exact for integers, so that the result is the Delaunay
triangulation of the rounded points in any arrangement, and does not depend on the machine. If more
than three points lie on one empty circle, every triangulation of them is Delaunay; which one is
returned depends only on their order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.triangulation._flip_kernels import triangulate_mesh
from lunarsim.triangulation._insertion_kernels import hilbert_keys, insert_all
from lunarsim.typing import IntArray

_BITS = 25
# Outside these limits, steps of the integer grid are not normal floating-point numbers.
_MIN_EXTENT, _MAX_EXTENT = 1e-290, 1e290


def _to_integers(xy: ArrayLike) -> IntArray:
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"xy must have the shape (n, 2), got {points.shape}.")
    if not np.isfinite(points).all():
        raise ValueError("xy must not contain NaN or infinity. Remove such points.")
    if len(points) == 0:
        return np.zeros((0, 2), np.int64)
    low, high = (np.array([f(column) for column in points.T.copy()]) for f in (np.min, np.max))
    with np.errstate(over="ignore"):
        extent = float((high - low).max())
    if extent > 0.0 and not _MIN_EXTENT <= extent <= _MAX_EXTENT:
        raise ValueError(
            f"xy must have an extent of 0, or {_MIN_EXTENT:g} to {_MAX_EXTENT:g}, got {extent:g}."
        )
    # A power of two, so that coordinates that are already multiples of one stay exact.
    scale = 2.0 ** (_BITS - 1 - np.frexp(extent)[1]) if extent > 0.0 else 1.0
    return np.asarray(np.rint((points - low) * scale), dtype=np.int64)


def delaunay(xy: ArrayLike) -> IntArray:
    """Triangulate points by incremental insertion.

    Points are inserted along a Hilbert curve (Bowyer 1981, Watson 1981); ghost triangles represent
    the outside of the hull.

    Parameters
    ----------
    xy
        Points (n, 2). Of points that coincide after rounding, the first is used.

    Returns
    -------
    triangles
        Indices into `xy` (m, 3), counter-clockwise; empty for fewer than 3 points, or if all points
        are collinear.

    Raises
    ------
    ValueError
        If the array is not (n, 2), contains NaN or infinity, or its extent is out of range.

    Examples
    --------
    >>> delaunay([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.1]]).shape
    (2, 3)
    """
    points = _to_integers(xy)
    if len(points) < 3:
        return np.zeros((0, 3), np.int64)
    key = hilbert_keys(points, _BITS)
    order = np.argsort(key, kind="stable")
    # Coincident points are adjacent along the curve.
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = key[order][1:] != key[order][:-1]
    order = order[fresh]
    return np.asarray(insert_all(points, order))


def delaunay_of_image(xy: ArrayLike, shape: tuple[int, int]) -> IntArray:
    """Triangulate the returns of a detector, given row by row.

    The detector's own mesh is already a triangulation, unless terrain occludes other terrain; edges
    are flipped until it is Delaunay (Lawson 1977). If the mesh folds over, or a return is missing,
    `delaunay` is used.

    Parameters
    ----------
    xy
        Points (rows * cols, 2); NaN for no return.
    shape
        Rows and columns of the detector.

    Returns
    -------
    triangles
        Indices into `xy` (m, 3), counter-clockwise.

    Raises
    ------
    ValueError
        If the number of points is not rows * cols, or a point is infinite.
    """
    points = np.asarray(xy, dtype=np.float64)
    rows, cols = shape
    if points.shape != (rows * cols, 2):
        raise ValueError(f"xy must have the shape ({rows * cols}, 2), got {points.shape}.")
    seen = ~np.isnan(points).any(axis=1)
    if seen.all() and rows > 1 and cols > 1:
        triangles = np.asarray(triangulate_mesh(_to_integers(points), rows, cols))
        if len(triangles):
            return triangles
    index = np.flatnonzero(seen)
    return np.asarray(index[delaunay(points[index])])
