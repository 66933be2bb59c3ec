"""Probability that tracked rocks exist, given elevations of another sensor.

A hazardous rock raises the terrain. Suppose that elevations near a tracked rock were measured
densely and show no rise of even half the roughness limit. Then either no rock stands there, or it
is too low to matter, or all samples missed it. The odds that a hazardous rock stands there are
multiplied by the probability of the last case. A rock that the elevations do show keeps its odds,
because the elevations already count it.

Rocks are located by their position relative to the lander, since both maps use its local frame.

Not only rocks cast shadows. Hollows do too, in the same way in every image: a track of a hollow has
a high probability of existence and resembles a large rock. Samples of elevation distinguish them
statistically, over all tracks together: the samples show a rise at a rock with a known probability,
and at any other place with the false-alarm probability. Among the tracks that would be too high for
the lander, the share s of rocks has the posterior

    L(s) = s^3 prod_i (s P(i shows, or not | rock) + (1 - s) P(the same | any place))

For each track the product is over the other tracks, because its own samples are used separately
(`lunarsim.onboard.hazards.fusion.rock_heights`). The mean of s relative to its prior mean is
applied if it is less than 1. If samples are too sparse to show a rock, tracks thus keep their
probability from the camera. Tracks are treated as independent.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.fusion.elevation_samples import ElevationSamples
from lunarsim.onboard.hazards.map_evidence import RockTracks, TerrainEvidence
from lunarsim.typing import Array, BoolArray, IntArray

# Grid of shares, and its prior: mean 4/5 with the weight of five tracks.
_SHARE_GRID = (np.arange(200) + 0.5) / 200.0
_SHARE_PRIOR = _SHARE_GRID ** (4.0 - 1.0)
_PRIOR_MEAN = float(_SHARE_PRIOR @ _SHARE_GRID / _SHARE_PRIOR.sum())


def rock_track_precision(
    xy: Array, height: Array, is_large: BoolArray, samples: ElevationSamples
) -> Array:
    """Return the factor that reduces the existence of tracks that may be hollows.

    The factor (n,) is the estimated fraction of large tracks that are rocks, divided by its prior
    mean, and at most 1. For each track it is estimated from the samples at all other tracks.

    Parameters
    ----------
    xy, height
        Positions (n, 2), local frame, m, and heights (n,), m, of the tracks.
    is_large
        Which tracks are higher than the limit of the lander and enter the estimate (n,); tracks off
        the map are ignored.
    samples
        Elevation samples.
    """
    grid = samples.grid
    is_large = is_large & np.asarray(grid.contains(xy))
    if not is_large.any():
        return np.ones(len(height))
    row, col = grid.cell(xy[is_large])
    rock = samples.detectability(height[is_large], samples.density[row, col])
    seen = samples.max_residual[row, col] >= rock.min_residual
    # Without a rise, both likelihoods are divided by the probability of no rise at any place.
    rock_likelihood = np.where(seen, rock.rise_probability, 1.0 - rock.detection_probability)
    other_likelihood = np.where(seen, rock.false_alarm_probability, 1.0)
    own = np.zeros((len(height), len(_SHARE_GRID)))
    own[is_large] = np.log(
        _SHARE_GRID * rock_likelihood[:, None] + (1.0 - _SHARE_GRID) * other_likelihood[:, None]
    )
    log = own.sum(axis=0) - own
    weight = _SHARE_PRIOR * np.exp(log - log.max(axis=1, keepdims=True))
    share = weight @ _SHARE_GRID / weight.sum(axis=1)
    return np.asarray(np.minimum(share / _PRIOR_MEAN, 1.0))


# Minimum probability that both sensors miss a rock for a common reason, for instance because it is
# flat on the far side and as dark as the terrain.
COMMON_MISS_PROBABILITY = 0.05
# Height variation that counts as a visible rise, relative to the roughness limit.
_VISIBLE_RISE_SHARE = 0.5
# Share of the area of a half ellipsoid that is above half its height.
_TOP_AREA_SHARE = 0.75
# Search radius about a rock beyond its own radius: standard deviations of its position, and cells.
_SEARCH_SIGMAS, _SEARCH_CELLS = 2.0, 1.0
# Minimum radius of a rock, m.
_MIN_RADIUS_M = 0.1
# Width of the window for the mean terrain about a rock, in leg radii.
_WINDOW_LEG_RADII = 3.0


def existence_given_elevations(
    tracks: RockTracks, elevations: TerrainEvidence, lander: Lander
) -> Array:
    """Update the probability that each track is a hazardous rock with elevations (n,).

    The probability never increases. It is unchanged if a rise of the terrain is visible, if the
    terrain around the rock was not measured completely, or if the sampling density is unknown.

    Parameters
    ----------
    tracks
        Tracked rocks.
    elevations
        Elevations and their sampling density.
    lander
        Limits of the lander.
    """
    surface = elevations.surface
    if elevations.site_evidence is None or surface.elevation is None or not len(tracks.radius):
        return tracks.existence.copy()
    rise = _height_above_mean(surface.elevation.astype(np.float64), surface.grid, lander)
    min_rise = _VISIBLE_RISE_SHARE * lander.roughness_limit
    spread = np.sqrt(tracks.radius_variance)
    reaches = tracks.radius + _SEARCH_SIGMAS * np.hypot(tracks.sigma, spread)
    top = _TOP_AREA_SHARE * np.pi * np.maximum(tracks.radius - spread, _MIN_RADIUS_M) ** 2
    missed = np.ones(len(reaches))
    for n, (xy, reach) in enumerate(zip(tracks.xy, reaches, strict=True)):
        cells = _cells_in_disc(
            surface.grid, xy, float(reach) + _SEARCH_CELLS * surface.grid.posting
        )
        if cells is None:
            continue
        heights = rise[cells]
        if np.isfinite(heights).all() and np.ptp(heights) < min_rise:
            density = float(elevations.site_evidence.density[cells].min())
            missed[n] = np.exp(-density * top[n])
    missed = COMMON_MISS_PROBABILITY + (1.0 - COMMON_MISS_PROBABILITY) * missed
    odds = missed * tracks.existence / np.maximum(1.0 - tracks.existence, 1e-12)
    return np.where(missed < 1.0, odds / (1.0 + odds), tracks.existence)


def _height_above_mean(elevation: Array, grid: Grid, lander: Lander) -> Array:
    """Return heights above the mean of a window around each cell (rows, cols), m.

    The width of the window follows from the size of the lander. Elevation (m) and result are NaN
    where unknown.
    """
    width = 2 * round(0.5 * _WINDOW_LEG_RADII * lander.leg_radius / grid.posting) + 1
    known = np.isfinite(elevation)
    share = ndimage.uniform_filter(known.astype(np.float64), width, mode="constant")
    total = ndimage.uniform_filter(np.where(known, elevation, 0.0), width, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(elevation - total / share)


def _cells_in_disc(grid: Grid, xy: Array, radius: float) -> tuple[IntArray, ...] | None:
    """Return rows and columns (k,) of the cells in a disc; None if it leaves the grid.

    `xy` (2,) is the centre of the disc and `radius` its radius, m.
    """
    west, east, south, north = grid.extent
    if not (
        west <= xy[0] - radius
        and xy[0] + radius <= east
        and south <= xy[1] - radius
        and xy[1] + radius <= north
    ):
        return None
    (r0, c0), (r1, c1) = (
        tuple(int(v) for v in grid.cell(xy + sign * radius)) for sign in (-1.0, 1.0)
    )
    row, col = np.mgrid[r0 : min(r1, grid.rows - 1) + 1, c0 : min(c1, grid.cols - 1) + 1]
    off = grid.centre_of(row, col) - xy
    near = np.hypot(off[..., 0], off[..., 1]) <= radius
    return row[near], col[near]
