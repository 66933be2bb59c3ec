"""Generated terrain with its rocks as an elevation raster or as a mesh."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError, missing_package
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.frames_and_times import ExportFrame, moon_frame
from lunarsim.exports.geotiff import write_geotiff
from lunarsim.grid import Grid
from lunarsim.rocks.field import RockField
from lunarsim.rocks.shapes import shape_table
from lunarsim.simulation import Flight
from lunarsim.simulation.worlds import rebuild_world
from lunarsim.typing import Array, IntArray
from lunarsim.world.terrain import Terrain

if TYPE_CHECKING:
    import trimesh

# Maximum number of grid points of an exported terrain: 100 MB as a raster, 600 MB as a mesh.
MAX_POINTS = 25_000_000
# Rings and points per ring of the triangulation of a hemisphere.
_RINGS, _RING_POINTS = 4, 16
# Depth below its base to which a rock continues, in units of its height, so that no gap is visible.
_FOOT_DEPTH = 1.0
# Rotation from ENU (z up) to the axes of glTF (y up): x east, y up, z south.
_GLTF_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def write_flight_world(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write the true terrain of a flight as raster or mesh.

    The terrain is generated again from scenario and seed. The suffix of `out` selects GeoTIFF or
    mesh, as in `write_world`. The options have no effect.
    """
    write_world(rebuild_world(flight).terrain, out, frame=moon_frame(flight, None))


def write_world(
    terrain: Terrain, out: Path, posting: float | None = None, *, has_rocks: bool = True,
    frame: ExportFrame | None = None,
) -> int:  # fmt: skip
    """Write terrain as GeoTIFF (.tif), or as a mesh in PLY or binary glTF (.glb).

    Return the number of grid points of the terrain.

    Parameters
    ----------
    terrain
        Terrain with rocks, site frame.
    out
        File to write.
    posting
        Spacing of the grid points, m; None: that of the terrain, without interpolation.
    has_rocks
        Whether the file contains the rocks.
    frame
        Frame fixed to the Moon, which gives a GeoTIFF its place; None: a local reference system.

    Raises
    ------
    InputError
        If the grid has fewer than 2 x 2 or more than 25 million points, or the package of the extra
        `mesh` is missing.
    """
    terrain = terrain if has_rocks else Terrain(terrain.relief)
    grid = _grid(terrain, posting)
    if out.suffix.lower() == ".tif":
        label = ("elevation above the origin of the site frame", "m")
        write_geotiff(out, {label: terrain.raster(grid)}, grid, frame)
    else:
        if find_spec("trimesh") is None:
            raise missing_package("--format", "trimesh", "mesh")
        _write_mesh(terrain, grid, out)
    return grid.rows * grid.cols


def _grid(terrain: Terrain, posting: float | None) -> Grid:
    """Return the grid of the file, from the south-west corner of the terrain."""
    own = terrain.relief.grid
    if posting is None:
        found = own
    else:
        if not (np.isfinite(posting) and posting > 0.0):
            raise InputError("--posting", posting, "must be positive and finite")
        west, east, south, north = terrain.bounds
        sides = np.floor([(north - south) / posting + 1e-9, (east - west) / posting + 1e-9]) + 1.0
        if sides.max() > MAX_POINTS or sides.prod() > MAX_POINTS or sides.min() < 2.0:
            raise InputError(
                "--posting", posting, f"must give at least 2 x 2 and at most {MAX_POINTS} points"
            )
        found = Grid(own.x0, own.y0, posting, int(sides[0]), int(sides[1]))
    if found.rows * found.cols > MAX_POINTS:
        raise InputError(
            "--posting", posting or own.posting, f"must give at most {MAX_POINTS} points",
            "Use a larger --posting.",
        )  # fmt: skip
    return found


def _write_mesh(terrain: Terrain, grid: Grid, out: Path) -> None:
    """Write the relief and the rocks as meshes, in one file."""
    import trimesh  # noqa: PLC0415  (optional package)

    def mesh(vertices: Array, faces: IntArray, grey: int) -> trimesh.Trimesh:
        colours = np.tile(np.array([grey, grey, grey, 255], np.uint8), (len(vertices), 1))
        return trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)

    relief = terrain.relief
    # Interpolation would widen gaps in the relief.
    elevation = relief.z if grid == relief.grid else Terrain(relief).raster(grid)
    parts = {"terrain": mesh(*relief_mesh(elevation, grid), 150)}
    if len(terrain.rocks):
        parts["rocks"] = mesh(*rock_mesh(terrain.rocks), 110)
    if out.suffix.lower() == ".ply":
        data = trimesh.util.concatenate(list(parts.values())).export(None, file_type="ply")
    else:
        scene = trimesh.Scene()
        for name, part in parts.items():
            part.vertices = part.vertices @ _GLTF_AXES.T
            scene.add_geometry(part, node_name=name, geom_name=name)
        data = scene.export(None, file_type="glb")
    atomic_write(out, lambda part: part.write_bytes(data))


