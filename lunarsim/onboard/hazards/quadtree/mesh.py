"""Triangular mesh of coarse cells: local terrain plane at any point (Eqs. 1-3)."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.hazards.quadtree import _site_kernels as k
from lunarsim.onboard.hazards.quadtree._sum_kernels import moments
from lunarsim.onboard.hazards.quadtree.tree import Nodes, QuadtreeMap
from lunarsim.triangulation._insertion_kernels import hilbert_keys, insert_all
from lunarsim.typing import Array, IntArray


class TerrainMesh:
    """Triangular mesh of the terrain through the mean points of coarse quadtree cells.

    The vertices are the centres of the smallest cells within a band of sizes. A cell is a vertex if
    each of its quarters has enough points, because the mean elevation of a cell observed on one
    side only would be the elevation of its edge. For cocircular vertices, the triangulation depends
    on the vertices only, not on the order in which they were found.

    Parameters
    ----------
    quadtree
        Map of the points.
    smallest, largest
        Sides of the smallest and largest cells that may be vertices, m.
    density
        Minimum number of points per square metre in each quarter of a cell.
    """

    def __init__(
        self, quadtree: QuadtreeMap, smallest: float, largest: float, density: float
    ) -> None:
        self._map = quadtree
        self._band = (smallest, largest)
        self._density = density
        self._bits = quadtree.depths + 1
        # Buckets have the size of the largest cells, so that a triangle touches few of them.
        self._bucket = 2 << (quadtree.depths - quadtree.depth_of(largest))
        self._wide = (2 << quadtree.depths) // self._bucket
        self.nodes: Nodes = np.zeros(0, np.int32)
        self.xy: IntArray = np.zeros((0, 2), np.int64)
        self.z: Array = np.zeros(0)
        self.triangles: IntArray = np.zeros((0, 3), np.int64)
        self.normals: Array = np.zeros((0, 3))
        self._index()

    def update(self, since: int) -> IntArray:
        """Update the mesh with new points; return outlines (n, 4) of changed triangles.

        `since` is the version of the map at the last update. Changed triangles are those that were
        added or removed, or whose vertices changed in height. Outlines are west, east, south and
        north, in half sides of the smallest cells. Without new points, nothing changes.
        """
        if not len(self._map.band(*self._band, since=since)):
            return np.zeros((0, 4), np.int64)
        tree = self._map.tree
        nodes = self._map.band(*self._band)
        nodes = nodes[k.is_mesh_node(tree, nodes, self._density)]
        nodes = np.sort(nodes)
        z = np.asarray(moments(tree, np.asarray(nodes, np.int64))[:, 1])
        nodes, z = nodes[np.isfinite(z)], z[np.isfinite(z)]
        before = (self.nodes, self.xy, self.z, self.triangles)
        if not np.array_equal(nodes, self.nodes):
            self.xy = self._half_steps(nodes)
            self.triangles = self._triangulate()
            self.nodes = nodes
        self.z = z
        metre = self._map.min_cell_size / 2.0
        x, y = metre * self.xy[:, 0], metre * self.xy[:, 1]
        self.normals = k.normals(x, y, z, self.triangles)
        self._index()
        return self._changed_outlines(*before)

    def normals_of(self, nodes: Nodes) -> Array:
        """Return the unit normals (n, 3) of the terrain at cell centres; NaN off the mesh.

        `nodes` (n,) are the indices of the cells.
        """
        x, y = np.ascontiguousarray(self._half_steps(nodes).T)
        return np.asarray(k.normals_at(x, y, self.arrays))

    def _half_steps(self, nodes: Nodes) -> IntArray:
        """Return the centres (n, 2) of cells `nodes` in half sides of the smallest cells."""
        tree = self._map.tree
        size = 1 << (tree.depths - tree.depth[nodes].astype(np.int64))
        place = np.stack((tree.column[nodes], tree.row[nodes]), axis=-1).astype(np.int64)
        return np.asarray((2 * place + 1) * size[:, None])

    def _triangulate(self) -> IntArray:
        """Return the triangles (t, 3) of the vertices, as indices into `xy`.

        They do not depend on the order of the vertices; there are none for fewer than three.
        """
        if len(self.xy) < 3:
            return np.zeros((0, 3), np.int64)
        order = np.argsort(hilbert_keys(self.xy, self._bits), kind="stable")
        return np.asarray(insert_all(self.xy, order), dtype=np.int64)

    def _index(self) -> None:
        """Build the spatial index of the triangles and collect the arrays for kernels."""
        px, py = np.ascontiguousarray(self.xy.T)
        start, index = k.list_triangles(px, py, self.triangles, self._bucket, self._wide)
        self.arrays = (
            px, py, self.z, self.triangles, self.normals, self._bucket, self._wide, start, index,
        )  # fmt: skip

    def _changed_outlines(
        self, nodes: Nodes, xy: IntArray, z: Array, triangles: IntArray
    ) -> IntArray:
        """Return the outlines (n, 4) of triangles that differ between old and new mesh.

        These are removed triangles, added triangles, and triangles with a vertex whose height has
        changed. `nodes`, `xy`, `z` and `triangles` describe the old mesh.
        """
        all_nodes = np.union1d(nodes, self.nodes)
        old = _triangle_keys(np.searchsorted(all_nodes, nodes), triangles, len(all_nodes))
        new = _triangle_keys(np.searchsorted(all_nodes, self.nodes), self.triangles, len(all_nodes))
        removed = ~np.isin(old, new)
        added = ~np.isin(new, old)
        height = np.full(len(all_nodes), np.nan)
        height[np.searchsorted(all_nodes, nodes)] = z
        moved = height[np.searchsorted(all_nodes, self.nodes)] != self.z
        added |= moved[self.triangles].any(axis=1)
        return np.concatenate(
            (_outlines(xy, triangles[removed]), _outlines(self.xy, self.triangles[added]))
        )


def _triangle_keys(index: IntArray, triangles: IntArray, count: int) -> IntArray:
    """Return an integer per triangle that does not depend on the order of its corners.

    `index` (n,) maps vertices to numbers below `count`; `triangles` (m, 3) are indices of vertices.
    """
    corners = np.sort(index[triangles], axis=1)
    return np.asarray((corners[:, 0] * count + corners[:, 1]) * count + corners[:, 2])


def _outlines(xy: IntArray, triangles: IntArray) -> IntArray:
    """Return west, east, south and north limits of triangles (m, 4).

    `xy` (n, 2) are the vertices, in half sides of the smallest cells like the result, and
    `triangles` (m, 3) their indices.
    """
    corners = xy[triangles]
    low, high = corners.min(axis=1, initial=2**40), corners.max(axis=1, initial=-1)
    return np.stack((low[:, 0], high[:, 0], low[:, 1], high[:, 1]), axis=-1).reshape(-1, 4)
