"""Surveys of the true ground: the prior maps that missions are planned on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_side
from lunarsim.messages.prior_map import PriorMap
from lunarsim.parts.quantity import quantity
from lunarsim.world.terrain import Terrain

Array = NDArray[np.float64]

# Samples of the ground along each side of a post's square.
_SAMPLES = 4
# Along a side of a map.
_MOST_POSTS = 4000
# A patch out of date shows bumps of this width, m.
_BUMP = 2.0


@dataclass(frozen=True)
class PriorSurvey:
    """A survey of the ground about the target that the lander brings along as a map.

    Attributes
    ----------
    size, posting
        Side of the square, and its posts, m.
    sigma
        Noise of each post, m.
    offset
        By which the whole map is wrong (3,), m.
    stale_share, stale_side, stale_sigma, correlation, void_share
        See `survey`.
    """

    size: float = quantity(300.0, "m", gt=0, help="side of the square about the target")
    posting: float = quantity(0.5, "m", gt=0, help="distance of the posts")
    sigma: float = quantity(0.1, "m", gt=0, help="noise of each post")
    offset: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", help="by which the whole map is wrong"
    )
    stale_share: float = quantity(0.0, ge=0, lt=1, help="of the map out of date")
    stale_side: float = quantity(12.0, "m", gt=0, help="of the patches out of date")
    stale_sigma: float = quantity(0.4, "m", ge=0, help="of what they show besides the ground")
    correlation: float = quantity(0.0, "m", ge=0, le=50, help="at which errors are still alike")
    void_share: float = quantity(0.0, ge=0, lt=1, help="of the posts without an elevation")

    def __post_init__(self) -> None:
        check_side("size", self.size, self.posting, _MOST_POSTS, "posts")

    def build(
        self, terrain: Terrain, centre: tuple[float, float], rng: np.random.Generator
    ) -> PriorMap:
        """Return the map about a point (east, north; m)."""
        grid = Grid.centred(centre, self.size, self.posting)
        made = survey(
            terrain,
            grid,
            rng,
            sigma=self.sigma,
            stale_share=self.stale_share,
            stale_side=self.stale_side,
            stale_sigma=self.stale_sigma,
            correlation=self.correlation,
            void_share=self.void_share,
        )
        return replace(
            made, grid=grid.moved(self.offset), elevation=made.elevation + self.offset[2]
        )


def survey(
    terrain: Terrain,
    grid: Grid,
    rng: np.random.Generator,
    *,
    sigma: float = 0.15,
    stale_share: float = 0.0,
    stale_side: float = 12.0,
    stale_sigma: float = 0.4,
    correlation: float = 0.0,
    void_share: float = 0.0,
) -> PriorMap:
    """Return a map of the terrain as an earlier survey might have made it.

    Parameters
    ----------
    terrain
        The ground now.
    grid
        Posts of the map.
    rng
        Source of noise and of what has changed since.
    sigma
        Of the noise of each post, m.
    stale_share, stale_side, stale_sigma
        Share of the map out of date, side of the square patches that are (m), and deviation of what
        the map shows there from what there is now (m). The map does not know of them.
    correlation
        See `PriorMap`, m.
    void_share
        Share of the posts that have no elevation, drawn one by one.
    """
    if not 0.0 <= stale_share < 1.0:
        raise InputError("prior.stale_share", stale_share, "from 0 to below 1")
    if not 0.0 <= void_share < 1.0:
        raise InputError("prior.void_share", void_share, "from 0 to below 1")
    fine = Grid(
        grid.x0 - grid.posting * (0.5 - 0.5 / _SAMPLES),
        grid.y0 - grid.posting * (0.5 - 0.5 / _SAMPLES),
        grid.posting / _SAMPLES,
        grid.rows * _SAMPLES,
        grid.cols * _SAMPLES,
    )
    ground = terrain.raster(fine).astype(np.float64)
    mean = ground.reshape(grid.rows, _SAMPLES, grid.cols, _SAMPLES).mean(axis=(1, 3))
    area = grid.rows * grid.cols * grid.posting**2
    patches = round(stale_share * area / stale_side**2)
    if patches:
        mean = mean + _changes(grid, patches, stale_side, stale_sigma, rng)
    elevation = mean + sigma * _noise(grid, correlation, rng)
    if void_share > 0.0:
        elevation[rng.random(grid.shape) < void_share] = np.nan
    return PriorMap(grid, elevation, sigma, correlation)


def _noise(grid: Grid, correlation: float, rng: np.random.Generator) -> Array:
    """Return errors of deviation 1 whose correlation falls as a Gaussian (rows, cols)."""
    if correlation == 0.0:
        return rng.standard_normal(grid.shape)
    # White noise filtered by a Gaussian is correlated over root two times its width.
    width = correlation / np.sqrt(2.0) / grid.posting
    room = int(np.ceil(4.0 * width))
    white = rng.standard_normal((grid.rows + 2 * room, grid.cols + 2 * room))
    smooth = ndimage.gaussian_filter(white, width, truncate=4.0)
    impulse = np.zeros(2 * room + 1)
    impulse[room] = 1.0
    gain = float(np.sum(ndimage.gaussian_filter1d(impulse, width, truncate=4.0) ** 2))
    inner = (slice(room, room + grid.rows), slice(room, room + grid.cols))
    return np.asarray(smooth[inner] / gain)


def _changes(
    grid: Grid, patches: int, side: float, sigma: float, rng: np.random.Generator
) -> Array:
    """Return what square patches of the map show besides the ground (rows, cols), m."""
    bumps = ndimage.gaussian_filter(rng.standard_normal(grid.shape), _BUMP / grid.posting)
    bumps *= sigma / bumps.std()
    stale = np.zeros(grid.shape, np.bool_)
    west, east, south, north = grid.extent
    for x, y in rng.uniform((west, south), (east, north), (patches, 2)):
        stale |= (np.abs(grid.x - x) <= 0.5 * side)[None, :] & (np.abs(grid.y - y) <= 0.5 * side)[
            :, None
        ]
    return np.where(stale, bumps, 0.0)