def relief_mesh(elevation: NDArray[np.float32], grid: Grid) -> tuple[Array, IntArray]:
    """Return vertices (n, 3), m, and triangles (m, 3) of a relief (rows, cols).

    The triangles are those of the simulated terrain: the diagonal of a grid square runs from
    south-west to north-east. Squares with an unknown corner are omitted; the vertices there have
    the elevation 0. The triangles are anticlockwise from above.
    """
    known = np.isfinite(elevation)
    xy = grid.centres()
    vertices = np.dstack((xy, np.where(known, elevation, 0.0))).reshape(-1, 3)
    return vertices.astype(np.float64), grid_triangles(known)


def grid_triangles(known: NDArray[np.bool_]) -> IntArray:
    """Return the triangles (m, 3) between points of a grid, as flat indices.

    Squares with a point that is not `known` (rows, cols), row 0 south, are omitted. The diagonal of
    a square runs from south-west to north-east; the triangles are anticlockwise from above.
    """
    index = np.arange(known.size).reshape(known.shape)
    sw, se, nw, ne = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    kept = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    return np.concatenate(
        [np.column_stack([c[kept] for c in corners]) for corners in ((sw, se, ne), (sw, ne, nw))]
    )


def rock_mesh(rocks: RockField) -> tuple[Array, IntArray]:
    """Return vertices (n, 3), m, and triangles (m, 3) of rocks, open below.

    Hemispheres are polyhedra that lie inside the rock; the other shapes are exact. The sides
    continue below the base, as the simulated rocks do.
    """
    all_vertices, all_faces, count = [], [], 0
    for shape in np.unique(rocks.shape):
        unit, faces = _unit_mesh(int(shape))
        these = np.flatnonzero(rocks.shape == shape)
        x, y, base, a, b, height, yaw = (
            getattr(rocks, name)[these, None]
            for name in ("x", "y", "base", "a", "b", "height", "yaw")
        )
        along, across = a * unit[:, 0], b * unit[:, 1]
        c, s = np.cos(yaw), np.sin(yaw)
        vertices = np.dstack(
            (x + c * along - s * across, y + s * along + c * across, base + height * unit[:, 2])
        )
        offsets = count + len(unit) * np.arange(len(these))
        all_vertices.append(vertices.reshape(-1, 3))
        all_faces.append((faces + offsets[:, None, None]).reshape(-1, 3))
        count += len(unit) * len(these)
    return np.concatenate(all_vertices), np.concatenate(all_faces)


def _unit_mesh(shape: int) -> tuple[Array, IntArray]:
    """Return vertices (n, 3) and triangles (m, 3) of a row of `shape_table`."""
    if shape == 0:
        around = 2.0 * np.pi * np.arange(_RING_POINTS) / _RING_POINTS
        up = 0.5 * np.pi * np.arange(_RINGS) / _RINGS
        rings = [
            np.column_stack((np.cos(e) * np.cos(around), np.cos(e) * np.sin(around),
                             np.full(_RING_POINTS, np.sin(e))))
            for e in up
        ]  # fmt: skip
        points = np.vstack((*rings, [[0.0, 0.0, 1.0]]))
    else:
        points = shape_table().vertices[shape]
        points = points[np.isfinite(points).all(axis=1)]
    outline = points[ConvexHull(points[:, :2]).vertices]
    foot = outline * [1.0, 1.0, 0.0] - [0.0, 0.0, _FOOT_DEPTH]
    points = np.vstack((points, foot))
    hull = ConvexHull(points)
    faces = _outward(points, hull)
    return points, faces[hull.equations[:, 2] > -1.0 + 1e-9]


def _outward(points: Array, hull: ConvexHull) -> IntArray:
    """Return the triangles of a hull (m, 3), anticlockwise from outside."""
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces = hull.simplices.astype(np.int64)
    faces[turned] = faces[turned][:, [0, 2, 1]]
    return np.asarray(faces)
