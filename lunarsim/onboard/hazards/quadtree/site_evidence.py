"""Evidence of landing safety at the sites of a quadtree map.

The lander is placed on the mean terrain under its legs at every heading. The points of its
footprint and of the zone add their distances from the planes and their spread.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.quadtree import SiteEvidence
from lunarsim.onboard.hazards.quadtree.sites import SiteSelection
from lunarsim.onboard.hazards.quadtree.terrain_raster import (
    SamplingCoverage,
    close_holes,
    residual_heights,
    sampling_coverage,
    terrain_raster,
)
from lunarsim.onboard.hazards.quadtree.tree import QuadtreeMap
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import SafetyMap, bounded_safety
from lunarsim.safety.unseen_rocks import depth_curve, height_curve
from lunarsim.typing import Array

# Share of the smoothest zones of a map that estimates the noise.
_SMOOTHEST_QUANTILE = 0.1
# Cell sizes of the mean terrain: smallest, and largest that counts as observed, m.
_TERRAIN_BAND_M = (0.4, 1.6)


def quadtree_site_evidence(
    quadtree: QuadtreeMap,
    selection: SiteSelection,
    zone: float,
    noise: float,
    lander: Lander,
    rocks: RockExpectation,
) -> SiteEvidence:
    """Compute the inputs of the safety regression for all sites of a quadtree map.

    Parameters
    ----------
    quadtree, selection
        Map, and its sites from a `SiteSelector` with `thorough` and the footprint of the lander.
    zone
        Half side of the landing zones, m.
    noise
        Stated standard deviation of the height of a point, m. If the points spread less, the spread
        is used, since overestimated noise would explain residual heights.
    lander, rocks
        Geometry and limits of the lander; rock population expected by the mission.
    """
    s = selection
    heights = residual_heights(quadtree)
    max_slope_tangent, limit = np.tan(lander.slope_limit), lander.roughness_limit
    coverage = sampling_coverage(quadtree)
    height, grid = terrain_raster(quadtree, *_TERRAIN_BAND_M, coverage)
    xy = s.position[:, :2]
    slope, roughness = _max_about(bounded_safety(height, grid, lander), xy)
    filled = close_holes(height, grid.posting, lander.leg_radius)
    filled_slope, filled_roughness = _max_about(bounded_safety(filled, grid, lander), xy)
    mesh_slope = np.tan(s.slope) / max_slope_tangent
    # The standard error of the slope over a square yields the spread about the plane. If the points
    # span no plane, that of the mesh is used.
    fitted_spread = s.slope_sigma * np.sqrt(np.maximum(s.points - 3.0, 0.0) / 6.0) * zone
    spans = np.isfinite(s.fitted_slope)
    noise = min(noise, _min_spread(fitted_spread))
    return SiteEvidence(
        np.tan(slope) / max_slope_tangent,
        roughness / limit,
        mesh_slope,
        np.where(spans, np.tan(s.fitted_slope) / max_slope_tangent, mesh_slope),
        s.roughness / limit,
        np.where(spans, fitted_spread, s.roughness) / limit,
        s.ratio,
        s.footprint_ratio,
        s.relief / limit,
        s.footprint_relief / limit,
        np.nan_to_num(s.points, nan=0.0) / (2.0 * zone) ** 2,
        _min_footprint_density(coverage, xy, lander),
        height_curve(heights, noise, limit, rocks.cover, rocks.height_ratio[0]),
        depth_curve(heights, noise, limit, rocks.cover, rocks.height_ratio[0]),
        (filled_slope >= lander.slope_limit) | (filled_roughness >= limit),
        lander,
        noise,
    )


def _min_spread(spread: Array) -> float:
    """Return the spread of points around their planes in the smoothest zones, m.

    `spread` (n,) is the root mean square distance of each zone, m. The result is a low quantile, as
    an upper limit of the noise; inf without data.
    """
    spread = spread[np.isfinite(spread)]
    return float(np.quantile(spread, _SMOOTHEST_QUANTILE)) if len(spread) else np.inf


def _min_footprint_density(coverage: SamplingCoverage, xy: Array, lander: Lander) -> Array:
    """Return the minimum point density in the footprint at sites `xy` (n, 2), 1/m^2.

    `coverage` holds the point density of the map.
    """
    g = coverage.grid
    # A round footprint does not include the corners of the zone.
    reach = max(1, round(lander.leg_radius / g.posting))
    minimum = ndimage.minimum_filter(coverage.density, 2 * reach + 1, mode="nearest")
    row, col = g.cell(xy)
    return np.asarray(minimum[np.clip(row, 0, g.rows - 1), np.clip(col, 0, g.cols - 1)])


def _max_about(safety: SafetyMap, xy: Array) -> tuple[Array, Array]:
    """Return the maximum slope and roughness of the four cells around sites (n,).

    `xy` (n, 2) are the sites, m; the results are in the units of `safety`.
    """
    g = safety.grid
    row, col = g.cell(xy - 0.5 * g.posting)
    slope, rough = np.full(len(xy), -np.inf), np.full(len(xy), -np.inf)
    for i in (0, 1):
        for j in (0, 1):
            at = np.clip(row + i, 0, g.rows - 1), np.clip(col + j, 0, g.cols - 1)
            slope = np.maximum(slope, safety.slope[at])
            rough = np.maximum(rough, safety.roughness[at])
    return slope, rough
