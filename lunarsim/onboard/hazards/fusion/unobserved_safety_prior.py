"""Prior for terrain without a measured elevation, estimated from measured terrain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from lunarsim.onboard.hazards.fusion.priors import FusionPriors
from lunarsim.onboard.hazards.hazard_map import FloatMap
from lunarsim.safety.calibration import UNKNOWN_MODEL_WEIGHT

Array = NDArray[np.float64]

# Minimum probability in averages of log odds.
_MIN_PROBABILITY = 1e-12


def unobserved_safety_prior(
    free_of_tracks: FloatMap, free_of_unseen: Array, posting: float, terms: FusionPriors
) -> float:
    """Estimate the probability that unmeasured terrain is safe, from measured terrain.

    Tracked rocks are not included. The estimate is the mean probability of the measured terrain in
    the same map. With any other measure, samples so sparse that all measured terrain remains
    uncertain would direct the lander to where no sample fell. The expectation of the mission is
    averaged in on log odds like one more site, and the result never exceeds it. Sites with
    overlapping footprints do not count as several, so the mission's site has a small weight beside
    many sites. The mission's site is also limited by what the map can measure: if undetected rocks
    may stand on all measured terrain, they may stand on unmeasured terrain too. This limit tightens
    with the number of measured sites.

    Parameters
    ----------
    free_of_tracks
        Probability that each measured cell is safe, ignoring tracked rocks (n,); NaN counts as 0.
    free_of_unseen
        Probability of no undetected rock in each measured cell, a factor of `free_of_tracks` (n,);
        NaN counts as 0.
    posting
        Cell size, m.
    terms
        Lander and terrain prior expected by the mission.
    """
    lander, expected = terms.lander, terms.terrain_prior
    number = len(free_of_tracks)
    if number == 0 or expected <= _MIN_PROBABILITY:
        return expected
    footprint = np.pi * (lander.leg_radius + 0.5 * lander.pad_diameter) ** 2
    sites = min(posting**2 / footprint, 1.0) * number
    free_share = max(float(np.mean(np.nan_to_num(free_of_unseen))), UNKNOWN_MODEL_WEIGHT)
    mission_site = expected * free_share ** (sites / (sites + 1.0))
    mean = float(np.mean(np.nan_to_num(free_of_tracks), dtype=np.float64))
    each = logit(np.clip((mean, mission_site), _MIN_PROBABILITY, expected))
    return float(expit((sites * each[0] + each[1]) / (sites + 1.0)))
