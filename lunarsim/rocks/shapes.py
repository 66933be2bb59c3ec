"""Unit shapes of rocks, before scaling, rotation and placement.

A unit shape stands on the plane g = 0 with its top at g = 1, in axes (e, f, g). It is either the
unit hemisphere or the convex intersection of a few half spaces ``n . q <= d``. No face points
downwards, so that the body extruded below g = 0 keeps its outline and the surface is a function of
(x, y).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from lunarsim.typing import Array, IntArray

ELLIPSOID = 0
CUBE = 1
# Irregular convex rocks are shapes 2 to 2 + IRREGULAR_COUNT - 1.
IRREGULAR = 2
IRREGULAR_COUNT = 16

_SEED = 1997
# Numbers of vertices on the outline and on the dome of an irregular boulder.
_RING = 6
_DOME = 4


@dataclass(frozen=True)
class ShapeTable:
    """Unit shapes of rocks as arrays, one row per shape.

    Attributes
    ----------
    planes
        Half spaces n . q <= d of each shape (shapes, max count, 4): unit normal n and offset d.
    count
        Number of half spaces of each shape (shapes,); 0 for the hemisphere.
    reach
        Maximum distance of the outline from the axis (shapes,).
    vertices
        Vertices of each polyhedron's outline and top (shapes, max vertices, 3), padded with NaN:
        the body is their convex hull, extruded downwards.
    """

    planes: Array
    count: IntArray
    reach: Array
    vertices: Array


def _cube() -> Array:
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    return np.column_stack((np.vstack((corners, corners)), np.repeat([0.0, 1.0], 4)))


def _irregular(rng: np.random.Generator) -> Array:
    """Return the vertices (n, 3) of a random boulder in unit axes.

    Its outline has the area of the unit disc.
    """
    angle = 2.0 * np.pi * (np.arange(_RING) + rng.uniform(-0.3, 0.3, _RING)) / _RING
    radius = rng.uniform(0.85, 1.15, _RING)
    ring = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.zeros(_RING)))
    turn = rng.uniform(0.0, 2.0 * np.pi, _DOME)
    g = rng.uniform(0.45, 1.0, _DOME)
    side = np.sqrt(1.0 - g**2) * rng.uniform(0.8, 1.15, _DOME)
    dome = np.column_stack((side * np.cos(turn), side * np.sin(turn), g))
    points = np.vstack((ring, dome))
    points[:, 2] /= points[:, 2].max()
    outline = ConvexHull(points[:, :2])
    points[:, :2] *= np.sqrt(np.pi / outline.volume)  # in 2D, `volume` is the area
    return np.asarray(points[ConvexHull(points).vertices], dtype=np.float64)


def _half_spaces(points: Array) -> Array:
    """Return the half spaces (n, 4), normal and offset, of a convex body.

    The body is the convex hull of `points` (k, 3), continued vertically downwards.
    """
    faces = np.unique(ConvexHull(points).equations.round(12), axis=0)
    upward = faces[faces[:, 2] > 1e-9]
    walls = np.unique(ConvexHull(points[:, :2]).equations.round(12), axis=0)
    walls = np.column_stack((walls[:, :2], np.zeros(len(walls)), walls[:, 2]))
    planes = np.vstack((upward, walls))
    planes[:, 3] *= -1.0  # Qhull's convention is n . q + offset <= 0
    return planes


@lru_cache(maxsize=1)
def shape_table() -> ShapeTable:
    """Return the table of unit shapes: hemisphere, cube, then 16 irregular boulders."""
    rng = np.random.default_rng(_SEED)
    bodies = [_cube(), *(_irregular(rng) for _ in range(IRREGULAR_COUNT))]
    spaces = [_half_spaces(body) for body in bodies]
    shapes = 1 + len(bodies)
    planes = np.zeros((shapes, max(map(len, spaces)), 4))
    vertices = np.full((shapes, max(map(len, bodies)), 3), np.nan)
    count = np.zeros(shapes, np.int64)
    reach = np.ones(shapes)
    for k, (body, space) in enumerate(zip(bodies, spaces, strict=True), start=1):
        planes[k, : len(space)] = space
        vertices[k, : len(body)] = body
        count[k] = len(space)
        reach[k] = np.hypot(body[:, 0], body[:, 1]).max()
    return ShapeTable(planes, count, reach, vertices)
