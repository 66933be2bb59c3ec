"""Simulated surveys of the true terrain: the prior maps used for mission planning."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_raster_size
from lunarsim.messages.prior_map import PriorMap
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array
from lunarsim.world.terrain import Terrain

# Terrain samples along each side of the square cell over which a grid point is averaged.
_SAMPLES = 4
_MAX_POSTS_PER_SIDE = 4000
# Correlation length of the height differences in an outdated patch, m.
_BUMP_WIDTH_M = 2.0


@dataclass(frozen=True)
class PriorMapSurvey:
    """Settings of the survey that provides the prior elevation map carried on board."""

    size: float = quantity(300.0, "m", gt=0, help="side of the square prior map around the target")
    posting: float = quantity(0.5, "m", gt=0, help="grid spacing of the prior map")
    sigma: float = quantity(
        0.1, "m", gt=0, help="height error of the prior map at each grid point, 1 sigma"
    )
    offset: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", help="constant position error of the prior map (ENU)"
    )
    outdated_fraction: float = quantity(
        0.0,
        ge=0,
        lt=1,
        help="fraction of the prior map's area whose terrain has changed since the survey; the map "
        "does not mark it",
    )
    outdated_patch_side: float = quantity(
        12.0, "m", gt=0, help="side of each square patch of the prior map that is out of date"
    )
    outdated_height_sigma: float = quantity(
        0.4,
        "m",
        ge=0,
        help="height error of the prior map inside patches that are out of date, 1 sigma",
    )
    correlation: float = quantity(
        0.0,
        "m",
        ge=0,
        le=50,
        help="correlation length of the prior map's height error; 0: grid points have independent "
        "errors",
    )
    void_fraction: float = quantity(
        0.0,
        ge=0,
        lt=1,
        help="fraction of the prior map's grid points that have no elevation, chosen at random",
    )

    def __post_init__(self) -> None:
        check_raster_size("size", self.size, self.posting, _MAX_POSTS_PER_SIDE, "points")

    def build(
        self, terrain: Terrain, centre: tuple[float, float], rng: np.random.Generator
    ) -> PriorMap:
        """Simulate the survey and return the prior map around a point.

        `terrain` is the true terrain, `centre` the middle of the map (east, north; m), and `rng`
        the source of the errors.
        """
        grid = Grid.centred(centre, self.size, self.posting)
        made = simulate_survey(
            terrain,
            grid,
            rng,
            sigma=self.sigma,
            outdated_fraction=self.outdated_fraction,
            outdated_patch_side=self.outdated_patch_side,
            outdated_height_sigma=self.outdated_height_sigma,
            correlation=self.correlation,
            void_fraction=self.void_fraction,
        )
        return replace(
            made, grid=grid.moved(self.offset), elevation=made.elevation + self.offset[2]
        )


def simulate_survey(
    terrain: Terrain,
    grid: Grid,
    rng: np.random.Generator,
    *,
    sigma: float = 0.15,
    outdated_fraction: float = 0.0,
    outdated_patch_side: float = 12.0,
    outdated_height_sigma: float = 0.4,
    correlation: float = 0.0,
    void_fraction: float = 0.0,
) -> PriorMap:
    """Simulate an earlier survey: add its errors to averaged true elevations.

    Parameters
    ----------
    terrain
        True terrain.
    grid
        Grid of the map.
    rng
        Source of the noise, the out-of-date patches and the voids.
    sigma
        Height noise at each grid point, 1 sigma, m.
    outdated_fraction, outdated_patch_side, outdated_height_sigma
        Fraction of the map that is out of date, side of its square patches (m) and standard
        deviation of the height error in them (m). The map does not mark these patches.
    correlation
        Correlation length of the noise, m; 0: independent noise.
    void_fraction
        Fraction of grid points without an elevation, chosen independently at random.

    Returns
    -------
    PriorMap
        Elevations with errors, the noise level and its correlation length.
    """
    if not 0.0 <= outdated_fraction < 1.0:
        raise InputError(
            "prior_map.outdated_fraction", outdated_fraction, "must be 0 or more and less than 1"
        )
    if not 0.0 <= void_fraction < 1.0:
        raise InputError(
            "prior_map.void_fraction", void_fraction, "must be 0 or more and less than 1"
        )
    fine = Grid(
        grid.x0 - grid.posting * (0.5 - 0.5 / _SAMPLES),
        grid.y0 - grid.posting * (0.5 - 0.5 / _SAMPLES),
        grid.posting / _SAMPLES,
        grid.rows * _SAMPLES,
        grid.cols * _SAMPLES,
    )
    true_elevation = terrain.raster(fine).astype(np.float64)
    mean = true_elevation.reshape(grid.rows, _SAMPLES, grid.cols, _SAMPLES).mean(axis=(1, 3))
    area = grid.rows * grid.cols * grid.posting**2
    patches = round(outdated_fraction * area / outdated_patch_side**2)
    if patches:
        mean = mean + _outdated_patch_errors(
            grid, patches, outdated_patch_side, outdated_height_sigma, rng
        )
    elevation = mean + sigma * _noise(grid, correlation, rng)
    if void_fraction > 0.0:
        elevation[rng.random(grid.shape) < void_fraction] = np.nan
    return PriorMap(grid, elevation, sigma, correlation)


def _noise(grid: Grid, correlation: float, rng: np.random.Generator) -> Array:
    """Return random errors (rows, cols) of unit variance and Gaussian correlation.

    `correlation` is their correlation length, m; 0: white noise.
    """
    if correlation == 0.0:
        return rng.standard_normal(grid.shape)
    # White noise filtered by a Gaussian has a correlation length of root two times its width.
    width = correlation / np.sqrt(2.0) / grid.posting
    room = int(np.ceil(4.0 * width))
    white = rng.standard_normal((grid.rows + 2 * room, grid.cols + 2 * room))
    smooth = ndimage.gaussian_filter(white, width, truncate=4.0)
    impulse = np.zeros(2 * room + 1)
    impulse[room] = 1.0
    gain = float(np.sum(ndimage.gaussian_filter1d(impulse, width, truncate=4.0) ** 2))
    inner = (slice(room, room + grid.rows), slice(room, room + grid.cols))
    return np.asarray(smooth[inner] / gain)


def _outdated_patch_errors(
    grid: Grid, patches: int, side: float, sigma: float, rng: np.random.Generator
) -> Array:
    """Return height errors (rows, cols), m, that are non-zero in out-of-date patches.

    `patches` is their number, `side` their side, m, and `sigma` the standard deviation of the
    errors inside them, m.
    """
    bumps = ndimage.gaussian_filter(rng.standard_normal(grid.shape), _BUMP_WIDTH_M / grid.posting)
    bumps *= sigma / bumps.std()
    stale = np.zeros(grid.shape, np.bool_)
    west, east, south, north = grid.extent
    for x, y in rng.uniform((west, south), (east, north), (patches, 2)):
        stale |= (np.abs(grid.x - x) <= 0.5 * side)[None, :] & (np.abs(grid.y - y) <= 0.5 * side)[
            :, None
        ]
    return np.where(stale, bumps, 0.0)
