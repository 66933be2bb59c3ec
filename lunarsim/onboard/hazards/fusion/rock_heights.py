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
  for lower or absent rocks, and by no less than `COMMON_MISS_PROBABILITY`. A rise up to the limit
  leaves the odds unchanged, because the elevations already count it. For a given scale and share
  the ratio increases with m and decreases with the density: fewer or higher samples never make a
  rock less likely.
- **False tracks.** Tracks above the limit are rocks with the share that samples support
  (`rock_track_precision`), because hollows cast shadows too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.fusion import _height_kernels as kernels
from lunarsim.onboard.hazards.fusion.elevation_samples import INDEPENDENT_SHARE, ElevationSamples
from lunarsim.onboard.hazards.fusion.rock_existence import (
    COMMON_MISS_PROBABILITY,
    rock_track_precision,
)
from lunarsim.onboard.hazards.map_evidence import RockTracks
from lunarsim.onboard.hazards.shadows._probability_kernels import multiply_clear_probability
from lunarsim.onboard.hazards.shadows.probability import cover_probability
from lunarsim.typing import Array

# Samples belong to a rock within this many radii, plus this distance, m, plus the position
# uncertainty up to this maximum, m.
_SEARCH_RADII, _SEARCH_MARGIN_M, _MAX_POSITION_SIGMA_M = 1.4, 0.1, 0.3
# The scale is measured on rocks with at least this many samples, each with this weight. Prior of
# the scale: this multiple of the expectation of the mission, with this relative 1 sigma.
_MIN_SAMPLES, _ROCK_WEIGHT = 1.5, 0.5
PRIOR_SCALE_RATIO, _PRIOR_SCALE_SIGMA = 1.2, 0.2
# Errors that do not average out: relative spread of a height, and of a position per axis in radii.
_HEIGHT_SPREAD, _POSITION_SPREAD_RADII = 0.12, 0.2
# Spread of the reach of the part of a rock that is too high: relative, and in m.
_REACH_SPREAD, _MIN_REACH_SPREAD_M = 0.15, 0.02
# Heights relative to the limit; higher rocks count as the highest.
_RELATIVE_HEIGHTS = np.geomspace(0.04, 16.0, 160)
# Minimum radius of a rock, m.
MIN_ROCK_RADIUS_M = 0.05
_PROFILE_POINTS = 65
# Cutoff of a rock's reach in standard deviations, and probability below which a rock is ignored.
_REACH_SIGMAS, _MIN_HAZARD = 3.9, 1e-4
# Shapes that are narrower above; with others the complete outline may be too high.
_TAPERED_SHAPES = ("hemisphere", "ellipsoid")


@dataclass(frozen=True)
class RockHeights:
    """Heights of tracked rocks, estimated from the rock sensor and elevation samples.

    Attributes
    ----------
    scale
        Ratio of the true height of the rocks to their radius as estimated by the rock sensor.
    hazard
        Probability that each track is a rock higher than the roughness limit of the lander (n,).
    reach
        Horizontal distance from the rock centre within which the rock is higher than the limit, if
        it is a hazard (n,), m.
    """

    scale: float
    hazard: Array
    reach: Array


def estimate_rock_heights(
    tracks: RockTracks, samples: ElevationSamples, lander: Lander, shape: str = "hemisphere"
) -> RockHeights:
    """Estimate heights of tracked rocks and whether they are hazards, from samples.

    Parameters
    ----------
    tracks
        Tracked rocks.
    samples
        Elevation samples around the rocks.
    lander
        Limits of the lander.
    shape
        Shape of the rocks expected by the mission.
    """
    height_ratio = samples.height_ratio
    radius = np.maximum(tracks.radius, MIN_ROCK_RADIUS_M)
    density = _layer_at(samples.density, samples.grid, tracks.xy)
    max_residual = highest_residual(tracks, samples.residual_heights, samples.grid)
    scale, scale_sigma = estimate_height_scale(
        radius, tracks.existence, max_residual, density, height_ratio
    )
    limit = lander.roughness_limit
    candidates = limit * _RELATIVE_HEIGHTS
    spread = np.hypot(
        np.hypot(_HEIGHT_SPREAD, scale_sigma), np.sqrt(tracks.radius_variance) / radius
    )
    middle = np.minimum(scale * radius, candidates[-1])
    prior = np.exp(-0.5 * (np.log(candidates / middle[:, None]) / spread[:, None]) ** 2)
    prior /= prior.sum(axis=1, keepdims=True)
    per_square = INDEPENDENT_SHARE * density * np.pi / (2.0 * height_ratio) ** 2
    above = np.maximum(candidates**2 - np.maximum(max_residual, 0.0)[:, None] ** 2, 0.0)
    unseen_prior = prior * np.exp(-per_square[:, None] * above)
    high = candidates > limit
    existence = np.clip(tracks.existence, 0.0, 1.0)
    is_above_limit = scale * radius >= limit
    is_large = is_above_limit & (tracks.existence > 0.5)
    share = rock_track_precision(tracks.xy, scale * radius, is_large, samples)
    existence = np.where(is_above_limit, existence * share, existence)
    large, low = prior[:, high].sum(axis=1), prior[:, ~high].sum(axis=1)
    harmless = existence * low + 1.0 - existence
    missed = unseen_prior[:, high].sum(axis=1) * harmless
    missed /= np.maximum(
        large * (existence * unseen_prior[:, ~high].sum(axis=1) + 1.0 - existence), 1e-300
    )
    odds = (
        existence
        * large
        * (COMMON_MISS_PROBABILITY + (1.0 - COMMON_MISS_PROBABILITY) * np.minimum(missed, 1.0))
    )
    mean = (prior[:, high] @ candidates[high]) / np.maximum(large, 1e-300)
    mean = np.where(scale * radius > middle, scale * radius, mean)
    scaled_radius = (
        np.maximum(mean, limit)
        if shape not in _TAPERED_SHAPES
        else _hemisphere_radius_at_limit(mean, limit)
    )
    return RockHeights(
        scale, odds / np.maximum(odds + harmless, 1e-300), scaled_radius / (2.0 * height_ratio)
    )


