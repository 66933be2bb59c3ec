"""Variable-resolution map: a quadtree of measured points (paper, section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.quadtree import _insertion_kernels, _sum_kernels
from lunarsim.onboard.hazards.quadtree import _tree_kernels as k
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import as_real_array, check_elements, check_finite

Nodes = NDArray[np.int32]

# float32 coordinates resolve 1/16,777,216 of the side; deeper trees would fall below it.
_MAX_DEPTH = 16
# Maximum height from the elevation of the map, m: float32 resolves 1 mm there.
_MAX_HEIGHT_M = 10_000.0
# Maximum number of parts in which a batch is sorted, and minimum size of a part. Sorting then takes
# little time, and points that came together remain together.
_MAX_SORT_PARTS, _MIN_SORT_PART_POINTS = 8, 1 << 18


@dataclass(frozen=True)
class InsertionCounts:
    """Numbers of points of a batch that were added to or rejected by the quadtree.

    Attributes
    ----------
    added, outside, missing
        Points added, points off the map (laterally, or by more than 10 km in height), and points
        with a NaN coordinate.
    """

    added: int
    outside: int
    missing: int


class QuadtreeMap:
    """Square quadtree map of measured points, refined where measurements are dense.

    A cell with `split_count` points or more has four children, down to the minimum cell size. Sums
    for mean and variance of the elevation are kept at every level. Every cell records the last
    batch that reached it, so that users of the map can query changes. Outliers, which are separated
    in height from all other points of their cell (a return from a bird), remain on the map and are
    counted, but are excluded from all sums.

    Parameters
    ----------
    centre
        Centre of the square (2,) or (3,), ENU, m. The third component is the internal reference of
        heights, so that float32 resolves them.
    side
        Minimum side of the square, m; it is increased to a power of two times `min_cell_size`.
    min_cell_size
        Side of the smallest cells, m.
    split_count
        Number of points at which a cell splits.
    """

    def __init__(
        self, centre: ArrayLike, side: float, min_cell_size: float = 0.1, *, split_count: int = 8
    ) -> None:
        if not (np.isfinite(min_cell_size) and min_cell_size > 0.0):
            raise InputError(
                "quadtree.min_cell_size_m", min_cell_size, "must be positive and finite"
            )
        if not (np.isfinite(side) and side >= min_cell_size):
            raise InputError(
                "quadtree.side_m", side,
                f"must be finite and at least min_cell_size, which is {min_cell_size:g} m",
            )  # fmt: skip
        if split_count < 2:
            raise InputError("quadtree.split_count", split_count, "must be 2 or more")
        depths = max(1, int(np.ceil(np.log2(side / min_cell_size) - 1e-9)))
        if depths > _MAX_DEPTH:
            raise InputError(
                "quadtree.min_cell_size_m",
                min_cell_size,
                f"must be at least {side / 2**_MAX_DEPTH:g} m for a map side of {side:g} m",
            )
        centre_enu = np.zeros(3)
        given = np.asarray(centre, dtype=np.float64)
        centre_enu[: given.size] = given
        check_finite("quadtree.centre", centre_enu)
        self.centre = centre_enu
        self.min_cell_size = float(min_cell_size)
        self.depths = depths
        self.side = min_cell_size * 2.0**depths
        self.split_count = int(split_count)
        self.version = 0
        self._points = 0
        self._used = (1, 0, 0)
        capacity = 1024
        self.tree = k.Tree(
            0.5 * self.side,
            depths,
            np.empty((0, 3), np.float32),
            np.empty(0, np.bool_),
            np.full(capacity, -1, np.int32),
            np.zeros(capacity, np.int8),
            np.zeros(capacity, np.uint16),
            np.zeros(capacity, np.uint16),
            np.zeros(capacity, np.int32),
            np.zeros(capacity, np.int32),
            np.full(capacity, -1, np.int32),
            np.full(capacity, -1, np.int32),
            np.empty((capacity, _sum_kernels.SUMS)),
            *(np.empty(capacity, np.int32) for _ in range(3)),
        )

    # --- insertion ------------------------------------------------------------------------

    def insert(self, points: ArrayLike) -> InsertionCounts:
        """Add points (n, 3), ENU, m; return how many were added and rejected.

        Points off the map or with NaN are rejected.

        Raises
        ------
        InputError
            If the array has another shape or contains an infinity, or if most points over the map
            are farther than 10 km from its elevation, which is then wrong.
        """
        points = _check_points(points)
        added = outside = missing = high = 0
        part = max(_MIN_SORT_PART_POINTS, -(-len(points) // _MAX_SORT_PARTS))
        for first in range(0, len(points), part):
            xyz, key, *left_out = _insertion_kernels.sort_points(
                points[first : first + part],
                self.centre,
                self.tree.half,
                self.depths,
                _MAX_HEIGHT_M,
            )
            outside, missing, high = (
                a + b for a, b in zip((outside, missing, high), left_out, strict=True)
            )
            if left_out[2] > len(xyz):
                raise InputError(
                    "quadtree.points", points,
                    f"most heights must be within {_MAX_HEIGHT_M:g} m of the map elevation, "
                    f"{self.centre[2]:g} m, but {left_out[2]} of {left_out[2] + len(xyz)} are not",
                    "Correct the map elevation.", show_value=False,
                )  # fmt: skip
            self._insert_sorted(xyz, key)
            added += len(xyz)
        return InsertionCounts(added, int(outside + high), int(missing))

    def _insert_sorted(self, xyz: NDArray[np.float32], key: NDArray[np.uint32]) -> None:
        """Insert points (n, 3) sorted by their Z-order keys (n,)."""
        base = self._points
        if not len(xyz):
            return
        self._reserve(points=base + len(xyz))
        self.tree.xyz[base : base + len(xyz)] = xyz
        self._points += len(xyz)
        at = 0
        while True:
            self.version += 1
            at, *used = _insertion_kernels.insert(
                self.tree, key, base, at, self._used, self.split_count, self.version
            )
            self._used = (used[0], used[1], used[2])
            if at == len(key):
                break
            self._reserve(
                nodes=len(self.tree.child) * 3 // 2 + 65_536,
                runs=len(self.tree.start) * 3 // 2 + 65_536,
                sums=len(self.tree.sums) * 3 // 2 + 16_384,
            )

    def _reserve(self, *, points: int = 0, nodes: int = 0, runs: int = 0, sums: int = 0) -> None:
        """Enlarge the arrays of the tree to hold the given numbers of entries.

        The point arrays grow by at least half to limit copying.
        """
        t = self.tree
        if points > len(t.xyz):
            t = _enlarge_arrays(t, _POINT_ARRAYS, max(points, len(t.xyz) * 3 // 2), self._points)
        if nodes > len(t.child):
            t = _enlarge_arrays(t, _NODE_ARRAYS, nodes, self._used[0])
        if runs > len(t.start):
            t = _enlarge_arrays(t, _RUN_ARRAYS, runs, self._used[1])
        if sums > len(t.sums):
            t = _enlarge_arrays(t, ("sums",), sums, self._used[2])
        self.tree = t

    # --- size -----------------------------------------------------------------------------

    @property
    def count(self) -> int:
        """Number of points in the map."""
        return self._points

    @property
    def cell_count(self) -> int:
        """Number of cells of all sizes in the tree."""
        return self._used[0]

    @property
    def nbytes(self) -> int:
        """Memory in use, bytes; the arrays reserve up to half as much again."""
        used = zip(
            (_POINT_ARRAYS, _NODE_ARRAYS, _RUN_ARRAYS, ("sums",)),
            (self._points, *self._used),
            strict=True,
        )
        return sum(
            n * int(getattr(self.tree, name)[:1].nbytes) for names, n in used for name in names
        )

    @property
    def points(self) -> Array:
        """All points in order of their batches, sorted within a batch (n, 3), ENU, m."""
        return np.asarray(self.tree.xyz[: self._points] + self.centre)

    # --- cells ----------------------------------------------------------------------------

    def depth_of(self, size: float) -> int:
        """Return the depth in the tree of the largest cells not larger than `size` (m)."""
        return int(np.clip(np.ceil(np.log2(self.side / size) - 1e-9), 0, self.depths))

    def band(self, smallest: float, largest: float, *, since: int = 0) -> Nodes:
        """Return the smallest cells within a band of sizes (Figure 3 of the paper).

        The cells are returned as indices (n,) in Z-order. They do not overlap: at each place it is
        the smallest cell of the band that exists. Empty cells are omitted, and so are places whose
        smallest cell is larger than the band.

        Parameters
        ----------
        smallest, largest
            Sides of the smallest and largest cells, m.
        since
            Return only cells that got points after this version of the map.
        """
        low, high = self.depth_of(smallest), self.depth_of(largest)
        return np.asarray(k.band(self.tree, low, high, since))

    def cell_at(self, xy: ArrayLike, smallest: float = 0.0, largest: float = np.inf) -> int:
        """Return the index of the smallest cell at a point (2,), m, within a size band.

        `smallest` and `largest` are the limits of the cell side, m. The result is -1 if there is
        none. `xy` is in ENU.
        """
        low = self.depth_of(smallest) if smallest > 0.0 else self.depths
        high = self.depth_of(largest) if np.isfinite(largest) else 0
        x, y = np.asarray(xy, dtype=np.float64)[:2] - self.centre[:2]
        return int(k.node_at(self.tree, x, y, low, high))

    def points_in(self, west: float, east: float, south: float, north: float) -> Array:
        """Return the points (n, 3) in a closed rectangle, ENU, m."""
        cx, cy = self.centre[:2]
        index = k.points_in(self.tree, west - cx, east - cx, south - cy, north - cy)
        return np.asarray(self.tree.xyz[index] + self.centre)

    def centres(self, nodes: Nodes) -> Array:
        """Return the centres (n, 2) of cells, ENU, m, from their indices `nodes` (n,)."""
        size = self.sizes(nodes)
        t = self.tree
        east = (t.column[nodes] + 0.5) * size - t.half
        north = (t.row[nodes] + 0.5) * size - t.half
        return np.stack((east, north), axis=-1) + self.centre[:2]

    def sizes(self, nodes: Nodes) -> Array:
        """Return the sides of cells (n,), m, from their indices `nodes` (n,)."""
        return np.asarray(self.side / 2.0 ** self.tree.depth[nodes])

    def point_counts(self, nodes: Nodes) -> NDArray[np.int32]:
        """Return the number of points in cells (n,), from their indices `nodes` (n,)."""
        return np.asarray(self.tree.count[nodes])

    def elevation(self, nodes: Nodes) -> Array:
        """Return the mean elevation of cells (n,), m, without outliers; NaN if empty.

        `nodes` (n,) are the indices of the cells.
        """
        return np.asarray(self._moments(nodes)[:, 1] + self.centre[2])

    def variance(self, nodes: Nodes) -> Array:
        """Return the variance of the elevations in cells (n,), m^2; NaN if empty.

        `nodes` (n,) are the indices of the cells. Outliers are excluded.
        """
        return np.asarray(self._moments(nodes)[:, 2])

    def _moments(self, nodes: Nodes) -> Array:
        """Return number, mean and variance of the heights in cells (n, 3), m and m^2."""
        return np.asarray(_sum_kernels.moments(self.tree, np.asarray(nodes, np.int64)))

    @property
    def is_outlier(self) -> BoolArray:
        """Which points are outliers in height (n,), in the order of `points`."""
        return np.asarray(self.tree.is_outlier[: self._points].copy())


_POINT_ARRAYS = ("xyz", "is_outlier")
_NODE_ARRAYS = ("child", "depth", "column", "row", "count", "stamp", "head", "slot")
_RUN_ARRAYS = ("start", "length", "following")


def _check_points(points: ArrayLike) -> Array:
    """Return points as an array (n, 3); raise InputError if they are invalid."""
    array = np.ascontiguousarray(as_real_array("quadtree.points", points))
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(
            "quadtree.points", array.shape, "must have shape (n, 3), with columns east, north, up"
        )
    check_elements(
        "quadtree.points", array, ~np.isinf(array), "must not be infinite",
        "Use NaN for a missing point.",
    )  # fmt: skip
    return array


def _enlarge_arrays(tree: k.Tree, names: tuple[str, ...], size: int, used: int) -> k.Tree:
    """Return the tree with the arrays `names` enlarged to `size` entries.

    The first `used` entries are kept.
    """
    arrays: dict[str, Any] = {name: _enlarge(getattr(tree, name), size, used) for name in names}
    return tree._replace(**arrays)


def _enlarge(array: NDArray[np.generic], size: int, used: int) -> NDArray[np.generic]:
    """Return an array with `size` entries, of which the first `used` are copied."""
    out = np.empty((size, *array.shape[1:]), array.dtype)
    out[:used] = array[:used]
    return out
