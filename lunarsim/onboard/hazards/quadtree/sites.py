"""Incremental selection of landing sites on a quadtree (paper, section 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.onboard.hazards.quadtree import _hazard_kernels as h
from lunarsim.onboard.hazards.quadtree import _site_kernels as k
from lunarsim.onboard.hazards.quadtree._tree_kernels import band
from lunarsim.onboard.hazards.quadtree.mesh import TerrainMesh
from lunarsim.onboard.hazards.quadtree.settings import InterestMap, SiteSettings
from lunarsim.onboard.hazards.quadtree.tree import Nodes, QuadtreeMap
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.value_checks import check_elements, check_shape

# Default half side of the lander's footprint, relative to that of the zone.
_FOOTPRINT_ZONE_RATIO = 0.6
# Meaning of `SiteSelection.status`.
SITE_STATUS = (
    "eligible",
    "no ground plane",
    "zone leaves the map",
    "no interest",
    "too steep",
    "too few points",
    "hazard in the zone",
)


@dataclass(frozen=True)
class Site:
    """One ranked landing site of the quadtree.

    Attributes
    ----------
    position
        Centre of the site's cell at its mean elevation (3,), ENU, m.
    score
        Score by Eq. 9 of the quadtree paper; 0 is the best.
    interest
        Value of the site to the mission, in [0, 1].
    slope
        Slope of the terrain plane, rad.
    roughness
        Roughness by the measure that `SiteSettings.roughness` selects, m.
    """

    position: Array
    score: float
    interest: float
    slope: float
    roughness: float


@dataclass(frozen=True)
class SiteSelection:
    """Results of the site selection: all evaluated sites and the best of them.

    The arrays are read-only. An exception is a point that is too far from the terrain plane.

    Attributes
    ----------
    nodes
        Indices of the quadtree cells that are sites (n,).
    position
        Centres at the mean elevation (n, 3), ENU, m.
    interest
        Value of the site to the mission (n,), in [0, 1].
    slope
        Slope (n,), rad; NaN without a terrain plane.
    ratio
        Maximum fraction of exceptions in the landing zone and `margin` around it (n,); NaN if a
        cell of the zone has too few points.
    footprint_ratio
        Maximum fraction of exceptions in the footprint of the lander (n,).
    roughness
        Roughness by the measure that `SiteSettings.roughness` selects (n,), m; NaN where not
        evaluated.
    relief
        Maximum distance of a point in the zone and `margin` around it from the median plane of its
        cell, or of an exception from the terrain plane (n,), m; NaN if a cell of the zone has too
        few points.
    footprint_relief
        Maximum such distance in the footprint of the lander (n,), m.
    points
        Number of points in the zone (n,), without outliers in height; NaN where not evaluated.
    fitted_slope, slope_sigma
        Slope of the least-squares plane through the points of the zone, and its standard error
        (n,), rad; NaN where not evaluated.
    status
        Index into `SITE_STATUS` (n,).
    score
        Score by Eq. 9 of the quadtree paper (n,); inf for sites that are not eligible.
    ranked
        The best sites, best first; empty if no site is eligible.
    """

    nodes: Nodes
    position: Array
    interest: Array
    slope: Array
    ratio: Array
    footprint_ratio: Array
    roughness: Array
    relief: Array
    footprint_relief: Array
    points: Array
    fitted_slope: Array
    slope_sigma: Array
    status: NDArray[np.int8]
    score: Array
    ranked: tuple[Site, ...]

    def __post_init__(self) -> None:
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.flags.writeable = False


class SiteSelector:
    """Select landing sites on a quadtree, incrementally as new points arrive.

    Terrain planes, hazards and scores are evaluated again only where new points can have changed
    them. The result equals that of a new selector on the same map, bit for bit.

    Parameters
    ----------
    quadtree
        Map of the points.
    settings
        Limits, weights and cell sizes.
    interest
        Value of a landing at each place to the mission; default: 1 everywhere.
    thorough
        Evaluate the roughness of rejected sites too, as needed for a probability of safe terrain.
    footprint
        Half side of the footprint of the lander, m; default: 0.6 times that of the zone.
    """

    def __init__(
        self,
        quadtree: QuadtreeMap,
        settings: SiteSettings | None = None,
        interest: InterestMap | None = None,
        *,
        thorough: bool = False,
        footprint: float | None = None,
    ) -> None:
        self.map = quadtree
        self.settings = settings or SiteSettings()
        self._interest = interest
        self._thorough = thorough
        self.footprint = (
            _FOOTPRINT_ZONE_RATIO * self.settings.zone_half_side if footprint is None else footprint
        )
        s = self.settings
        self.mesh = TerrainMesh(quadtree, *s.mesh_band, s.min_density)
        self._hazard = tuple(quadtree.depth_of(size) for size in s.hazard_band)
        self._site = tuple(quadtree.depth_of(size) for size in s.site_band)
        squares = 1 << min(self._hazard[0] + h.SQUARE_LEVELS, quadtree.depths)
        self._ratios, self._reliefs = (
            np.full((squares, squares), np.nan, np.float32) for _ in range(2)
        )
        self._version = 0
        self._visit = 0
        # One row per square of the smallest cells; the memory of rows without a site is never
        # touched.
        self._visited = [np.zeros(1 << 2 * d[0], np.int32) for d in (self._hazard, self._site)]
        self._results = np.zeros((1 << 2 * self._site[0], 9))
        self._status = np.full(1 << 2 * self._site[0], k.NO_PLANE, np.int8)

    @property
    def interest(self) -> InterestMap | None:
        """Value of a landing at each place to the mission; fixed for one selector."""
        return self._interest

    @property
    def ratios(self) -> NDArray[np.float32]:
        """Fraction of points off the terrain plane in each square of the map; read-only.

        Shape (rows, cols), from the south-west. NaN where a cell has too few points or no plane.
        """
        return _read_only(self._ratios)

    @property
    def reliefs(self) -> NDArray[np.float32]:
        """Maximum distance of points from their plane in each square, m; read-only.

        The distance is defined as for `SiteSelection.relief`; shape (rows, cols).
        """
        return _read_only(self._reliefs)

    @property
    def hazards(self) -> NDArray[np.float32]:
        """Raster of hazards with a margin around them: 1 for a hazard, otherwise 0.

        The result (rows, cols) has the squares of `ratios`. It is NaN where `ratios` is NaN.
        """
        reach = int(np.ceil(self.settings.margin * len(self._ratios) / self.map.side - 1e-6))
        hazard = (self._ratios > self.settings.exception_limit).astype(np.float32)
        wider = ndimage.maximum_filter(hazard, 2 * reach + 1, mode="constant")
        return np.asarray(np.where(np.isnan(self._ratios), np.float32(np.nan), wider))

    @property
    def nbytes(self) -> int:
        """Maximum memory, bytes; entries without a site are never written."""
        rasters = self._ratios.nbytes + self._reliefs.nbytes
        seen = sum(a.nbytes for a in self._visited)
        return rasters + seen + self._results.nbytes + self._status.nbytes

    def update(self) -> SiteSelection:
        """Evaluate what new points of the map have changed, and return all sites."""
        if self.map.version > self._version:
            outlines = self.mesh.update(self._version)
            changed = self._update_hazards(outlines)
            self._update_sites(outlines, changed)
            self._version = self.map.version
        return self._select()

    # --- changes --------------------------------------------------------------------------

    def _updated_outlines(self, depth: int) -> IntArray:
        """Return the outlines of cells that got points since the last update (n, 4).

        The cells have the given depth or are larger leaves. The outlines are in half sides of the
        smallest cells.
        """
        tree = self.map.tree
        nodes = band(tree, depth, 0, self._version)
        return np.asarray(k.rectangles_of(tree, nodes))

    def _half_steps(self, depth: int) -> int:
        """Return the side of the cells of a depth, in half sides of the smallest cells."""
        return 2 << (self.map.depths - depth)

    def _nodes_in(
        self, marked: BoolArray, band: tuple[int, ...], seen: NDArray[np.int32]
    ) -> tuple[Nodes, IntArray]:
        """Return the cells of a size band in marked squares, and the empty squares.

        `marked` (rows, cols) is a raster of the smallest cells of the `band`. `seen` records which
        squares were visited. Empty squares are returned as outlines (m, 4), in half sides of the
        smallest cells.
        """
        self._visit += 1
        return k.marked_nodes(self.map.tree, marked, band[0], band[1], seen, self._visit)  # type: ignore[no-any-return]

    def _update_hazards(self, outlines: IntArray) -> IntArray:
        """Search for hazards where points or terrain planes changed.

        `outlines` (n, 4) are the outlines of changed triangles of the terrain mesh. Returns the
        outlines (m, 4) of cells whose result changed. Both are in half sides of the smallest cells.
        """
        s, tree = self.settings, self.map.tree
        wide = 1 << self._hazard[0]
        square = self._half_steps(self._hazard[0])
        marked = np.zeros((wide, wide), np.bool_)
        k.mark_squares(outlines, 0, square, wide, marked)
        square_side = 2 * (1 << self.map.depths) // len(self._ratios)
        # The expected number of points in a cell depends on squares beyond its edge: grow by all
        # but the last half step.
        k.mark_squares(
            self._updated_outlines(self._hazard[1]),
            h.NEIGHBOUR_SQUARES * square_side - 1,
            square,
            wide,
            marked,
        )
        nodes, empty = self._nodes_in(marked, self._hazard, self._visited[0])
        rasters = (self._ratios, self._reliefs)
        cleared = h.blank_squares(empty, square_side, *rasters)
        changed = h.evaluate_cells(
            tree, nodes, self.mesh.arrays, s.roughness_limit, s.min_density, *rasters
        )
        return np.concatenate((empty[cleared], k.rectangles_of(tree, nodes[changed])))

    def _update_sites(self, outlines: IntArray, changed: IntArray) -> None:
        """Evaluate the sites that changed triangles, points or hazard cells can affect.

        `outlines` (n, 4) are changed triangles of the mesh and `changed` (m, 4) changed hazard
        cells, in half sides of the smallest cells.
        """
        s, tree = self.settings, self.map.tree
        square = self._half_steps(self._site[0])
        wide = 1 << self._site[0]
        zone = int(np.ceil((s.zone_half_side + s.margin) / (0.5 * self.map.min_cell_size)))
        marked = np.zeros((wide, wide), np.bool_)
        k.mark_squares(outlines, 0, square, wide, marked)
        for rectangles in (self._updated_outlines(self._site[1]), changed):
            k.mark_squares(rectangles, zone, square, wide, marked)
        nodes, _ = self._nodes_in(marked, self._site, self._visited[1])
        k.evaluate_sites(
            tree,
            nodes,
            self._site[0],
            self.mesh.arrays,
            (self._ratios, self._reliefs),
            (np.cos(s.slope_limit), s.exception_limit, s.zone_half_side, self.footprint, s.margin),
            s.roughness == "printed",
            self._thorough,
            self._results,
            self._status,
        )

    def _interest_of(self, nodes: Nodes) -> Array:
        """Return the value to the mission of cells (n,), in [0, 1]; 1 without a map of it.

        `nodes` (n,) are the indices of the cells.
        """
        if self._interest is None:
            return np.ones(len(nodes))
        return self._interest.at(self.map.centres(nodes))

    # --- scores ---------------------------------------------------------------------------

    def _select(self) -> SiteSelection:
        """Score all sites by Eq. 9 of the quadtree paper and rank the best of them."""
        s = self.settings
        nodes = self.map.band(*s.site_band)
        place = k.raster_indices(self.map.tree, nodes, self._site[0])
        found, status = self._results[place], self._status[place]
        cosine, roughness = found[:, k.COSINE], found[:, k.ROUGHNESS]
        interest = self._interest_of(nodes)
        # The interest of the mission takes precedence, but the terrain status remains known.
        planned = (status != k.NO_PLANE) & (status != k.OFF_MAP)
        status = np.where(planned & (interest <= 0.0), np.int8(k.NO_INTEREST), status)
        score = (
            s.interest_weight * (1.0 - interest)
            + s.slope_weight * (1.0 - cosine)
            + s.roughness_weight * roughness
        )
        score = np.where(status == k.ELIGIBLE, score, np.inf)
        position = np.column_stack((self.map.centres(nodes), self.map.elevation(nodes)))
        slope = np.arccos(np.clip(cosine, -1.0, 1.0))
        ranked = tuple(
            Site(
                position[i],
                float(score[i]),
                float(interest[i]),
                float(slope[i]),
                float(roughness[i]),
            )
            for i in select_separated(score, position[:, :2], s.count, s.separation)
        )
        ratio, footprint_ratio, relief, footprint_relief, points, fitted_slope, sigma = (
            found[:, c].copy()
            for c in (
                k.RATIO,
                k.FOOTPRINT_RATIO,
                k.RELIEF,
                k.FOOTPRINT_RELIEF,
                k.POINT_COUNT,
                k.FITTED_SLOPE,
                k.SLOPE_SIGMA,
            )
        )
        return SiteSelection(
            nodes,
            position,
            interest,
            slope,
            ratio,
            footprint_ratio,
            roughness.copy(),
            relief,
            footprint_relief,
            points,
            fitted_slope,
            sigma,
            status,
            score,
            ranked,
        )


def _read_only(array: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a read-only view of an array."""
    view = array.view()
    view.flags.writeable = False
    return view


def select_separated(score: Array, xy: Array, count: int, separation: float) -> list[int]:
    """Return the indices of the lowest finite scores with a minimum separation.

    Positions are chosen in the order of their score. A position closer than `separation` to one
    chosen before is skipped.

    Parameters
    ----------
    score
        Scores (n,).
    xy
        Positions (n, 2), m.
    count
        Maximum number of indices.
    separation
        Minimum distance between chosen positions, m.

    Raises
    ------
    InputError
        If a score is NaN, or if the numbers of positions and scores differ.
    """
    check_shape("sites.xy", xy, (len(score), 2), f"for {len(score)} scores")
    check_elements(
        "sites.score", score, ~np.isnan(score), "must not be NaN", "Use inf to exclude a site."
    )
    chosen: list[int] = []
    for i in np.argsort(score, kind="stable"):
        if len(chosen) == count or not np.isfinite(score[i]):
            break
        gap = xy[chosen] - xy[i]
        if not chosen or np.min(np.einsum("ij,ij->i", gap, gap)) >= separation**2:
            chosen.append(int(i))
    return chosen
