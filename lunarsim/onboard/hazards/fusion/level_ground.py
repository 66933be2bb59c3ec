"""Ground that was measured to be level, on which few unseen rocks and none of those seen can stand.

A calibrated map of elevations bounds what it knows no frequency of by the worst that a footprint
may hold, and that hardly orders the sites: on cratered ground those of a few per million and of
one half are safe alike. So the form itself counts too, where it gives more:

    p = prior x level x exp(-Lambda) x P(no tracked rock reaches in)

`level` falls from 1 where slope and roughness, as measured, are well within the limits to 0 at
either limit. Lambda are the rocks under the lander that are too high and that nobody has seen, by
the less of two bounds:

- what samples let expect, of which an eye for rocks leaves fewer or more, ten times over: the share
  of samples that stand high is little known where they are few;
- where an eye for rocks has looked, those that it misses of what the mission expects.

The prior is less than surely safe, and no frequency is claimed. It is never more than what was seen
allows (`ceiling`), and 0 for samples noisier, or farther apart, than any that maps were tried on.
p falls with each of its factors, and holds wherever either eye has looked: where one has and the
other has not, sites are still told by one measure. What it does not ask for are rocks and holes
that are lower than the limit of roughness, but would tilt the lander on a slope: the regression
counts them.

An eye that finds far fewer rocks than it should is not believed (`lunarsim.onboard.hazards.
shadows.plausible`), unless that is because it reads them too small: here they count by the scale
that the samples tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.fusion.heights import Heights
from lunarsim.onboard.hazards.fusion.resampling import on_grid
from lunarsim.onboard.hazards.published import RockEvidence, RockTracks
from lunarsim.onboard.hazards.shadows.plausible import too_few
from lunarsim.safety.calibration import NOISES, SPACINGS, Evidence, ceiling

Array = NDArray[np.float64]

# Slope and roughness are well within their limits up to these shares of them short of 1.
_SLOPE, _ROUGHNESS = 0.2, 0.7
# As many unseen rocks may be there as samples let expect, times this.
_MISCOUNTED = 10.0


def level_ground(judged: Evidence, prior: float, free_of_unseen: Array) -> Array:
    """Return the probability of safe ground but for tracked rocks (rows, cols).

    Of what was not measured it means nothing, see `within_ceiling`.

    Parameters
    ----------
    judged
        What was measured, with what an eye for rocks leaves of those that were not.
    prior
        Probability that slope and relief are within the limits, as the mission expects it.
    free_of_unseen
        Probability that no rock stands there that nobody has seen, `none_unseen` (rows, cols).
    """
    with np.errstate(invalid="ignore"):
        level = np.clip((1.0 - judged.slope) / _SLOPE, 0.0, 1.0)
        level *= np.clip((1.0 - judged.roughness) / _ROUGHNESS, 0.0, 1.0)
    return np.asarray(prior * level * free_of_unseen)


def within_ceiling(judged: Evidence, p: Array) -> NDArray[np.float32]:
    """Return probabilities (rows, cols), never more than what was seen allows.

    0 where it was not measured, and where a figure of the evidence is no number.
    """
    p = np.minimum(p, ceiling(judged))
    return np.where(judged.observed & np.isfinite(p), p, 0.0).astype(np.float32)


def none_unseen(judged: Evidence, none_missed: Array | float = 0.0) -> Array:
    """Return the probability that no rock stands there that nobody has seen (rows, cols).

    However the ground lies. 0 for samples noisier, or farther apart, than any that maps were tried
    on.

    Parameters
    ----------
    judged
        As for `level_ground`.
    none_missed
        See `none_missed_by` (rows, cols).
    """
    if judged.noise_ratio > NOISES[1] or judged.spacing_ratio > SPACINGS[1]:
        return np.zeros(judged.level.grid.shape)
    return np.asarray(np.maximum(np.exp(-_MISCOUNTED * judged.hazards()), none_missed))


def none_missed_by(
    rocks: RockEvidence, placed: RockTracks, heights: Heights, grid: Grid, limit: float
) -> Array:
    """Return the probability that an eye for rocks misses none that reaches in (rows, cols).

    0 where it has not looked, does not tell, or is not believed.

    Parameters
    ----------
    rocks
        Its evidence.
    placed, heights
        Its rocks, as both eyes have them.
    grid
        The sites.
    limit
        Height from which on a rock matters, m.
    """
    if rocks.unseen is None or not believed(rocks, placed, heights, limit):
        return np.zeros(grid.shape)
    own = rocks.drawn
    seen = on_grid(own.observed, own.grid, grid, False, "least")
    unseen = on_grid(rocks.unseen, own.grid, grid, 1.0, "greatest")
    return np.where(seen, 1.0 - unseen, 0.0)


def believed(rocks: RockEvidence, placed: RockTracks, heights: Heights, limit: float) -> bool:
    """Return whether an eye for rocks finds as many as it should, by their heights.

    Parameters are those of `none_missed_by`.
    """
    domain = rocks.drawn.in_domain
    if domain is None or domain.any():
        return True
    inside = np.asarray(rocks.drawn.grid.contains(placed.xy)) & (placed.existence > 0.5)
    high = heights.scale * placed.radius >= limit
    return not too_few(int(np.count_nonzero(inside & high)), rocks.expected)