def estimate_height_scale(
    radius: Array, existence: Array, max_residual: Array, density: Array, height_ratio: float
) -> tuple[float, float]:
    """Estimate the ratio of height to radius of rocks from those with enough samples.

    The median ratio of the rocks is combined with a prior; the result is at least the ratio that
    the mission expects.

    Parameters
    ----------
    radius, existence
        Radius (n,), m, and probability of existence (n,) of the rocks.
    max_residual
        Maximum residual height (above a plane fitted to the terrain) near each rock (n,), m.
    density
        Samples per square metre near each rock (n,).
    height_ratio
        Ratio of height to diameter expected by the mission.

    Returns
    -------
    scale, sigma
        Height over radius, and its relative standard deviation.
    """
    samples = density * np.pi * radius**2
    expected_scale = 2.0 * height_ratio
    is_sampled = (samples >= _MIN_SAMPLES) & (existence > 0.5) & (max_residual > 0.0)
    if not is_sampled.any():
        return PRIOR_SCALE_RATIO * expected_scale, _PRIOR_SCALE_SIGMA
    share = np.sqrt(1.0 - np.log(2.0) / samples[is_sampled])
    median = float(np.median(np.log(max_residual[is_sampled] / (radius[is_sampled] * share))))
    count = _ROCK_WEIGHT * np.count_nonzero(is_sampled)
    scale = np.exp((count * median + np.log(PRIOR_SCALE_RATIO * expected_scale)) / (count + 1.0))
    return float(max(scale, expected_scale)), float(_PRIOR_SCALE_SIGMA / np.sqrt(count + 1.0))


def highest_residual(
    tracks: RockTracks, residual_heights: NDArray[np.float32], grid: Grid
) -> Array:
    """Return the maximum height of the samples near each rock (n,), m.

    Heights are above a plane fitted to the terrain (residual heights). The result is 0 without a
    sample.

    Parameters
    ----------
    tracks
        Tracked rocks.
    residual_heights
        Residual height of the sample in each cell of `grid` (rows, cols), m; NaN without a sample.
    grid
        Cells of the samples.
    """
    reach = (
        _SEARCH_RADII * tracks.radius
        + np.minimum(tracks.sigma, _MAX_POSITION_SIGMA_M)
        + _SEARCH_MARGIN_M
    )
    found: Array = kernels.highest_residual(
        residual_heights,
        grid.x0,
        grid.y0,
        grid.posting,
        np.ascontiguousarray(tracks.xy, np.float64),
        reach,
    )
    return found


def rock_free_probability(
    tracks: RockTracks, heights: RockHeights, grid: Grid, lander: Lander
) -> Array:
    """Return the probability that no tracked rock above the limit is under the lander.

    The result (rows, cols) is for a lander centred on each cell. Body and legs are taken as the
    disc within the circle through the leg centres, so the heading does not matter.

    Parameters
    ----------
    tracks, heights
        Tracked rocks and their height estimates.
    grid
        Cells of the result; each is a possible landing site.
    lander
        Geometry of the lander.
    """
    clear = np.ones(grid.shape)
    at = np.flatnonzero(heights.hazard > _MIN_HAZARD)
    if not at.size:
        return clear
    sigma = np.hypot(tracks.sigma, _POSITION_SPREAD_RADII * tracks.radius)[at]
    spread = _REACH_SPREAD * heights.reach[at] + _MIN_REACH_SPREAD_M
    mean = lander.leg_radius + heights.reach[at]
    reach = mean + 1.5 * sigma + _REACH_SIGMAS * np.hypot(sigma, spread)
    distance = np.linspace(0.0, 1.0, _PROFILE_POINTS) * reach[:, None]
    profile = cover_probability(distance, sigma, mean, spread)
    multiply_clear_probability(
        clear, grid.x0, grid.y0, grid.posting, tracks.xy[at], reach, profile, heights.hazard[at]
    )  # fmt: skip
    return clear


def _hemisphere_radius_at_limit(height: Array, limit: float) -> Array:
    """Return the radius (n,), m, within which hemispheres are higher than a limit (m).

    `height` (n,), m, is the radius of the hemispheres; the result is 0 for lower ones. Half
    ellipsoids of the same height have this radius divided by 2 height_ratio.
    """
    return np.asarray(np.sqrt(np.maximum(height**2 - limit**2, 0.0)))


def _layer_at(layer: Array, grid: Grid, xy: Array) -> Array:
    """Return the values of a layer (rows, cols) in the cells at points `xy` (n, 2).

    The result (n,) is 0 off the grid.
    """
    row, col = grid.cell(xy)
    found = layer[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)]
    return np.asarray(np.where(grid.contains(xy), found, 0.0), np.float64)
