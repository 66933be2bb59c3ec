"""The lander's footprint as exact sets of cells.

Legs are rounded to cells; a heading matters only through the cells its legs fall in, so the
continuum of headings is a finite list. The conservative test's guarantee (Proposition III.1 of
the Gaussian DEM paper) then holds exactly on the grid: the sets below contain whatever the exact
test looks at.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lunarsim.vehicle.lander import Lander

IntArray = NDArray[np.int64]


BLOCK = 4  # side of the blocks of cells that the exact test opens or skips, cells
_FORBIDDEN = np.float32(-1e30)
_LANES = 16  # float32 numbers in the widest SIMD vector


@dataclass(frozen=True)
class PlaneTables:
    """What the exact test needs of a footprint, a lane for every heading and support plane.

    Attributes
    ----------
    legs
        Cells of the legs for every heading, padded to whole SIMD vectors (headings, legs, 2).
    inverse
        For plane s and diagonal d the inverse of the matrix of the triangle's edges
        (planes, diagonals, 4, headings).
    place
        Row and column of the triangle's first leg (planes, diagonals, 2, headings).
    windows
        Blocks that cover the footprint: row, column, first and last entry of `cells` (n, 4).
    window_allowed
        0 where a lane's polygon touches the block, else far below any ground (n, lanes).
    cells
        Cells (row, column) of all blocks (m, 2).
    cell_allowed
        0 where a lane's polygon holds the cell, else far below any ground (m, lanes).
    """

    legs: IntArray
    inverse: NDArray[np.float32]
    place: NDArray[np.float32]
    windows: IntArray
    window_allowed: NDArray[np.float32]
    cells: IntArray
    cell_allowed: NDArray[np.float32]

    def offsets(self, cols: int) -> tuple[NDArray[np.uint64], int]:
        """Return the legs' places in a flat raster (legs, headings) above the lowest, and it."""
        flat = self.legs[..., 0] * cols + self.legs[..., 1]
        lowest = int(flat.min())
        return np.ascontiguousarray((flat - lowest).T.astype(np.uint64)), lowest


@dataclass(frozen=True)
class Footprint:
    """Cells that a lander touches or covers, relative to the cell of its centre.

    Offsets are (row, column): rows to the north, columns to the east.

    Attributes
    ----------
    legs
        Cells of the legs, counter-clockwise, for every distinct heading (headings, legs, 2).
    pad
        Cells under one pad (n, 2).
    pad_windows, leg_windows, body_windows
        One pad, the set L (all that any pad touches) and the set U (all that any polygon
        covers) as unions of windows ``(row, level, first column, first column)`` (n, 4): two
        windows of 2**level columns each; n is a multiple of four.
    depth
        Number of window levels.
    least_height
        h0: least height of any triangle of legs, m.
    reach
        Largest offset in any direction, cells.
    planes
        Tables of the exact test.
    """

    legs: IntArray
    pad: IntArray
    pad_windows: IntArray
    leg_windows: IntArray
    body_windows: IntArray
    depth: int
    least_height: float
    reach: int
    planes: PlaneTables

    def nearest_heading(self, lander: Lander, posting: float, heading: float) -> int:
        """Return the index of the distinct heading nearest to an azimuth of body x (rad)."""
        pads = lander.pads[:, :2]
        turn = np.pi / 2 - heading  # azimuth to angle from east
        c, s = np.cos(turn), np.sin(turn)
        east = (c * pads[:, 0] - s * pads[:, 1]) / posting
        north = (s * pads[:, 0] + c * pads[:, 1]) / posting
        wanted = np.column_stack((north, east))
        misfit = [
            min(float(np.abs(np.roll(cells, n, axis=0) - wanted).sum()) for n in range(lander.legs))
            for cells in self.legs
        ]
        return int(np.argmin(misfit))

    def block_cells(self, side: float, posting: float) -> int:
        """Return the side of blocks of about `side` metres in cells.

        Raises
        ------
        ValueError
            If the side is not positive.
        """
        if not (np.isfinite(side) and side > 0.0):
            raise ValueError(f"block_side = {side}: must be a positive length in metres")
        return max(1, min(round(side / posting), self.reach))

    def covers(self, block: int) -> tuple[IntArray, IntArray]:
        """Return blocks of cells that cover the polygon of every heading.

        Parameters
        ----------
        block
            Side of a block, cells.

        Returns
        -------
        corners
            South-west cells (row, column) of the blocks (n, 2), heading by heading.
        first
            Where each heading's blocks begin (headings + 1,); multiples of four.
        """
        corners: list[tuple[int, int]] = []
        first = [0]
        for polygon in self.legs:
            runs = np.array(_polygon_runs(polygon))
            lowest, highest = int(runs[0, 0]), int(runs[-1, 0])
            for start in range(lowest, highest + 1, block):
                # The last band ends at the last row, so that no block leaves the footprint.
                row = min(start, max(highest - block + 1, lowest))
                band = runs[(runs[:, 0] >= row) & (runs[:, 0] < row + block)]
                low, high = int(band[:, 1].min()), int((band[:, 1] + band[:, 2]).max())
                columns = list(range(low, max(high - block, low) + 1, block))
                if columns[-1] + block < high:
                    columns.append(high - block)
                corners += [(row, col) for col in columns]
            corners += [corners[-1]] * (-len(corners) % 4)
            first.append(len(corners))
        return np.array(corners, dtype=np.int64), np.array(first, dtype=np.int64)

    def one_heading(self, index: int) -> PlaneTables:
        """Return the tables of the exact test for a single heading."""
        return _plane_tables(self.legs[index : index + 1], self.reach)


