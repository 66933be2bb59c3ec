"""Load the airborne LiDAR cloud, split it, and build both LiDAR maps of a part."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from lunarsim import Grid, gaussian_dem
from lunarsim.api import Lander
from lunarsim.onboard.hazards.gaussian_dem import GaussianDem, SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.variogram_fit import fit_hyperparameters
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper, SiteSettings

CLOUD = Path(__file__).parents[1] / "data" / "lidar_airborne_alirt_mountain.npz"
GROUND = 2  # class of ground returns; the others come from objects above the ground
# Standard deviation of a return, m. The file gives none. Ground returns scatter by 0.08 m around
# the plane of their neighbours, which includes the terrain between them.
SIGMA = 0.05
# Spacing of the returns of one scan from 1000 m at nadir, m. The lander is scaled so that its
# footprint contains the same number of returns of the cloud.
SCAN_SPACING = 0.2 * 1000.0 / 256.0
SLOPE_LIMIT_DEG = 30.0
# Prior of the paper with the margin of Table 6, m.
SHIPPED = {"sigma_f": 0.5, "length_scale": 30.0}
EDGES_DEG = (0.0, 20.0, 25.0, 30.0, 40.0, 90.0)
STRATA = ("under 20 deg", "20 to 25", "25 to 30", "30 to 40", "over 40")


@dataclass(frozen=True)
class AirborneCloud:
    """LiDAR returns of one flight over a mountain.

    Attributes
    ----------
    points
        East, north, up relative to the center of the cloud (n, 3), m.
    area
        Covered area, m^2.
    """

    points: np.ndarray
    area: float

    def spacing(self, fraction: float) -> float:
        """Return the mean horizontal spacing if only a fraction of the returns is used, m."""
        return float(np.sqrt(self.area / (fraction * len(self.points))))

    def grid(self, posting: float) -> Grid:
        """Return a grid over all returns with cells of side `posting`, m."""
        low, high = self.points[:, :2].min(axis=0), self.points[:, :2].max(axis=0)
        width, height = high - low
        return Grid.centred(0.5 * (low + high), width, posting, height)

    def split(self, fraction: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return a random fraction of the returns, and the other returns (n, 3), m."""
        chosen = np.zeros(len(self.points), np.bool_)
        chosen[rng.permutation(len(chosen))[: round(fraction * len(chosen))]] = True
        return self.points[chosen], self.points[~chosen]


def load(ground_only: bool = True, limit: float | None = None) -> AirborneCloud:
    """Load the airborne LiDAR cloud, or its part near the center.

    `ground_only` keeps only terrain returns, without those from objects. `limit` is the maximum
    distance from the center (m), east and north; None: all.
    """
    with np.load(CLOUD) as file:
        points = file["xyz"].astype(np.float64)
        if ground_only:
            points = points[file["classification"] == GROUND]
    points -= np.median(points, axis=0)
    if limit is not None:
        points = points[np.abs(points[:, :2]).max(axis=1) < limit]
    # Squares of 5 m that contain returns.
    squares = np.unique(np.floor(points[:, :2] / 5.0).astype(int), axis=0)
    return AirborneCloud(points, 25.0 * len(squares))


def smoothed_slope(cloud: AirborneCloud, grid: Grid) -> np.ndarray:
    """Return the slope of terrain smoothed over 3 m (rows, cols), deg; NaN if unknown."""
    dem = gaussian_dem(cloud.points, grid, sigma_eps=SIGMA, **SHIPPED)
    known = dem.observed
    z = np.where(known, dem.mean, 0.0).astype(np.float64)
    width = 3.0 / grid.posting
    # Division by the smoothed fraction of known cells avoids false steps at the edges.
    share = np.maximum(ndimage.gaussian_filter(known.astype(np.float64), width), 1e-6)
    north, east = np.gradient(ndimage.gaussian_filter(z, width) / share, grid.posting)
    return np.where(known, np.rad2deg(np.arctan(np.hypot(north, east))), np.nan)


