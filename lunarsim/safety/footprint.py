"""The lander's footprint as exact sets of cells.

Legs are rounded to cells. A heading matters only through the cells of its legs, so that the
continuum of headings becomes a finite list. The guarantee of the conservative test (Proposition
III.1 of the Gaussian DEM paper) then holds exactly on the grid: the sets below contain every cell
that the exact test uses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.safety._kernels import FAR
from lunarsim.typing import Array, BoolArray, IntArray

MAX_LEG_DISTANCE_CELLS = 256  # maximum distance from the lander's centre to a leg, cells
BLOCK = 6  # side of the blocks that the exact test skips or examines, cells


class FootprintArrays(NamedTuple):
    """Arrays of a lander's footprint for the compiled kernels.

    Attributes
    ----------
    legs, pad_windows, stand_windows, leg_windows, body_windows, depth, height, reach
        Attributes of `Footprint` with the same names: cells of the legs, four sets of cells as
        windows, numbers of window levels along rows and columns, and maximum offset in cells.
    pad_reach
        Maximum offset of a cell under a pad, cells.
    inverse, first_leg
        Inverse matrix of the edges of each triangle of legs that can carry the lander (headings,
        planes, diagonals, 4), 1/cells, and cell of its first leg (headings, planes, diagonals, 2).
    """

    legs: IntArray
    pad_windows: IntArray
    stand_windows: IntArray
    leg_windows: IntArray
    body_windows: IntArray
    depth: int
    height: int
    reach: int
    pad_reach: int
    inverse: NDArray[np.float32]
    first_leg: NDArray[np.float32]


class PolygonBlocks(NamedTuple):
    """Square blocks of cells that cover the polygon of the legs at every heading.

    Attributes
    ----------
    corners
        South-west cells (row, column) of the blocks (n, 2), heading by heading.
    centres
        Columns and rows of the blocks' centres, alternating (2 n,).
    first
        Index of the first block of each heading (headings + 1,); the last block of a heading is
        repeated until its number of blocks is a multiple of four, as kernels read four at once.
    allowed
        Added to the terrain before the maximum of a block is taken (n * block * block,): 0 for
        cells in the polygon, else -FAR, so that they never count. A block has `block` x `block`
        cells.
    distinct
        Distinct corners (k, 2): headings share many blocks.
    corner_index
        Index of each block's corner in `distinct` (n,).
    """

    corners: IntArray
    centres: NDArray[np.float32]
    first: IntArray
    allowed: NDArray[np.float32]
    distinct: IntArray
    corner_index: IntArray


@dataclass(frozen=True, eq=False)
class Footprint:
    """Cells that a lander touches or covers, relative to the cell of its centre.

    Offsets are (row, column): rows to the north, columns to the east.

    Attributes
    ----------
    legs
        Cells of the legs, counter-clockwise, for every distinct heading (headings, legs, 2).
    pad
        Cells under one pad (n, 2).
    pad_windows, stand_windows, leg_windows, body_windows
        Sets of cells: one pad; the cells of all legs; L, all cells that any pad touches; U, all
        cells that the polygon of the legs covers at any heading. Each set is a union of windows
        ``(level, row, column, row, column)`` (n, 5): two windows that start there, of 2**level
        columns, or of 2**-level rows for a negative level; n is a multiple of four.
    depth, height
        Number of window levels along rows, and along columns.
    min_triangle_height
        h0: minimum height of any triangle of legs, m.
    reach
        Maximum offset in any direction, cells.
    """

    legs: IntArray
    pad: IntArray
    pad_windows: IntArray
    stand_windows: IntArray
    leg_windows: IntArray
    body_windows: IntArray
    depth: int
    height: int
    min_triangle_height: float
    reach: int

    def nearest_heading(self, lander: Lander, posting: float, heading: float) -> int:
        """Return the index of the distinct heading nearest to an azimuth of body x (rad).

        `posting` is the grid spacing, m.
        """
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
        """Return the side in cells of square blocks of about `side` metres.

        `posting` is the grid spacing, m. The result is at least 1 and at most `reach`.

        Raises
        ------
        InputError
            If the side is not positive.
        """
        if not (np.isfinite(side) and side > 0.0):
            raise InputError("block_side", side, "must be positive and finite")
        return max(1, min(round(side / posting), self.reach))

    def one_heading(self, index: int) -> Footprint:
        """Return this footprint with only the heading of a given index.

        The sets L and U of all headings do not change.
        """
        return replace(self, legs=self.legs[index : index + 1])

    @cached_property
    def cells(self) -> FootprintArrays:
        """Arrays of this footprint for the compiled kernels."""
        inverse, first_leg = _support_geometry(self.legs)
        return FootprintArrays(
            self.legs,
            self.pad_windows,
            self.stand_windows,
            self.leg_windows,
            self.body_windows,
            self.depth,
            self.height,
            self.reach,
            int(self.pad.max()),
            inverse,
            first_leg,
        )

    def covers(self, block: int) -> PolygonBlocks:
        """Return square blocks of cells that cover the polygon of the legs per heading.

        `block` is the side of a block in cells.
        """
        return _covers(self, block)


def _leg_cells(legs: int, radius: float, heading: float) -> IntArray:
    """Return the cells (row, column) of a lander's legs at one heading (legs, 2).

    `legs` is the number of legs, `radius` their distance from the centre, cells, and `heading` the
    angle of the first leg from east, counter-clockwise, rad.
    """
    angle = heading + 2.0 * np.pi * np.arange(legs) / legs
    # The tiny scale rounds half-way cases away from the centre at every heading.
    xy = radius * (1.0 + 1e-12) * np.column_stack((np.sin(angle), np.cos(angle)))
    return np.asarray(np.sign(xy) * np.floor(np.abs(xy) + 0.5), dtype=np.int64)


def _distinct_headings(legs: int, radius: float) -> IntArray:
    """Return the cells of the legs at every heading that differs on the grid.

    The result (headings, legs, 2) holds (row, column) from the lander's centre; `legs` is the
    number of legs, `radius` their distance from the centre, cells.
    """
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


def polygon_runs(polygon: IntArray) -> list[tuple[int, int, int]]:
    """Return the row segments (row, first column, length) of cells in a polygon.

    `polygon` (n, 2) are the (row, column) corners of a convex polygon, counter-clockwise.
    """
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    rows, cols = np.meshgrid(
        np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1), indexing="ij"
    )
    inside = np.ones(rows.shape, dtype=np.bool_)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        # Counter-clockwise in (east, north) = (column, row): the inside is on the left.
        inside &= (b[1] - a[1]) * (rows - a[0]) - (b[0] - a[0]) * (cols - a[1]) >= 0
    return _runs_of(inside, int(low[0]), int(low[1]))


def _runs_of(mask: BoolArray, row0: int, col0: int) -> list[tuple[int, int, int]]:
    """Return the row segments (row, first column, length) of the True cells of a mask.

    The first cell of `mask` (rows, cols) is at row `row0`, column `col0`.
    """
    bordered = np.zeros((mask.shape[0], mask.shape[1] + 2), np.bool_)
    bordered[:, 1:-1] = mask
    # In each row, segments begin and end alternately.
    rows, edges = np.nonzero(bordered[:, 1:] != bordered[:, :-1])
    first, end = edges[::2], edges[1::2]
    columns = (rows[::2] + row0, first + col0, end - first)
    return list(zip(*(values.tolist() for values in columns), strict=True))


def _row_windows(mask: BoolArray, row0: int, col0: int) -> list[tuple[int, ...]]:
    """Return a set of cells as pairs of windows (level, row, column, row, column).

    Both windows of a pair have 2**level columns and start at the two cells given; their union is
    one row segment of `mask` (rows, cols), whose first cell is at row `row0`, column `col0`.
    """
    windows: list[tuple[int, ...]] = []
    for row, col, length in _runs_of(mask, row0, col0):
        level = int(length).bit_length() - 1
        windows.append((level, row, col, row, col + length - 2**level))
    return windows


def _windows(mask: BoolArray, row0: int, col0: int, *, columns: bool = False) -> IntArray:
    """Return a set of cells as pairs of windows of 2**level cells (n, 5).

    `mask` (rows, cols) is the set, and (row0, col0) is the offset of its first cell; `Footprint`
    describes a row of the result. n is a multiple of four: the last pair is repeated. With
    `columns`, windows along columns are used in the rows near row 0 if this needs fewer windows:
    the sides of a ring are a few long columns.
    """
    best = _row_windows(mask, row0, col0)
    rows = np.abs(np.arange(row0, row0 + len(mask)))
    for first_cap_row in range(1, int(rows.max()) + 2) if columns else ():
        caps = np.where((rows >= first_cap_row)[:, None], mask, False)
        sides = np.where((rows < first_cap_row)[:, None], mask, False)
        found = _row_windows(caps, row0, col0)
        found += [(-level, a, b, c, d) for level, b, a, d, c in _row_windows(sides.T, col0, row0)]
        best = min(best, found, key=len)
    best += [best[-1]] * (-len(best) % 4)
    return np.array(best, dtype=np.int64)


# Legs of plane s on diagonal d: s = 0 stands on a b c or a b d, s = 1 on a c d or b c d.
_TRIANGLES = {3: (((0, 1, 2),),), 4: (((0, 1, 2), (0, 1, 3)), ((0, 2, 3), (1, 2, 3)))}


def _support_geometry(legs: IntArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return `inverse` and `first_leg` of `FootprintArrays` from cells of the legs."""
    triangles = _TRIANGLES[legs.shape[1]]
    shape = (len(legs), len(triangles), len(triangles[0]))
    inverse, first_leg = np.zeros((*shape, 4)), np.zeros((*shape, 2))
    for s, diagonals in enumerate(triangles):
        for d, (a, b, c) in enumerate(diagonals):
            u, v = legs[:, b] - legs[:, a], legs[:, c] - legs[:, a]
            determinant = u[:, 1] * v[:, 0] - v[:, 1] * u[:, 0]
            edges = np.stack((v[:, 0], -u[:, 0], -v[:, 1], u[:, 1]), axis=-1)
            inverse[:, s, d] = edges / determinant[:, None]
            first_leg[:, s, d] = legs[:, a]
    return inverse.astype(np.float32), first_leg.astype(np.float32)


