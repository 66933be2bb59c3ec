"""Incremental selection of landing sites on a quadtree (quadtree paper, section 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.quadtree import _site_kernels as k
from lunarsim.onboard.hazards.quadtree._tree_kernels import band
from lunarsim.onboard.hazards.quadtree.mesh import GroundMesh
from lunarsim.onboard.hazards.quadtree.settings import InterestMap, SiteSettings
from lunarsim.onboard.hazards.quadtree.tree import Nodes, QuadtreeMap

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Width of the middle of a zone over that of the zone.
_MIDDLE = 0.6
# Meaning of a site's status.
STATUS = (
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
    """One site of the scoreboard.

    Attributes
    ----------
    position
        Centre of its cell at the mean elevation (3,), ENU, m.
    score
        Eq. 9; 0 is the best.
    interest
        In [0, 1].
    slope
        rad.
    roughness
        m (Eq. 8).
    """

    position: Array
    score: float
    interest: float
    slope: float
    roughness: float


@dataclass(frozen=True)
class Selection:
    """All sites as they stand.

    Attributes
    ----------
    nodes
        Cells (n,).
    position
        Centres at the mean elevation (n, 3), ENU, m.
    interest
        (n,).
    slope
        (n,), rad; NaN without a ground plane.
    ratio
        Greatest exception ratio in the zone (n,); NaN where a cell of it has too few points.
    near
        The same in the middle of the zone, 0.6 of its width: about what the lander covers (n,).
    roughness
        (n,), m; NaN where not evaluated.
    status
        Index into `STATUS` (n,).
    score
        Eq. 9 (n,); inf for sites that are not eligible.
    ranked
        The best, in order; empty if no site passes.
    """

    nodes: Nodes
    position: Array
    interest: Array
    slope: Array
    ratio: Array
    near: Array
    roughness: Array
    status: NDArray[np.int8]
    score: Array
    ranked: tuple[Site, ...]


class SiteSelector:
    """Keeps planes, hazards and scores of a quadtree up to date.

    Only what the points since the last call can have changed is evaluated again; the outcome is
    that of a new selector on the same map, bit for bit.

    Parameters
    ----------
    quadtree
        The map.
    settings
        Tolerances, weights, sizes of cells.
    interest
        Left out: 1 everywhere.
    thorough
        Also find the roughness of sites that are rejected (for a probability of landing safely).
    """

    def __init__(
        self,
        quadtree: QuadtreeMap,
        settings: SiteSettings | None = None,
        interest: InterestMap | None = None,
        *,
        thorough: bool = False,
    ) -> None:
        self.map = quadtree
        self.settings = settings or SiteSettings()
        self.interest = interest
        self._thorough = thorough
        s = self.settings
        self.mesh = GroundMesh(quadtree, *s.mesh_band, s.density)
        self._hazard = tuple(quadtree.depth_of(size) for size in s.hazard_band)
        self._site = tuple(quadtree.depth_of(size) for size in s.site_band)
        self.ratios = np.full((1 << self._hazard[0],) * 2, np.nan, np.float32)
        self._version = 0
        self._calls = 0
        size = len(quadtree.tree.child)
        self._seen = np.zeros(size, np.int32)
        self._of_node = (
            np.full(size, np.nan), np.full(size, np.nan), np.full(size, np.nan),
            np.full(size, np.nan), np.full(size, k.NO_PLANE, np.int8),
        )  # fmt: skip

    def update(self) -> Selection:
        """Follow the map and return all sites."""
        if self.map.version > self._version:
            self._make_room()
            outlines = self.mesh.update(self._version)
            changed = self._update_hazards(outlines)
            self._update_sites(outlines, changed)
            self._version = self.map.version
        return self._select()

    # --- what changed ---------------------------------------------------------------------

    def _make_room(self) -> None:
        size = len(self.map.tree.child)
        if size > len(self._seen):
            more = size - len(self._seen)
            self._seen = np.concatenate((self._seen, np.zeros(more, np.int32)))
            fill = (np.nan, np.nan, np.nan, np.nan, k.NO_PLANE)
            cosine, roughness, ratio, near, status = (
                np.concatenate((a, np.full(more, v, a.dtype)))
                for a, v in zip(self._of_node, fill, strict=True)
            )
            self._of_node = (cosine, roughness, ratio, near, status)

    def _fresh(self, depth: int) -> IntArray:
        """Return the outlines of cells of a depth, or leaves above it, that got points."""
        tree = self.map.tree
        nodes = band(tree, depth, 0, self._version)
        return np.asarray(k.rectangles_of(tree, nodes))

    def _half_steps(self, depth: int) -> int:
        """Return the side of cells of a depth in half sides of the least cells."""
        return 2 << (self.map.depths - depth)

    def _nodes_in(self, marked: NDArray[np.bool_], band: tuple[int, ...]) -> Nodes:
        self._calls += 1
        return np.asarray(
            k.marked_nodes(self.map.tree, marked, band[0], band[1], self._seen, self._calls)
        )

    def _update_hazards(self, outlines: IntArray) -> IntArray:
        """Find exception ratios afresh where points or planes changed; return changed squares.

        Squares are given by their outlines (n, 4) in half steps.
        """
        s, tree = self.settings, self.map.tree
        wide = len(self.ratios)
        square = self._half_steps(self._hazard[0])
        marked = np.zeros(self.ratios.shape, np.bool_)
        k.mark(outlines, 0, square, wide, marked)
        # A cell's points do not reach over its edge: one half step less on each side.
        k.mark(self._fresh(self._hazard[1]), -1, square, wide, marked)
        nodes = self._nodes_in(marked, self._hazard)
        ratios = k.exception_ratios(tree, nodes, self.mesh.arrays, s.roughness_limit, s.density)
        steps = square // 2
        changed = np.concatenate(
            (
                k.clear_unseen(tree, marked, self.ratios, *self._hazard),
                k.paint(tree, nodes, ratios, self.ratios, steps),
            )
        )
        row, col = np.divmod(changed, wide)
        return np.stack((col, col + 1, row, row + 1), axis=-1) * square

    def _update_sites(self, outlines: IntArray, changed: IntArray) -> None:
        s, tree = self.settings, self.map.tree
        square = self._half_steps(self._site[0])
        wide = 1 << self._site[0]
        zone = int(np.ceil(s.zone / (0.5 * self.map.least)))
        marked = np.zeros((wide, wide), np.bool_)
        k.mark(outlines, 0, square, wide, marked)
        for rectangles in (self._fresh(self._site[1]), changed):
            k.mark(rectangles, zone, square, wide, marked)
        nodes = self._nodes_in(marked, self._site)
        k.judge_sites(
            tree,
            nodes,
            self.mesh.arrays,
            self.ratios,
            self._interest_of(nodes),
            (np.cos(s.slope_limit), s.exception_limit, s.zone, _MIDDLE * s.zone),
            s.roughness == "printed",
            self._thorough,
            self._of_node,
        )

    def _interest_of(self, nodes: Nodes) -> Array:
        if self.interest is None:
            return np.ones(len(nodes))
        return self.interest.at(self.map.centres(nodes))

    # --- scores ---------------------------------------------------------------------------

    def _select(self) -> Selection:
        s = self.settings
        nodes = self.map.band(*s.site_band)
        cosine, roughness, ratio, near = (np.asarray(a[nodes], float) for a in self._of_node[:4])
        status = self._of_node[4][nodes]
        interest = self._interest_of(nodes)
        score = (
            s.weight_interest * (1.0 - interest)
            + s.weight_slope * (1.0 - cosine)
            + s.weight_roughness * roughness
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
            for i in best_apart(score, position[:, :2], s.count, s.separation)
        )
        return Selection(
            nodes, position, interest, slope, ratio, near, roughness, status, score, ranked
        )


def best_apart(score: Array, xy: Array, count: int, separation: float) -> list[int]:
    """Return the places of the least finite scores whose points (n, 2) keep a distance (m)."""
    chosen: list[int] = []
    for i in np.argsort(score, kind="stable"):
        if len(chosen) == count or not np.isfinite(score[i]):
            break
        gap = xy[chosen] - xy[i]
        if not chosen or np.min(np.einsum("ij,ij->i", gap, gap)) >= separation**2:
            chosen.append(int(i))
    return chosen
