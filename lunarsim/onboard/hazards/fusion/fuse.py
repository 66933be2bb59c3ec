"""Fusion of terrain evidence and rock evidence into one probability.

p = pi x exp(-Lambda) x prod_i (1 - r_i q_i). The factors are: the terrain is suitable for landing,
no undetected rock is hazardous, and no tracked rock is hazardous. A calibrated map of elevations
provides the first two together, from features that increase with the expected number of undetected
rocks. The rock sensor reduces this number to the rocks that it also misses
(`lunarsim.safety.undetected_rock_ratio`), and the same regression evaluates the remainder. Tracked
rocks are multiplied, each with the odds that remain after the elevations
(`existence_given_elevations`).

Outside the calibrated domain the bound of the regression is weak. There the formula itself is used
if it is larger (`flat_terrain_probability`). Both decrease with worse evidence of either sensor,
and so does their maximum.

Where the rock sensor has no observation, the fused probability is at least that of the elevation
map. Where no elevation was measured, it is the probability of the rock map times a prior estimated
from the measured terrain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    ALMOST_CERTAINLY_UNSAFE_P,
)
from lunarsim.onboard.calibration.gaussian_dem import MapEvidence
from lunarsim.onboard.hazards.fusion.elevation_samples import ElevationSamples
from lunarsim.onboard.hazards.fusion.flat_terrain import (
    apply_ceiling,
    flat_terrain_probability,
    no_missed_rock_probability,
    no_undetected_rock_probability,
)
from lunarsim.onboard.hazards.fusion.priors import FusionPriors, unobserved_safety_prior
from lunarsim.onboard.hazards.fusion.registration import register_tracks
from lunarsim.onboard.hazards.fusion.resampling import resample_to_grid
from lunarsim.onboard.hazards.fusion.rock_existence import (
    COMMON_MISS_PROBABILITY,
    existence_given_elevations,
)
from lunarsim.onboard.hazards.fusion.rock_heights import (
    PRIOR_SCALE_RATIO,
    estimate_rock_heights,
    rock_free_probability,
)
from lunarsim.onboard.hazards.hazard_map import BoolMap, FloatMap, HazardMap
from lunarsim.onboard.hazards.map_evidence import RockEvidence, TerrainEvidence
from lunarsim.onboard.hazards.shadows.footprints import disc_mean
from lunarsim.safety.undetected_rock_ratio import UndetectedRockRatio
from lunarsim.typing import Array

# Rounding of single precision in sums over discs.
_ROUNDING = np.float32(1e-5)


def fuse_evidence(
    elevations: TerrainEvidence | None, rocks: RockEvidence | None, priors: FusionPriors
) -> HazardMap:
    """Fuse the measurements of an elevation and a rock mapper into one hazard map.

    If there are elevations, the map has the cells of the elevation map, otherwise those of the rock
    map.

    Parameters
    ----------
    elevations, rocks
        Data of the elevation mapper and of the rock mapper; None if there are no measurements yet.
        At least one is required.
    priors
        Lander, expected rocks and terrain prior, known before any observation.

    Raises
    ------
    InputError
        If `elevations` and `rocks` are both None.
    """
    if elevations is None:
        if rocks is None:
            raise InputError("elevations, rocks", None, "must not both be None", show_value=False)
        return _rock_map(rocks, rocks.hazard_map.grid, priors.terrain_prior)
    if rocks is None:
        return _elevation_map(elevations, priors)
    terrain = elevations.surface
    rock_map = _rock_map(rocks, terrain.grid, 1.0)
    clear, p_none_missed = _rock_free_probabilities(elevations, rocks, priors)
    undetected_ratio = footprint_undetected_ratio(rocks, terrain.grid, priors)
    site_evidence = _with_undetected_ratio(elevations, undetected_ratio)
    p, known = _elevation_probability(elevations, site_evidence)
    measured, flat = terrain.observed, np.zeros(terrain.grid.shape, np.float32)
    p_safe_without_tracks, p_no_undetected_rock = p, np.ones(terrain.grid.shape)
    if site_evidence is not None:
        p_no_undetected_rock = no_undetected_rock_probability(site_evidence, p_none_missed)
        untracked = flat_terrain_probability(
            site_evidence, priors.terrain_prior, p_no_undetected_rock
        )
        flat = apply_ceiling(site_evidence, untracked * clear)
        p_safe_without_tracks = np.maximum(p, apply_ceiling(site_evidence, untracked))
    prior = unobserved_safety_prior(
        p_safe_without_tracks[measured],
        p_no_undetected_rock[measured],
        terrain.grid.posting,
        priors,
    )
    # Where the rock sensor has no observation, the claim of the elevations remains valid.
    is_unaffected = ~undetected_ratio.is_changed & (clear == 1.0)
    is_claimed_unsafe = known & (p <= ALMOST_CERTAINLY_UNSAFE_P)
    p = (p * clear).astype(np.float32)
    # Rocks on unmeasured terrain have the height scale of the rocks seen by both sensors.
    unmeasured = np.float32(prior) * np.minimum(rock_map.p_safe, clear)
    elevation = terrain.elevation
    if elevation is not None and rock_map.elevation is not None:
        elevation = np.where(np.isfinite(elevation), elevation, rock_map.elevation)
    known = (
        measured
        & known
        & (flat <= p)
        & ((p >= ALMOST_CERTAINLY_SAFE_P) | is_claimed_unsafe | is_unaffected)
    )
    p = np.where(measured, np.maximum(p, flat), unmeasured.astype(np.float32))
    observed = measured | rock_map.observed
    if isinstance(terrain, HazardMap):
        return replace(terrain, p_safe=p, observed=observed, elevation=elevation, in_domain=known)
    return HazardMap(terrain.grid, p, observed, elevation, terrain.variance, in_domain=known)


def _elevation_map(elevations: TerrainEvidence, priors: FusionPriors) -> HazardMap:
    """Return the hazard map that follows from the elevations, without a rock sensor.

    In each cell, p_safe is the larger of the calibrated probability and the result of
    `flat_terrain_probability`. If the elevation mapper provides no site data, its hazard map is
    returned unchanged.
    """
    if elevations.site_evidence is None:
        return elevations.hazard_map
    p, known = _elevation_probability(elevations, elevations.site_evidence)
    untracked = flat_terrain_probability(
        elevations.site_evidence,
        priors.terrain_prior,
        no_undetected_rock_probability(elevations.site_evidence),
    )
    level = apply_ceiling(elevations.site_evidence, untracked)
    return replace(
        elevations.hazard_map, p_safe=np.maximum(p, level), in_domain=known & (level <= p)
    )


def _rock_free_probabilities(
    elevations: TerrainEvidence, rocks: RockEvidence, priors: FusionPriors
) -> tuple[Array, Array]:
    """Return the probabilities of no hazardous tracked rock and of no missed rock.

    Both have the shape (rows, cols) of the elevation map. If the elevation samples are available,
    the rock tracks are registered to them (`register_tracks`) and their heights are estimated from
    both sensors (`estimate_rock_heights`). Otherwise the tracks keep the size from the rock sensor,
    only their existence is updated from the elevations, and the second probability is 0.
    """
    tracks, grid, lander = rocks.tracks, elevations.surface.grid, priors.lander
    if elevations.residual_heights is None or elevations.site_evidence is None:
        updated = replace(tracks, existence=existence_given_elevations(tracks, elevations, lander))
        clear = resample_to_grid(
            rocks.clear_probability(updated), rocks.hazard_map.grid, grid, 1.0, "minimum"
        )
        return clear, np.zeros(grid.shape)
    ratio = priors.height_ratio
    samples = ElevationSamples(
        elevations.residual_heights, elevations.site_evidence.density, grid, ratio
    )
    registered_tracks = register_tracks(tracks, samples, PRIOR_SCALE_RATIO * 2.0 * ratio)
    heights = estimate_rock_heights(registered_tracks, samples, lander, priors.rocks.shape)
    p_none_missed = no_missed_rock_probability(
        rocks, registered_tracks, heights, grid, lander.roughness_limit
    )
    return rock_free_probability(registered_tracks, heights, grid, lander), p_none_missed


def footprint_undetected_ratio(
    rocks: RockEvidence, grid: Grid, priors: FusionPriors
) -> UndetectedRockRatio:
    """Return the fraction of the rocks under the lander that the rock sensor misses.

    The result holds the fraction for each rock size and each cell of `grid` as a landing site. It
    is relative to the number expected before any observation, averaged over the area in which the
    centre of a rock that reaches under the lander may lie. It is at least
    `COMMON_MISS_PROBABILITY`, because both sensors may miss a rock for the same reason, and 1 off
    the map of the rock sensor.
    """
    lander = priors.lander
    footprint = lander.leg_radius + 0.5 * lander.pad_diameter
    ratio = np.empty((len(rocks.diameter), *grid.shape), np.float32)
    for n, diameter in enumerate(rocks.diameter):
        remaining = np.maximum(rocks.undetected_ratio[n], np.float32(COMMON_MISS_PROBABILITY))
        if (remaining == 1.0).all():
            ratio[n] = 1.0
            continue
        remaining = resample_to_grid(remaining, rocks.hazard_map.grid, grid, 1.0, "maximum")
        mean = disc_mean(remaining, (footprint + 0.5 * diameter) / grid.posting, 1.0)
        untouched = np.abs(mean - 1.0) < _ROUNDING
        ratio[n] = np.where(untouched, 1.0, np.maximum(mean, np.float32(COMMON_MISS_PROBABILITY)))
    return UndetectedRockRatio(rocks.diameter, ratio, priors.rocks.cover, priors.height_ratio)


def _with_undetected_ratio(
    elevations: TerrainEvidence, undetected_ratio: UndetectedRockRatio
) -> MapEvidence | None:
    """Return the site data of the elevation map, given what the rock sensor observed.

    `undetected_ratio`, the number of undetected rocks after the rock sensor's observation over that
    before (by size and cell; in unexplained shadow it can exceed 1), is attached to the site data
    and scales their expected number of undetected rocks. If it is 1 on all observed terrain, the
    site data of `elevations` are returned unchanged. The result is None if the elevation mapper
    provides no site data.
    """
    if (
        elevations.site_evidence is None
        or not (undetected_ratio.is_changed & elevations.surface.observed).any()
    ):
        return elevations.site_evidence
    return replace(elevations.site_evidence, undetected_rock_ratio=undetected_ratio)


def _elevation_probability(
    elevations: TerrainEvidence, site_evidence: MapEvidence | None
) -> tuple[FloatMap, BoolMap]:
    """Return p_safe from the elevations, and in which cells it is calibrated.

    Both have shape (rows, cols). If `site_evidence` differs from that of `elevations`, they are
    computed from it; otherwise they are those of the hazard map of the elevation mapper.
    """
    if site_evidence is not None and site_evidence is not elevations.site_evidence:
        return calibrated_safety(site_evidence, refit=elevations.scenario_calibration)
    drawn = elevations.hazard_map
    known = np.zeros_like(drawn.observed) if drawn.in_domain is None else drawn.in_domain
    return drawn.p_safe, known


def _rock_map(rocks: RockEvidence, grid: Grid, prior: float) -> HazardMap:
    """Return the rock map resampled to `grid`, with p_safe multiplied by a prior.

    `prior` is the probability that the terrain without rocks is safe. p_safe is 0 where the rock
    sensor has no observation. No cell is marked as calibrated, because the terrain was not
    measured.
    """
    drawn, own = rocks.hazard_map, rocks.hazard_map.grid
    observed = resample_to_grid(drawn.observed, own, grid, False, "minimum")
    p = np.float32(prior) * resample_to_grid(drawn.p_safe, own, grid, 0.0, "minimum")
    elevation = drawn.elevation
    if elevation is not None:
        elevation = resample_to_grid(elevation, own, grid, np.nan, "minimum")
    return HazardMap(
        grid, np.where(observed, p, np.float32(0.0)), observed, elevation,
        in_domain=np.zeros(grid.shape, np.bool_),
    )  # fmt: skip