@lru_cache(maxsize=64)
def _covers(footprint: Footprint, block: int) -> PolygonBlocks:
    """Return square blocks of cells that cover the polygon of the legs per heading.

    `block` is the side of a block in cells. The number of blocks of each heading is a multiple of
    four: the last block is repeated.
    """
    corners: list[tuple[int, int]] = []
    bands: list[IntArray] = []  # first column and end of the polygon in each row of a block
    first = [0]
    across = np.arange(block)
    for polygon in footprint.legs:
        runs = np.array(polygon_runs(polygon))
        lowest, highest = int(runs[0, 0]), int(runs[-1, 0])
        spans = np.zeros((max(highest - lowest + 1, block), 2), np.int64)
        spans[runs[:, 0] - lowest] = np.column_stack((runs[:, 1], runs[:, 1] + runs[:, 2]))
        for start in range(lowest, highest + 1, block):
            # The last band is shifted to end at the last row: no block leaves the footprint.
            row = min(start, max(highest - block + 1, lowest))
            band = spans[row - lowest : row - lowest + block]
            there = band[:, 1] > band[:, 0]
            low, high = int(band[there, 0].min()), int(band[there, 1].max())
            columns = list(range(low, max(high - block, low) + 1, block))
            if columns[-1] + block < high:
                columns.append(high - block)
            corners += [(row, col) for col in columns]
            bands += [band] * len(columns)
        spare = -len(corners) % 4
        corners += [corners[-1]] * spare
        bands += [bands[-1]] * spare
        first.append(len(corners))
    south_west = np.array(corners, dtype=np.int64)
    centres = (south_west[:, ::-1] + 0.5 * (block - 1)).astype(np.float32)
    distinct, corner_index = np.unique(south_west, axis=0, return_inverse=True)
    columns_of_blocks = south_west[:, 1, None, None] + across
    begin, end = np.array(bands)[..., :1], np.array(bands)[..., 1:]
    allowed = (columns_of_blocks >= begin) & (columns_of_blocks < end)
    marks = np.where(allowed, np.float32(0.0), -FAR).ravel()
    return PolygonBlocks(
        south_west,
        centres.ravel(),
        np.array(first),
        marks,
        distinct,
        corner_index.ravel().astype(np.int64),
    )


