"""Heights of rocks that one sensor tracks and another has sampled.

A shadow determines the size of a rock only up to its shape: hemispheres that are read as cubes get
0.7 of their radius, all by the same factor. Samples of elevation measure heights, but miss the
tops. The height scale, height over radius, is therefore measured on rocks that both sensors have
observed. The height of each rock then follows from its own shadow.

- **Scale.** Of n random samples on a half ellipsoid, the highest has a median of ``sqrt(1 - log 2 /
  n)`` of its height. The median over the rocks of the resulting height over radius is combined with
  a prior of the weight of two rocks. The prior exceeds the expectation of the mission, since
  shadows yield radii too small rather than too large. Samples only underestimate the height, and
  false rises lower the scale, so the scale is at least the expectation of the mission.
- **Height.** Log-normal about scale times radius; its spread follows from the uncertainties of
  radius and scale.
- **Samples without a rise.** For a rock of height H, the likelihood of no sample above m is
  ``exp(-c (H^2 - m^2))``, with c the sample density times pi / (2 height_ratio)^2. The odds that a
  rock is too high are multiplied by the ratio of this likelihood for rocks above the limit to that
  for lower or absent rocks, and by no less than `COMMON`. A rise up to the limit leaves the odds
  unchanged, because the elevations already count it. For a given scale and share the ratio
  increases with m and decreases with the density: fewer or higher samples never make a rock less
  likely.
- **False tracks.** Tracks above the limit are rocks with the share that samples support
  (`genuine_share`), because hollows cast shadows too.
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

# Samples belong to a rock within this many radii, plus this distance, m, plus the position
# uncertainty up to this maximum, m.
_RADII, _ASIDE, _FARTHEST = 1.4, 0.1, 0.3
# The scale is measured on rocks with at least this many samples, each with this weight. Prior of
# the scale: this multiple of the expectation of the mission, with this relative 1 sigma.
_LEAST_SAMPLES, _WORTH = 1.5, 0.5
USUAL, _UNMEASURED = 1.2, 0.2
# Errors that do not average out: relative spread of a height, and of a position per axis in radii.
_SPREAD, _PLACE = 0.12, 0.2
# Spread of the reach of the part of a rock that is too high: relative, and in m.
_REACH_SPREAD, _LEAST_SPREAD = 0.15, 0.02
# Heights relative to the limit; higher rocks count as the highest.
_TRIED = np.geomspace(0.04, 16.0, 160)
# Minimum radius of a rock, m.
LEAST_RADIUS = 0.05
_DISTANCES = 65
# Cutoff of a rock's reach in standard deviations, and probability below which a rock is ignored.
_TAIL, _RARE = 3.9, 1e-4
# Shapes that are narrower above; with others the complete outline may be too high.
_ROUNDED = ("hemisphere", "ellipsoid")


@dataclass(frozen=True)
class Heights:
    """Height scale and hazard of rocks from two sensors.

    Attributes
    ----------
    scale
        Height over the radius from the first sensor.
    hazard
        Probability that each track is a rock higher than the limit of the lander (n,).
    reach
        Distance to which the part above the limit reaches from the rock centre, given a hazard
        (n,), m.
    """

    scale: float
    hazard: Array
    reach: Array


def heights_of(
    tracks: RockTracks, samples: Samples, lander: Lander, shape: str = "hemisphere"
) -> Heights:
    """Estimate heights and hazard of tracked rocks from the samples about them.

    Parameters
    ----------
    tracks
        Tracked rocks.
    samples
        Elevation samples.
    lander
        Limits of the lander.
    shape
        Shape of the rocks expected by the mission.
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
    """Estimate height over radius from sufficiently sampled rocks.

    Parameters
    ----------
    radius, existence
        Radius (n,), m, and probability of existence (n,) of the rocks.
    top
        Maximum residual height near each rock (n,), m.
    density
        Samples per square metre near each rock (n,).
    height_ratio
        Height over diameter expected by the mission.

    Returns
    -------
    scale, sigma
        Height over radius, and its relative standard deviation.
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
    """Return the maximum residual height near each rock (n,), m; 0 without a sample.

    Parameters
    ----------
    tracks
        Tracked rocks.
    rises, grid
        Residual heights (rows, cols), m, and their cells, as in `Samples`.
    """
    reach = _RADII * tracks.radius + np.minimum(tracks.sigma, _FARTHEST) + _ASIDE
    found: Array = kernels.highest(
        rises, grid.x0, grid.y0, grid.posting, np.ascontiguousarray(tracks.xy, np.float64), reach
    )
    return found


def clear_of(tracks: RockTracks, heights: Heights, grid: Grid, lander: Lander) -> Array:
    """Return the probability that no rock above the limit is under the lander.

    The result has shape (rows, cols). Body and legs lie within the circle through the leg centres
    at any heading.

    Parameters
    ----------
    tracks, heights
        Tracked rocks and their height estimates.
    grid
        Sites.
    lander
        Geometry of the lander.
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
    """Return the radius at which half ellipsoids exceed the limit, times twice the height ratio."""
    return np.asarray(np.sqrt(np.maximum(height**2 - limit**2, 0.0)))


def _at(layer: Array, grid: Grid, xy: Array) -> Array:
    """Return a layer (rows, cols) at points (n, 2); 0 off the grid."""
    row, col = grid.cell(xy)
    found = layer[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)]
    return np.asarray(np.where(grid.contains(xy), found, 0.0), np.float64)
