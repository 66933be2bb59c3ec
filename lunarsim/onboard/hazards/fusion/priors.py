"""Prior knowledge for the fusion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.gaussian_dem import UNKNOWN_MODEL_WEIGHT
from lunarsim.onboard.hazards.hazard_map import FloatMap
from lunarsim.rocks.population import RockExpectation
from lunarsim.typing import Array


@dataclass(frozen=True)
class FusionPriors:
    """Data known before any observation that the fusion of hazard maps uses.

    Attributes
    ----------
    lander, rocks
        Geometry and limits of the lander; rock population expected by the mission.
    terrain_prior
        Probability that slope and roughness of unmeasured terrain are within the limits of the
        lander.

    Raises
    ------
    InputError
        If the prior is not in [0, 1); 1 is excluded because unmeasured terrain is never certain.
    """

    lander: Lander
    rocks: RockExpectation
    terrain_prior: float = 0.9

    def __post_init__(self) -> None:
        if not 0.0 <= self.terrain_prior < 1.0:
            raise InputError(
                "terrain_prior", self.terrain_prior, "must be at least 0 and less than 1"
            )

    @property
    def height_ratio(self) -> float:
        """Ratio of height to diameter of the expected rocks."""
        fixed = {"hemisphere": 0.5, "cube": 1.0}
        return fixed.get(self.rocks.shape, self.rocks.height_ratio[0])


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