def _triangle_height(points: Array) -> float:
    """Return the height of a triangle of `points` (3, 2) over its longest side, cells."""
    a, b, c = points
    area2 = abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
    longest = max(np.hypot(*(b - a)), np.hypot(*(c - b)), np.hypot(*(a - c)))
    return float(area2 / longest) if longest > 0.0 else 0.0


@lru_cache(maxsize=32)
def _footprint(legs: int, leg_radius: float, pad_radius: float, posting: float) -> Footprint:
    """Return the footprint of a lander on a grid; raise InputError for bad sizes.

    A size is bad if a leg is less than one cell or more than 256 cells from the centre. `legs` is
    the number of legs; the other arguments are distance of the legs from the centre, radius of a
    pad, and grid spacing, m.
    """
    radius = leg_radius / posting
    if radius < 1.0:
        raise InputError(
            "grid.posting",
            posting,
            f"must be less than vehicle.leg_radius, which is {leg_radius:g} m",
        )
    if radius > MAX_LEG_DISTANCE_CELLS:
        raise InputError(
            "vehicle.leg_radius",
            leg_radius,
            f"must be at most {MAX_LEG_DISTANCE_CELLS} grid spacings of {posting:g} m",
            "Use a larger grid spacing or a smaller lander.",
        )
    cells = _distinct_headings(legs, radius)
    n = int(np.floor(pad_radius / posting + 1e-9))
    rows, cols = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1), indexing="ij")
    disc = rows**2 + cols**2 <= (pad_radius / posting + 1e-9) ** 2
    pad = np.column_stack((rows[disc], cols[disc])).astype(np.int64)

    reach = int(np.abs(cells).max()) + n
    side = 2 * reach + 1
    stand_mask = np.zeros((side, side), np.bool_)
    leg_mask = np.zeros((side, side), np.bool_)
    body_mask = np.zeros((side, side), np.bool_)
    for polygon in cells:
        for leg in polygon:
            stand_mask[leg[0] + reach, leg[1] + reach] = True
            spots = leg + pad + reach
            leg_mask[spots[:, 0], spots[:, 1]] = True
        for row, col, length in polygon_runs(polygon):
            body_mask[row + reach, col + reach : col + reach + length] = True
    min_height = min(
        _triangle_height(polygon[list(triple)].astype(np.float64))
        for polygon in cells
        for triple in combinations(range(legs), 3)
    )
    pad_windows = _windows(disc, -n, -n)
    stand_windows = _windows(stand_mask, -reach, -reach)
    leg_windows = _windows(leg_mask, -reach, -reach, columns=True)
    body_windows = _windows(body_mask, -reach, -reach, columns=True)
    levels = np.concatenate((pad_windows, stand_windows, leg_windows, body_windows))[:, 0]
    return Footprint(
        legs=cells,
        pad=pad,
        pad_windows=pad_windows,
        stand_windows=stand_windows,
        leg_windows=leg_windows,
        body_windows=body_windows,
        depth=1 + int(levels.max()),
        height=1 - int(levels.min()),
        min_triangle_height=min_height * posting,
        reach=reach,
    )


def footprint_of(lander: Lander, posting: float) -> Footprint:
    """Return the cells that a lander touches or covers, on a grid of given spacing.

    `posting` is the grid spacing, m.

    Raises
    ------
    InputError
        If the posting is too coarse for legs in different cells, or so fine that a leg is more than
        256 cells from the centre: computing time and memory grow with the cube of that number.
    """
    footprint = _footprint(lander.legs, lander.leg_radius, 0.5 * lander.pad_diameter, posting)
    if footprint.min_triangle_height <= 0.0:
        raise InputError(
            "grid.posting", posting, "must be smaller, because three legs are in one line of cells"
        )
    return footprint
