"""Fusion of terrain evidence and rock evidence into one probability.

p = pi x exp(-Lambda) x prod_i (1 - r_i q_i). The factors are: the terrain is suitable for landing,
no undetected rock is hazardous, and no tracked rock is hazardous. A calibrated map of elevations
provides the first two together, from features that increase with the expected number of undetected
rocks. The rock sensor reduces this number to the rocks that it also misses
(`lunarsim.safety.thinning`), and the same regression evaluates the remainder. Tracked rocks are
multiplied, each with the odds that remain after the elevations (`existence_given_relief`).

Outside the calibrated domain the bound of the regression is weak. There the formula itself is used
if it is larger (`level_ground`). Both decrease with worse evidence of either sensor, and so does
their maximum.

Where the rock sensor has no observation, the fused probability is at least that of the elevation
map. Where no elevation was measured, it is the probability of the rock map times a prior estimated
from the measured terrain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.fusion.association import COMMON, existence_given_relief
from lunarsim.onboard.hazards.fusion.heights import USUAL, clear_of, heights_of
from lunarsim.onboard.hazards.fusion.level_ground import (
    level_ground,
    none_missed_by,
    none_unseen,
    within_ceiling,
)
from lunarsim.onboard.hazards.fusion.registration import registered
from lunarsim.onboard.hazards.fusion.resampling import on_grid
from lunarsim.onboard.hazards.fusion.rises import Samples
from lunarsim.onboard.hazards.fusion.terms import FusionTerms
from lunarsim.onboard.hazards.fusion.unmeasured import prior_beside
from lunarsim.onboard.hazards.hazard_map import BoolMap, FloatMap, HazardMap
from lunarsim.onboard.hazards.published import ReliefEvidence, RockEvidence
from lunarsim.onboard.hazards.shadows.footprints import mean_over_discs
from lunarsim.safety.calibration import Evidence, calibrated_safety
from lunarsim.safety.ensemble import HOPELESS, SURE
from lunarsim.safety.thinning import Thinning

Array = NDArray[np.float64]

# Rounding of single precision in sums over discs.
_ROUNDING = np.float32(1e-5)


def fused_map(
    relief: ReliefEvidence | None, rocks: RockEvidence | None, terms: FusionTerms
) -> HazardMap:
    """Return the map of two sensors, of which either may have no evidence yet.

    If there are elevations, the map has their cells.

    Parameters
    ----------
    relief, rocks
        Evidence of a mapper of elevations and of a mapper of rocks; None without evidence. At least
        one is required.
    terms
        Prior knowledge.

    Raises
    ------
    InputError
        If both are None.
    """
    if relief is None:
        if rocks is None:
            raise InputError("fused_map", None, "must have evidence of at least one mapper")
        return _of_rocks(rocks, rocks.drawn.grid, terms.relief_prior)
    if rocks is None:
        return _of_relief(relief, terms)
    ground = relief.surface
    alone = _of_rocks(rocks, ground.grid, 1.0)
    clear, none_missed = _clear(relief, rocks, terms)
    thinning = thinning_of(rocks, ground.grid, terms)
    judged = _thinned(relief, thinning)
    p, known = _of_elevations(relief, judged)
    seen, level = ground.observed, np.zeros(ground.grid.shape, np.float32)
    free_of_tracks, free_of_unseen = p, np.ones(ground.grid.shape)
    if judged is not None:
        free_of_unseen = none_unseen(judged, none_missed)
        untracked = level_ground(judged, terms.relief_prior, free_of_unseen)
        level = within_ceiling(judged, untracked * clear)
        free_of_tracks = np.maximum(p, within_ceiling(judged, untracked))
    prior = prior_beside(free_of_tracks[seen], free_of_unseen[seen], ground.grid.posting, terms)
    # Where the rock sensor has no observation, the claim of the elevations remains valid.
    whole = ~thinning.touched & (clear == 1.0)
    surely_not = known & (p <= HOPELESS)
    p = (p * clear).astype(np.float32)
    # Rocks on unmeasured terrain have the height scale of the rocks seen by both sensors.
    unmeasured = np.float32(prior) * np.minimum(alone.p_safe, clear)
    elevation = ground.elevation
    if elevation is not None and alone.elevation is not None:
        elevation = np.where(np.isfinite(elevation), elevation, alone.elevation)
    known = seen & known & (level <= p) & ((p >= SURE) | surely_not | whole)
    p = np.where(seen, np.maximum(p, level), unmeasured.astype(np.float32))
    observed = seen | alone.observed
    if isinstance(ground, HazardMap):
        return replace(ground, p_safe=p, observed=observed, elevation=elevation, in_domain=known)
    return HazardMap(ground.grid, p, observed, elevation, ground.variance, in_domain=known)


def _of_relief(relief: ReliefEvidence, terms: FusionTerms) -> HazardMap:
    """Return the map of the elevations without rock evidence."""
    if relief.judged is None:
        return relief.drawn
    p, known = _of_elevations(relief, relief.judged)
    untracked = level_ground(relief.judged, terms.relief_prior, none_unseen(relief.judged))
    level = within_ceiling(relief.judged, untracked)
    return replace(relief.drawn, p_safe=np.maximum(p, level), in_domain=known & (level <= p))


def _clear(relief: ReliefEvidence, rocks: RockEvidence, terms: FusionTerms) -> tuple[Array, Array]:
    """Return the probabilities of no hazardous tracked rock and of no missed rock.

    Both (rows, cols). With known samples, rocks are registered to the elevations (`registered`) and
    get the height that both sensors support (`heights_of`). Otherwise they keep the outlines of the
    rock sensor, and their existence depends on the rises in the elevations.
    """
    tracks, grid, lander = rocks.tracks, relief.surface.grid, terms.lander
    if relief.rises is None or relief.judged is None:
        there = replace(tracks, existence=existence_given_relief(tracks, relief, lander))
        clear = on_grid(rocks.clear(there), rocks.drawn.grid, grid, 1.0, "least")
        return clear, np.zeros(grid.shape)
    ratio = terms.height_ratio
    samples = Samples(relief.rises, relief.judged.density, grid, ratio)
    placed = registered(tracks, samples, USUAL * 2.0 * ratio)
    heights = heights_of(placed, samples, lander, terms.rocks.shape)
    none_missed = none_missed_by(rocks, placed, heights, grid, lander.roughness_limit)
    return clear_of(placed, heights, grid, lander), none_missed


def thinning_of(rocks: RockEvidence, grid: Grid, terms: FusionTerms) -> Thinning:
    """Return the ratio of rocks that remain undetected by the rock sensor, per site.

    Both sensors may miss a rock for the same reason, so no observation reduces the ratio below
    `COMMON`. Off the map of the rock sensor the ratio is 1. The ratio under a footprint is the mean
    over the possible rock centres.

    Parameters
    ----------
    rocks
        Evidence of the rock sensor.
    grid
        Sites.
    terms
        Prior knowledge.
    """
    lander = terms.lander
    footprint = lander.leg_radius + 0.5 * lander.pad_diameter
    ratio = np.empty((len(rocks.diameter), *grid.shape), np.float32)
    for n, diameter in enumerate(rocks.diameter):
        left = np.maximum(rocks.ratio[n], np.float32(COMMON))
        if (left == 1.0).all():
            ratio[n] = 1.0
            continue
        left = on_grid(left, rocks.drawn.grid, grid, 1.0, "greatest")
        mean = mean_over_discs(left, (footprint + 0.5 * diameter) / grid.posting, 1.0)
        untouched = np.abs(mean - 1.0) < _ROUNDING
        ratio[n] = np.where(untouched, 1.0, np.maximum(mean, np.float32(COMMON)))
    return Thinning(rocks.diameter, ratio, terms.rocks.cover, terms.height_ratio)


def _thinned(relief: ReliefEvidence, thinning: Thinning) -> Evidence | None:
    """Return the site evidence with undetected rocks reduced by the rock sensor.

    The original if no rocks are reduced; None if the elevations provide no site evidence.
    """
    if relief.judged is None or not (thinning.touched & relief.surface.observed).any():
        return relief.judged
    return replace(relief.judged, thinning=thinning)


def _of_elevations(relief: ReliefEvidence, judged: Evidence | None) -> tuple[FloatMap, BoolMap]:
    """Return the probability from elevations, and where it is a frequency.

    Both (rows, cols). With the original evidence it is the mapper's own map, bit for bit, which is
    computed only then.
    """
    if judged is not None and judged is not relief.judged:
        return calibrated_safety(judged, refit=relief.refit)
    drawn = relief.drawn
    known = np.zeros_like(drawn.observed) if drawn.in_domain is None else drawn.in_domain
    return drawn.p_safe, known


def _of_rocks(rocks: RockEvidence, grid: Grid, prior: float) -> HazardMap:
    """Return the rock map on other cells, multiplied by a prior for the terrain.

    It is nowhere a calibrated frequency, because the terrain was not measured.
    """
    drawn, own = rocks.drawn, rocks.drawn.grid
    seen = on_grid(drawn.observed, own, grid, False, "least")
    p = np.float32(prior) * on_grid(drawn.p_safe, own, grid, 0.0, "least")
    elevation = drawn.elevation
    if elevation is not None:
        elevation = on_grid(elevation, own, grid, np.nan, "least")
    return HazardMap(
        grid, np.where(seen, p, np.float32(0.0)), seen, elevation,
        in_domain=np.zeros(grid.shape, np.bool_),
    )  # fmt: skip
