"""Prior for terrain without a measured elevation, estimated from measured terrain."""

from __future__ import annotations

import numpy as np
from scipy.special import expit, logit

from lunarsim.onboard.calibration.gaussian_dem import UNKNOWN_MODEL_WEIGHT
from lunarsim.onboard.hazards.fusion.priors import FusionPriors
from lunarsim.onboard.hazards.hazard_map import FloatMap
from lunarsim.typing import Array

# Minimum probability in averages of log odds.
_MIN_PROBABILITY = 1e-12


def unobserved_safety_prior(
    p_safe_without_tracks: FloatMap,
    p_no_undetected_rock: Array,
    posting: float,
    priors: FusionPriors,
) -> float:
    """Estimate the probability that unmeasured terrain is safe, from measured terrain.

    Tracked rocks are ignored. The estimate averages, in log odds, the mean probability of the
    measured terrain and the terrain prior, and never exceeds the prior. The weight of the measured
    terrain is the number of footprints of the lander that fit on it; the weight of the prior is
    one. The prior is reduced by the mean probability of no undetected rock on measured terrain,
    the more the more terrain is measured: undetected rocks may stand on unmeasured terrain too.

    Parameters
    ----------
    p_safe_without_tracks
        Probability that each measured cell is safe, ignoring tracked rocks (n,); NaN counts as 0.
    p_no_undetected_rock
        Probability of no undetected rock in each measured cell (n,), which is a factor of
        `p_safe_without_tracks`; NaN counts as 0.
    posting
        Cell size, m.
    priors
        Lander and terrain prior expected by the mission.
    """
    lander, expected = priors.lander, priors.terrain_prior
    number = len(p_safe_without_tracks)
    if number == 0 or expected <= _MIN_PROBABILITY:
        return expected
    footprint = np.pi * (lander.leg_radius + 0.5 * lander.pad_diameter) ** 2
    sites = min(posting**2 / footprint, 1.0) * number
    free_share = max(float(np.mean(np.nan_to_num(p_no_undetected_rock))), UNKNOWN_MODEL_WEIGHT)
    mission_site = expected * free_share ** (sites / (sites + 1.0))
    mean = float(np.mean(np.nan_to_num(p_safe_without_tracks), dtype=np.float64))
    each = logit(np.clip((mean, mission_site), _MIN_PROBABILITY, expected))
    return float(expit((sites * each[0] + each[1]) / (sites + 1.0)))