def slope_class(slope: np.ndarray) -> np.ndarray:
    """Return the class of slopes (deg) as an index into `STRATA`; -1 where unknown."""
    index = np.digitize(slope, EDGES_DEG) - 1
    return np.where(np.isfinite(slope), index, -1)


def fit_prior(points: np.ndarray, rng: np.random.Generator) -> dict[str, float]:
    """Fit the random field prior of the Gaussian DEM to LiDAR returns (n, 3).

    Returns `sigma_f` and `length_scale`, m.
    """
    fit = fit_hyperparameters(points, SIGMA, rng)
    return {"sigma_f": fit.sigma_f, "length_scale": fit.length_scale}


def subtract_local_planes(points: np.ndarray, neighbours: int = 25) -> np.ndarray:
    """Replace each point's height by its height above the plane of its neighbours.

    `points` and the result are (n, 3), m; `neighbours` is the number of points per plane.
    """
    _, near = cKDTree(points[:, :2]).query(points[:, :2], k=neighbours)
    around = points[near] - points[:, None]
    rows = np.concatenate((around[..., :2], np.ones_like(around[..., :1])), axis=-1)
    normal = np.einsum("nki,nkj->nij", rows, rows)
    right = np.einsum("nki,nk->ni", rows, around[..., 2])
    plane = np.linalg.solve(normal, right[..., None])[:, 2, 0]
    return np.column_stack((points[:, :2], -plane))


def one_step_dem(points: np.ndarray, grid: Grid, prior: dict[str, float]) -> GaussianDem:
    """Compute the Gaussian DEM of all returns in one step.

    `points` (n, 3), m; `prior` holds `sigma_f` and `length_scale`.
    """
    return gaussian_dem(points, grid, sigma_eps=SIGMA, **prior)


def stepwise_dem(points: np.ndarray, grid: Grid, spacing: float, steps: int) -> GaussianDem:
    """Compute the Gaussian DEM of returns that are inserted in several steps.

    This is the method of the onboard mapper. `points` (n, 3) are all returns, m, and `spacing`
    their mean spacing, m; each step inserts an equal part of them.
    """
    pool = SamplePool(grid)
    for n in range(steps):
        pool.add(points[n::steps], SIGMA, spacing * np.sqrt(steps))
    return pooled_dem(pool)


def scaled_lander(lander: Lander, scale: float) -> Lander:
    """Return a lander with lengths times `scale` and the slope limit of this study."""
    return replace(
        lander,
        leg_radius=scale * lander.leg_radius,
        pad_diameter=scale * lander.pad_diameter,
        roughness_limit=scale * lander.roughness_limit,
        slope_limit=np.deg2rad(SLOPE_LIMIT_DEG),
    )


def quadtree_map(
    points: np.ndarray, grid: Grid, lander_scale: float, density: float
) -> QuadtreeMapper:
    """Return a quadtree mapper that contains the returns, with scaled cell sizes.

    `lander_scale` multiplies the lengths of the lander, and the nearest power of two the cell
    sizes. `density` is that of the returns (1/m^2); a cell needs at least half of it.
    """
    times = 2.0 ** round(np.log2(lander_scale))
    paper = SiteSettings()
    settings = SiteSettings(
        slope_limit=np.deg2rad(SLOPE_LIMIT_DEG),
        roughness_limit=lander_scale * paper.roughness_limit,
        min_density=0.5 * density,
        zone_half_side=lander_scale * paper.zone_half_side,
        mesh_band=tuple(times * size for size in paper.mesh_band),
        hazard_band=tuple(times * size for size in paper.hazard_band),
        site_band=tuple(times * size for size in paper.site_band),
    )
    mapper = QuadtreeMapper(
        grid,
        settings,
        elevation=float(np.median(points[:, 2])),
        min_cell_size=0.1 * times,
        lander=scaled_lander(Lander(), lander_scale),
    )
    mapper.map.insert(points)
    mapper.select()
    return mapper