def _leg_cells(legs: int, radius: float, heading: float) -> IntArray:
    angle = heading + 2.0 * np.pi * np.arange(legs) / legs
    # A hair outwards, then half-way cases round away from the centre at every heading alike.
    xy = radius * (1.0 + 1e-12) * np.column_stack((np.sin(angle), np.cos(angle)))
    return np.asarray(np.sign(xy) * np.floor(np.abs(xy) + 0.5), dtype=np.int64)


def _distinct_headings(legs: int, radius: float) -> IntArray:
    """Return the leg cells of every distinct heading (headings, legs, 2); radius in cells."""
    turn = 2.0 * np.pi / legs
    halves = np.arange(int(np.ceil(radius)) + 1) + 0.5
    halves = halves[halves <= radius] / radius
    crossings = np.concatenate((np.arcsin(halves), np.arccos(halves)))
    crossings = np.concatenate([s * crossings + k * np.pi for s in (1, -1) for k in range(3)])
    breaks = np.unique(np.round(np.mod(crossings, turn), 12))
    breaks = np.concatenate((breaks, [breaks[0] + turn])) if breaks.size else np.array([0.0, turn])
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    cells = np.stack([_leg_cells(legs, radius, heading) for heading in middles])
    return np.unique(cells, axis=0)


def _polygon_runs(polygon: IntArray) -> list[tuple[int, int, int]]:
    """Return the runs (row, first column, length) of the cells in or on a convex polygon."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    rows, cols = np.meshgrid(
        np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1), indexing="ij"
    )
    inside = np.ones(rows.shape, dtype=np.bool_)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        # Counter-clockwise in (east, north) = (column, row): the inside is on the left.
        inside &= (b[1] - a[1]) * (rows - a[0]) - (b[0] - a[0]) * (cols - a[1]) >= 0
    return _runs_of(inside, int(low[0]), int(low[1]))


def _runs_of(mask: NDArray[np.bool_], row0: int, col0: int) -> list[tuple[int, int, int]]:
    runs = []
    for i, line in enumerate(mask):
        edges = np.flatnonzero(np.diff(np.concatenate(([0], line.astype(np.int8), [0]))))
        runs += [(row0 + i, col0 + int(a), int(b - a)) for a, b in edges.reshape(-1, 2)]
    return runs


def _windows(mask: NDArray[np.bool_], row0: int, col0: int) -> IntArray:
    """Return a set of cells as windows whose widths are powers of two."""
    windows = []
    for row, col, length in _runs_of(mask, row0, col0):
        level = int(length).bit_length() - 1
        windows.append((row, level, col, col + length - 2**level))
    windows += [windows[-1]] * (-len(windows) % 4)
    return np.array(windows, dtype=np.int64)


# The legs of plane s on diagonal d: s = 0 stands on a b c or a b d, s = 1 on a c d or b c d.
_TRIANGLES = {3: (((0, 1, 2),),), 4: (((0, 1, 2), (0, 1, 3)), ((0, 2, 3), (1, 2, 3)))}


def _plane_tables(cells: IntArray, reach: int) -> PlaneTables:
    """Return the tables for a list of headings (headings, legs, 2)."""
    triangles = _TRIANGLES[cells.shape[1]]
    padding = -len(cells) % _LANES
    padded = np.concatenate((cells, np.repeat(cells[-1:], padding, axis=0)))
    inverse = np.zeros((len(triangles), len(triangles[0]), 4, len(padded)))
    place = np.zeros((len(triangles), len(triangles[0]), 2, len(padded)))
    for s, diagonals in enumerate(triangles):
        for d, (a, b, c) in enumerate(diagonals):
            u, v = padded[:, b] - padded[:, a], padded[:, c] - padded[:, a]
            determinant = u[:, 1] * v[:, 0] - v[:, 1] * u[:, 0]
            inverse[s, d] = np.stack((v[:, 0], -u[:, 0], -v[:, 1], u[:, 1])) / determinant
            place[s, d] = padded[:, a].T
    side = 2 * reach + 1
    holds = np.zeros((len(padded), side + BLOCK, side + BLOCK), np.bool_)
    for heading, polygon in enumerate(padded):
        for row, col, length in _polygon_runs(polygon):
            holds[heading, row + reach, col + reach : col + reach + length] = True
    windows: list[tuple[int, int, int, int]] = []
    spots: list[tuple[int, int]] = []
    window_allowed: list[NDArray[np.bool_]] = []
    cell_allowed: list[NDArray[np.bool_]] = []
    corners = [(r, c) for r in range(0, side, BLOCK) for c in range(0, side, BLOCK)]
    # From the centre outwards: there every heading looks.
    corners.sort(key=lambda rc: np.hypot(rc[0] - reach + 1.5, rc[1] - reach + 1.5))
    for r, c in corners:
        touched = holds[:, r : r + BLOCK, c : c + BLOCK]
        if not touched.any():
            continue
        first = len(spots)
        for a, b in np.argwhere(touched.any(axis=0)):
            spots.append((r + a - reach, c + b - reach))
            cell_allowed.append(touched[:, a, b])
        windows.append((r - reach, c - reach, first, len(spots)))
        window_allowed.append(np.asarray(touched.any(axis=(1, 2))))

    def lanes(allowed: list[NDArray[np.bool_]]) -> NDArray[np.float32]:
        marks = np.where(np.array(allowed), np.float32(0.0), _FORBIDDEN)
        return np.ascontiguousarray(np.tile(marks, (1, len(triangles))), dtype=np.float32)

    return PlaneTables(
        padded,
        inverse.astype(np.float32),
        place.astype(np.float32),
        np.array(windows, dtype=np.int64),
        lanes(window_allowed),
        np.array(spots, dtype=np.int64),
        lanes(cell_allowed),
    )


def _triangle_height(points: NDArray[np.float64]) -> float:
    a, b, c = points
    area2 = abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
    longest = max(np.hypot(*(b - a)), np.hypot(*(c - b)), np.hypot(*(a - c)))
    return float(area2 / longest) if longest > 0.0 else 0.0


@lru_cache(maxsize=32)
def _footprint(legs: int, leg_radius: float, pad_radius: float, posting: float) -> Footprint:
    radius = leg_radius / posting
    if radius < 1.0:
        raise ValueError(
            f"posting = {posting} m: must be finer than the leg radius of {leg_radius} m"
        )
    cells = _distinct_headings(legs, radius)
    n = int(np.floor(pad_radius / posting + 1e-9))
    rows, cols = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1), indexing="ij")
    disc = rows**2 + cols**2 <= (pad_radius / posting + 1e-9) ** 2
    pad = np.column_stack((rows[disc], cols[disc])).astype(np.int64)

    reach = int(np.abs(cells).max()) + n
    side = 2 * reach + 1
    leg_mask = np.zeros((side, side), np.bool_)
    body_mask = np.zeros((side, side), np.bool_)
    for polygon in cells:
        for leg in polygon:
            spots = leg + pad + reach
            leg_mask[spots[:, 0], spots[:, 1]] = True
        for row, col, length in _polygon_runs(polygon):
            body_mask[row + reach, col + reach : col + reach + length] = True
    least = min(
        _triangle_height(polygon[list(triple)].astype(np.float64))
        for polygon in cells
        for triple in combinations(range(legs), 3)
    )
    pad_windows = _windows(disc, -n, -n)
    leg_windows = _windows(leg_mask, -reach, -reach)
    body_windows = _windows(body_mask, -reach, -reach)
    deepest = max(int(w[:, 1].max()) for w in (pad_windows, leg_windows, body_windows))
    return Footprint(
        legs=cells,
        pad=pad,
        pad_windows=pad_windows,
        leg_windows=leg_windows,
        body_windows=body_windows,
        depth=1 + deepest,
        least_height=least * posting,
        reach=reach,
        planes=_plane_tables(cells, reach),
    )


def footprint_of(lander: Lander, posting: float) -> Footprint:
    """Return the footprint of `lander` on a grid of the given posting (m).

    Raises
    ------
    ValueError
        If the posting is too coarse for the legs to fall in different cells.
    """
    footprint = _footprint(lander.legs, lander.leg_radius, 0.5 * lander.pad_diameter, posting)
    if footprint.least_height <= 0.0:
        raise ValueError(f"posting = {posting} m: too coarse, three legs fall on one line")
    return footprint
