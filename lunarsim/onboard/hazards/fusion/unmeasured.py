"""Ground of which no elevation was measured, beside ground that was."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from lunarsim.onboard.hazards.fusion.terms import FusionTerms
from lunarsim.onboard.hazards.hazard_map import FloatMap
from lunarsim.safety.calibration import UNSURE

Array = NDArray[np.float64]

# Probabilities are averaged on log odds as if none were less.
_NEVER = 1e-12


def prior_beside(
    free_of_tracks: FloatMap, free_of_unseen: Array, posting: float, terms: FusionTerms
) -> float:
    """Return the probability that ground that was not measured is fit, but for tracked rocks.

    It is as likely to be so as what was measured, by the same map and in the mean: were it told by
    another measure, samples so sparse that all they fell on is left in doubt would send the lander
    to where none fell. What the mission expects counts as one site more (sites whose footprints
    overlap are not many) on log odds, so that it matters little beside many, and is never exceeded.
    That site, too, is told by what the map can tell: where rocks may stand unseen on all that was
    measured, so they may there, the more surely the more was measured.

    Parameters
    ----------
    free_of_tracks
        The map's probability that what was measured is fit (n,), but for tracked rocks.
    free_of_unseen
        The part of it that no slope and no roughness enters (n,); NaN where it is not known, as in
        the former, counts as 0.
    posting
        Of the cells, m.
    terms
        What is known beforehand.
    """
    lander, expected = terms.lander, terms.relief_prior
    number = len(free_of_tracks)
    if number == 0 or expected <= _NEVER:
        return expected
    footprint = np.pi * (lander.leg_radius + 0.5 * lander.pad_diameter) ** 2
    sites = min(posting**2 / footprint, 1.0) * number
    told = max(float(np.mean(np.nan_to_num(free_of_unseen))), UNSURE)
    one_more = expected * told ** (sites / (sites + 1.0))
    mean = float(np.mean(np.nan_to_num(free_of_tracks), dtype=np.float64))
    each = logit(np.clip((mean, one_more), _NEVER, expected))
    return float(expit((sites * each[0] + each[1]) / (sites + 1.0)))
