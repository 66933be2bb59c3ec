"""Triangle meshes of terrain, hazard map, rocks and lander for recordings."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunarsim.exports.world import grid_triangles
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.rocks.field import RockField
from lunarsim.typing import Array
from lunarsim.view.lander_shape import body_faces
from lunarsim.world.terrain import Heightfield, Terrain

# Maximum number of vertices along a side of the terrain, and of the area of a hazard map.
_TERRAIN_VERTICES, _MAP_VERTICES = 301, 201
# Only the largest rocks are drawn: smaller ones would only slow the viewer down.
_MAX_ROCKS = 4000
_ROCK_SIDES = 8


class Mesh(NamedTuple):
    """Triangle mesh in ENU or body axes.

    Attributes
    ----------
    vertices, normals
        Positions, m, and unit normals of the vertices (n, 3).
    triangles
        Indices of the vertices of each triangle (m, 3), anticlockwise as seen from outside.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.uint32]


def terrain_mesh(relief: Heightfield) -> Mesh:
    """Return the relief as a mesh of at most 301 x 301 grid points, without no-data."""
    g = relief.grid
    cols, rows = (
        np.unique(np.linspace(0, n - 1, min(n, _TERRAIN_VERTICES)).round().astype(np.int64))
        for n in (g.cols, g.rows)
    )
    return _grid_mesh(
        g.x0 + g.posting * cols, g.y0 + g.posting * rows, relief.z[np.ix_(rows, cols)]
    )


def map_mesh(relief: Heightfield, grid: Grid, offset: Array) -> tuple[Mesh, NDArray[np.float32]]:
    """Return the relief under a hazard map, and its texture coordinates (n, 2).

    The texture is an image of the cells with north at the top: (0, 0) is its upper left corner,
    and (1, 1) its lower right one.

    Parameters
    ----------
    relief
        True relief.
    grid
        Grid of the map, local frame.
    offset
        Local minus true coordinates of the map (3,), m.
    """
    west, east, south, north = grid.extent
    u, v = (np.linspace(0.0, 1.0, min(n + 1, _MAP_VERTICES)) for n in (grid.cols, grid.rows))
    x = west + u * (east - west) - offset[0]
    y = south + v * (north - south) - offset[1]
    points = np.stack(np.meshgrid(x, y), axis=-1)
    mesh = _grid_mesh(x, y, Terrain(relief).elevation(points))
    at = np.stack(np.meshgrid(u, 1.0 - v), axis=-1)
    return mesh, at.reshape(-1, 2).astype(np.float32)


def triangles_outside(mesh: Mesh, hole: Mesh) -> NDArray[np.uint32]:
    """Return the triangles (m, 3) of a mesh outside the rectangle of another."""
    low, high = hole.vertices[:, :2].min(axis=0), hole.vertices[:, :2].max(axis=0)
    xy = mesh.vertices[:, :2]
    inside = ((xy >= low) & (xy <= high)).all(axis=1)
    return np.asarray(mesh.triangles[~inside[mesh.triangles].all(axis=1)])


def rock_mesh(rocks: RockField) -> Mesh:
    """Return the 4,000 largest rocks as half ellipsoids of 25 vertices each.

    The exact shapes that `lunarsim.exports.world.rock_mesh` returns would take 10 MB for mixed
    rocks, and 48 MB for hemispheres, in place of 4 MB.
    """
    some = np.argsort(-rocks.a * rocks.b, kind="stable")[:_MAX_ROCKS]
    turn = 2.0 * np.pi * np.arange(_ROCK_SIDES) / _ROCK_SIDES
    rings = [(np.cos(e), np.sin(e)) for e in np.deg2rad([0.0, 30.0, 60.0])]
    unit = [[r * np.cos(t), r * np.sin(t), z] for r, z in rings for t in turn] + [[0.0, 0.0, 1.0]]
    shape, top = np.array(unit), len(unit) - 1
    triangles = []
    for ring in range(len(rings)):
        for k in range(_ROCK_SIDES):
            low, after = ring * _ROCK_SIDES + k, ring * _ROCK_SIDES + (k + 1) % _ROCK_SIDES
            if ring == len(rings) - 1:
                triangles.append([low, after, top])
                continue
            triangles += [[low, after, after + _ROCK_SIDES], [low, after + _ROCK_SIDES,
                                                             low + _ROCK_SIDES]]  # fmt: skip
    scale = np.column_stack((rocks.a, rocks.b, rocks.height))[some][:, None]
    yaw = rocks.yaw[some, None]
    centre = np.column_stack((rocks.x, rocks.y, rocks.base))[some][:, None]
    vertices = centre + _turned(shape * scale, yaw)
    normals = _turned(shape / scale, yaw)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    faces = np.array(triangles) + len(shape) * np.arange(len(some))[:, None, None]
    return _mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), faces.reshape(-1, 3))


def lander_mesh(lander: Lander) -> Mesh:
    """Return the body of a lander in body axes; each face has its own vertices."""
    vertices, normals, triangles, first = [], [], [], 0
    for face in body_faces(lander):
        normal = np.cross(face[1] - face[0], face[2] - face[1])
        vertices.append(face)
        normals.append(np.tile(normal / np.linalg.norm(normal), (len(face), 1)))
        triangles += [[first, first + k, first + k + 1] for k in range(1, len(face) - 1)]
        first += len(face)
    return _mesh(np.vstack(vertices), np.vstack(normals), np.array(triangles))


def _mesh(vertices: NDArray[Any], normals: NDArray[Any], triangles: NDArray[Any]) -> Mesh:
    return Mesh(
        vertices.astype(np.float32), normals.astype(np.float32), triangles.astype(np.uint32)
    )


def _turned(points: Array, yaw: Array) -> Array:
    """Rotate points (n, k, 3) counterclockwise about up by angles (n, 1), rad."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack((c * x - s * y, s * x + c * y, z + 0.0 * c), axis=-1)


def _grid_mesh(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> Mesh:
    """Return elevations (rows, cols) at coordinates (cols,) and (rows,) as a mesh, m.

    Triangles with an unknown elevation are omitted.
    """
    known = np.isfinite(z)
    filled = np.where(known, z, np.nanmean(z) if known.any() else 0.0)
    slope_y, slope_x = np.gradient(filled.astype(np.float64), y, x)
    normals = np.stack((-slope_x, -slope_y, np.ones_like(slope_x)), axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    triangles = grid_triangles(known)
    vertices = np.stack((*np.meshgrid(x, y), filled), axis=-1)
    return _mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), triangles)
