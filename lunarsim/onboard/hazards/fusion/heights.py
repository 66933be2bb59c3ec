"""How high the rocks stand that one eye tracks and another has sampled.

A shadow tells the size of a rock up to its shape: half spheres that are read as cubes are given
0.7 of their radius, all alike. Samples tell heights, and miss tops. So the scale, height over
radius, is measured on rocks that both eyes have seen, and each rock's height follows from its own
shadow.

- **Scale.** A sample falls on a rock's top so and so often; of n samples on a half ellipsoid the
  highest stands above ``sqrt(1 - log 2 / n)`` of its height in one case of two. The median over
  the rocks of what that makes of height over radius is drawn to what is usual, as if by two rocks:
  more than the mission expects, since shadows tell radii too small rather than too large. Samples
  only ever fall short, and confused rises make it less, so it is taken to be no less than the
  mission expects.
- **Height.** Log-normal about scale times radius, by how well the radius is known and the scale.
- **Samples that show nothing.** On a rock of height H with no sample above m they are
  ``exp(-c (H^2 - m^2))`` likely, c their density times pi / (2 height_ratio)^2. The odds of a rock
  that is too high are multiplied by the ratio of this likelihood if it is, to that if it is lower
  or none, and by no less than `COMMON`. A rise as high as the limit leaves the odds as they are:
  the elevations count it already. For a given scale and share the ratio rises with m and falls with
  the density: fewer samples, or higher ones, never make a rock less likely.
- **Tracks that are no rocks.** Those told to be higher than the limit are rocks by the share of
  them that samples find to be some (`genuine_share`): hollows throw shadows too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.fusion import _height_kernels as kernels
from lunarsim.onboard.hazards.fusion.association import COMMON
from lunarsim.onboard.hazards.fusion.genuine import genuine_share
from lunarsim.onboard.hazards.fusion.rises import INDEPENDENT, Samples
from lunarsim.onboard.hazards.published import RockTracks
from lunarsim.onboard.hazards.shadows._probability_kernels import paint
from lunarsim.onboard.hazards.shadows.probability import cover_probability

Array = NDArray[np.float64]

# Samples belong to a rock within so many radii of it and so far, m, and as far as its place is
# unknown, but no farther than that, m.
_RADII, _ASIDE, _FARTHEST = 1.4, 0.1, 0.3
# Rocks tell the scale from so many samples on; each counts by this share of what is usual: so many
# times what the mission expects, give or take this share, 1 sigma.
_LEAST_SAMPLES, _WORTH = 1.5, 0.5
USUAL, _UNMEASURED = 1.2, 0.2
# What no look averages out: spread of a height, as a share, and of a place, an axis, in radii.
_SPREAD, _PLACE = 0.12, 0.2
# Spread of how far the part of a rock reaches that is too high, as a share and m.
_REACH_SPREAD, _LEAST_SPREAD = 0.15, 0.02
# Heights that are tried, over the limit; rocks that are higher still are judged as the highest.
_TRIED = np.geomspace(0.04, 16.0, 160)
# No rock is taken to be smaller, m.
LEAST_RADIUS = 0.05
_DISTANCES = 65
# A rock's reach ends where its probability is below this, and rarer rocks are left out.
_TAIL, _RARE = 3.9, 1e-4
# Shapes that are narrower above; of others all of the outline may be too high.
_ROUNDED = ("hemisphere", "ellipsoid")


@dataclass(frozen=True)
class Heights:
    """What two eyes make of rocks.

    Attributes
    ----------
    scale
        Height over radius as the first eye tells it.
    hazard
        Probability that each is a rock, and higher than the lander's limit (n,).
    reach
        How far the part that is too high reaches from the rock's middle, if so (n,), m.
    """

    scale: float
    hazard: Array
    reach: Array


def heights_of(
    tracks: RockTracks, samples: Samples, lander: Lander, shape: str = "hemisphere"
) -> Heights:
    """Return what the rocks are, given the samples about them.

    Parameters
    ----------
    tracks
        The rocks.
    samples
        About them.
    lander
        Its limits.
    shape
        Of the rocks that the mission expects.
    """
    height_ratio = samples.height_ratio
    radius = np.maximum(tracks.radius, LEAST_RADIUS)
    dense = _at(samples.density, samples.grid, tracks.xy)
    top = highest(tracks, samples.rises, samples.grid)
    scale, vague = height_scale(radius, tracks.existence, top, dense, height_ratio)
    limit = lander.roughness_limit
    tried = limit * _TRIED
    spread = np.hypot(np.hypot(_SPREAD, vague), np.sqrt(tracks.radius_variance) / radius)
    middle = np.minimum(scale * radius, tried[-1])
    prior = np.exp(-0.5 * (np.log(tried / middle[:, None]) / spread[:, None]) ** 2)
    prior /= prior.sum(axis=1, keepdims=True)
    per_square = INDEPENDENT * dense * np.pi / (2.0 * height_ratio) ** 2
    above = np.maximum(tried**2 - np.maximum(top, 0.0)[:, None] ** 2, 0.0)
    left = prior * np.exp(-per_square[:, None] * above)
    high = tried > limit
    there = np.clip(tracks.existence, 0.0, 1.0)
    told = scale * radius >= limit
    tells = told & (tracks.existence > 0.5)
    share = genuine_share(tracks.xy, scale * radius, tells, samples)
    there = np.where(told, there * share, there)
    large, low = prior[:, high].sum(axis=1), prior[:, ~high].sum(axis=1)
    harmless = there * low + 1.0 - there
    missed = left[:, high].sum(axis=1) * harmless
    missed /= np.maximum(large * (there * left[:, ~high].sum(axis=1) + 1.0 - there), 1e-300)
    odds = there * large * (COMMON + (1.0 - COMMON) * np.minimum(missed, 1.0))
    mean = (prior[:, high] @ tried[high]) / np.maximum(large, 1e-300)
    mean = np.where(scale * radius > middle, scale * radius, mean)
    wide = np.maximum(mean, limit) if shape not in _ROUNDED else _wide(mean, limit)
    return Heights(scale, odds / np.maximum(odds + harmless, 1e-300), wide / (2.0 * height_ratio))


def height_scale(
    radius: Array, existence: Array, top: Array, density: Array, height_ratio: float
) -> tuple[float, float]:
    """Return height over radius, from rocks on which enough samples fell, and what it errs by.

    Parameters
    ----------
    radius, existence
        Of the rocks (n,), m.
    top
        Highest rise of a sample about each (n,), m.
    density
        Samples on a square metre about each (n,).
    height_ratio
        Height over diameter that the mission expects.

    Returns
    -------
    scale, sigma
        The ratio, and its standard deviation as a share of it.
    """
    samples = density * np.pi * radius**2
    told = 2.0 * height_ratio
    good = (samples >= _LEAST_SAMPLES) & (existence > 0.5) & (top > 0.0)
    if not good.any():
        return USUAL * told, _UNMEASURED
    share = np.sqrt(1.0 - np.log(2.0) / samples[good])
    median = float(np.median(np.log(top[good] / (radius[good] * share))))
    count = _WORTH * np.count_nonzero(good)
    scale = np.exp((count * median + np.log(USUAL * told)) / (count + 1.0))
    return float(max(scale, told)), float(_UNMEASURED / np.sqrt(count + 1.0))


def highest(tracks: RockTracks, rises: NDArray[np.float32], grid: Grid) -> Array:
    """Return the highest rise of a sample about each rock (n,), m; 0 where there is none.

    Parameters
    ----------
    tracks
        The rocks.
    rises, grid
        As for `Samples`.
    """
    reach = _RADII * tracks.radius + np.minimum(tracks.sigma, _FARTHEST) + _ASIDE
    found: Array = kernels.highest(
        rises, grid.x0, grid.y0, grid.posting, np.ascontiguousarray(tracks.xy, np.float64), reach
    )
    return found


def clear_of(tracks: RockTracks, heights: Heights, grid: Grid, lander: Lander) -> Array:
    """Return the probability that no rock that is too high stands under the lander (rows, cols).

    Its body and legs lie within the circle of the legs' middles, at any heading.

    Parameters
    ----------
    tracks, heights
        The rocks.
    grid
        The sites.
    lander
        Its geometry.
    """
    clear = np.ones(grid.shape)
    at = np.flatnonzero(heights.hazard > _RARE)
    if not at.size:
        return clear
    sigma = np.hypot(tracks.sigma, _PLACE * tracks.radius)[at]
    spread = _REACH_SPREAD * heights.reach[at] + _LEAST_SPREAD
    mean = lander.leg_radius + heights.reach[at]
    reach = mean + 1.5 * sigma + _TAIL * np.hypot(sigma, spread)
    distance = np.linspace(0.0, 1.0, _DISTANCES) * reach[:, None]
    profile = cover_probability(distance, sigma, mean, spread)
    paint(
        clear, grid.x0, grid.y0, grid.posting, tracks.xy[at], reach, profile, heights.hazard[at]
    )  # fmt: skip
    return clear


def _wide(height: Array, limit: float) -> Array:
    """Return twice the height ratio times the radius at which half ellipsoids are so high."""
    return np.asarray(np.sqrt(np.maximum(height**2 - limit**2, 0.0)))


def _at(layer: Array, grid: Grid, xy: Array) -> Array:
    """Return a layer (rows, cols) at points (n, 2); 0 off it."""
    row, col = grid.cell(xy)
    found = layer[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)]
    return np.asarray(np.where(grid.contains(xy), found, 0.0), np.float64)
