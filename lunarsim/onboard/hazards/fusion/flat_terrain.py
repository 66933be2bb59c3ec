"""Probability of a safe landing on measured flat terrain, from a formula.

Outside its calibrated domain a map of elevations is bounded by the worst that a footprint may
contain. This bound hardly ranks the sites: on cratered terrain, sites with probabilities of a few
per million and of one half are equally safe. The following formula is therefore used where it is
larger:

    p = prior x level x exp(-Lambda) x P(no tracked rock reaches in)

`level` falls from 1, where measured slope and roughness are well within the limits, to 0 at either
limit. Lambda is the expected number of undetected hazardous rocks under the lander, the smaller of
two bounds:

- ten times the number expected from the samples, after thinning by the rock sensor: with few
  samples the share of high samples is poorly known;
- where the rock sensor has observed, the rocks that it misses of those expected by the mission.

The prior is below the threshold for claimed safety, and the result is not a calibrated frequency.
It never exceeds the limit set by the measurements (`observed_terrain_bound`), and it is 0 for
samples noisier or sparser than those of the calibration. p decreases with each of its factors, and
applies wherever either sensor has observed, so that all sites are compared by the same measure. The
formula ignores rocks and holes below the roughness limit that would tilt the lander on a slope; the
regression counts them.

A rock sensor that finds far fewer rocks than expected is rejected
(`lunarsim.onboard.hazards.shadows.association`), unless it underestimates their size: here
rocks are counted with the height scale from the samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.calibration.gaussian_dem import (
    NOISE_RATIO_RANGE,
    SPACING_RATIO_RANGE,
    MapEvidence,
)
from lunarsim.onboard.hazards.fusion.resampling import resample_to_grid
from lunarsim.onboard.hazards.fusion.rock_heights import RockHeights
from lunarsim.onboard.hazards.map_evidence import RockEvidence, RockTracks
from lunarsim.onboard.hazards.shadows.association import is_rock_count_too_low
from lunarsim.typing import Array

# Slope and roughness count as well within the limits up to 1 minus these shares.
_SLOPE_MARGIN, _ROUGHNESS_MARGIN = 0.2, 0.7
# Factor on the number of undetected rocks expected from the samples.
_UNDETECTED_ROCK_FACTOR = 10.0


def flat_terrain_probability(
    site_evidence: MapEvidence, prior: float, p_no_undetected_rock: Array
) -> Array:
    """Return the probability of safe terrain by a formula that ignores tracked rocks.

    The result (rows, cols) is the product of the prior, a factor for the margins of slope and
    roughness, and the probability of no undetected rock. Where nothing was measured, the result is
    undefined; `apply_ceiling` sets it to 0 there.

    Parameters
    ----------
    site_evidence
        Slope, roughness and expected undetected rocks of each site, measured by the elevation
        mapper; the number of undetected rocks already takes the rock sensor into account.
    prior
        Probability that slope and roughness of the terrain are within the limits, as expected by
        the mission before any measurement.
    p_no_undetected_rock
        Probability of no undetected rock, from `no_undetected_rock_probability` (rows, cols).
    """
    with np.errstate(invalid="ignore"):
        level = np.clip((1.0 - site_evidence.slope) / _SLOPE_MARGIN, 0.0, 1.0)
        level *= np.clip((1.0 - site_evidence.roughness) / _ROUGHNESS_MARGIN, 0.0, 1.0)
    return np.asarray(prior * level * p_no_undetected_rock)


def apply_ceiling(site_evidence: MapEvidence, p: Array) -> NDArray[np.float32]:
    """Limit probabilities of safe terrain to what the measurements permit.

    `p` (rows, cols) are the probabilities. `site_evidence` holds the elevation measurements of each
    site, from which `observed_terrain_bound` computes the limit. The result (rows, cols) is 0 where
    the terrain was not measured and where `p` or the limit is NaN.
    """
    p = np.minimum(p, site_evidence.observed_terrain_bound())
    return np.where(site_evidence.observed & np.isfinite(p), p, 0.0).astype(np.float32)


def no_undetected_rock_probability(
    site_evidence: MapEvidence, p_none_missed: Array | float = 0.0
) -> Array:
    """Return the probability of no undetected hazardous rock at each site.

    The result (rows, cols) does not depend on slope and roughness. It is 0 if the samples are
    noisier or sparser than those of the calibration.

    Parameters
    ----------
    site_evidence
        Expected number of undetected rocks and sampling statistics from the elevation mapper.
    p_none_missed
        Probability that the rock sensor misses no rock, from `no_missed_rock_probability` (rows,
        cols). The larger of this and the probability from the samples is returned.
    """
    if (
        site_evidence.noise_ratio > NOISE_RATIO_RANGE[1]
        or site_evidence.spacing_ratio > SPACING_RATIO_RANGE[1]
    ):
        return np.zeros(site_evidence.horizontal_plane.grid.shape)
    return np.asarray(
        np.maximum(np.exp(-_UNDETECTED_ROCK_FACTOR * site_evidence.expected_hazards), p_none_missed)
    )


def no_missed_rock_probability(
    rocks: RockEvidence,
    registered_tracks: RockTracks,
    heights: RockHeights,
    grid: Grid,
    height_limit: float,
) -> Array:
    """Return the probability that the rock sensor misses no rock under the lander.

    The result (rows, cols) is 0 where the sensor has no observation. It is 0 everywhere if the
    sensor does not provide the probability or has found too few rocks to be plausible.

    Parameters
    ----------
    rocks
        Detections and detection limits of the rock sensor.
    registered_tracks, heights
        Rock tracks after registration to the elevations, and their height estimates.
    grid
        Cells of the result.
    height_limit
        Height above which a rock is hazardous, m.
    """
    if rocks.undetected_probability is None or not is_detection_count_plausible(
        rocks, registered_tracks, heights, height_limit
    ):
        return np.zeros(grid.shape)
    own = rocks.hazard_map
    seen = resample_to_grid(own.observed, own.grid, grid, False, "minimum")
    unseen = resample_to_grid(rocks.undetected_probability, own.grid, grid, 1.0, "maximum")
    return np.where(seen, 1.0 - unseen, 0.0)


def is_detection_count_plausible(
    rocks: RockEvidence, registered_tracks: RockTracks, heights: RockHeights, height_limit: float
) -> bool:
    """Return whether the rock sensor has found enough rocks to be trusted.

    Few rocks compared with the expected population indicate a sensor that does not see rocks. If
    the rock map is calibrated in any cell or does not state where it is, the function returns True
    without counting.

    Parameters
    ----------
    rocks
        Detections and detection limits of the rock sensor.
    registered_tracks, heights
        Rock tracks after registration to the elevations, and their height estimates.
    height_limit
        Height above which a rock is hazardous, m.
    """
    domain = rocks.hazard_map.in_domain
    if domain is None or domain.any():
        return True
    inside = np.asarray(rocks.hazard_map.grid.contains(registered_tracks.xy)) & (
        registered_tracks.existence > 0.5
    )
    high = heights.scale * registered_tracks.radius >= height_limit
    return not is_rock_count_too_low(
        int(np.count_nonzero(inside & high)), rocks.expected_detections
    )
