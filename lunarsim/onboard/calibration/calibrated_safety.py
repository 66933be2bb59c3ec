"""Calibrated probability that a site is safe, and where it is a frequency.

A regression was fitted once to all worlds and once without each of them, and the minimum over the
fits is used (`ensemble`). It is a frequency where all fits agree that a site is almost certainly
safe or almost certainly unsafe, and where few unobserved hazards are expected. Elsewhere a fit to
other worlds cannot predict how often a site is safe, and the probability is bounded. Across all
these boundaries, worse evidence never increases the probability.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    conservative_probability,
    out_of_domain_bound,
)
from lunarsim.onboard.calibration.ensemble import Ensemble
from lunarsim.onboard.calibration.evidence import CalibrationEvidence, MapRegression
from lunarsim.onboard.calibration.scenario_calibration import ScenarioCalibration
from lunarsim.typing import Array, BoolArray


def calibrated_safety(
    evidence: CalibrationEvidence,
    model: Ensemble | None = None,
    refit: ScenarioCalibration | None = None,
) -> tuple[NDArray[Any], BoolArray]:
    """Return the calibrated probability of safety, and where it is a frequency.

    Both results have the shape of `evidence.observed`.

    A frequency means that the fraction of safe sites equals the probability. Elsewhere the
    probability is conservative, and 0 where the terrain is not observed. The probability does not
    increase with slope, roughness, or observed or expected rocks.

    Parameters
    ----------
    evidence
        Evidence of the sites of a map.
    model
        Ensemble of regressions; omitted: the ensemble supplied with lunarsim.
    refit
        Calibration fitted to a scenario, with its own last stage and domain; omitted: none.

    Raises
    ------
    InputError
        If `refit` was fitted for another lander or to other regressions than `model`.
    """
    e, regression = evidence, evidence.regression
    model = model or regression.packaged
    if refit is not None:
        refit.check(e.lander, model)
    seen, known = e.observed, e.in_domain
    covered = known if refit is None else refit.domain.contains(e)
    p, claimed = np.zeros(seen.shape, regression.dtype), covered.copy()
    if seen.any():
        upper_bound, p_clear = e.observed_terrain_bound()[seen], e.p_no_rock_under_pads()[seen]
        odds = e.log_odds_bounds(seen, model)
        p[seen] = site_probability(
            regression, odds.low, upper_bound, p_clear, e.outside_domain_bound()[seen],
            known[seen], covered[seen], refit,
        )  # fmt: skip
        if refit is None:
            claimed[seen] &= odds.estimate(
                np.minimum(upper_bound, p_clear),
                regression.max_unsafe_p,
                e.may_be_claimed_unsafe[seen],
            ).agreed
    return p, claimed


def site_probability(
    regression: MapRegression,
    odds: Array,
    upper_bound: Array,
    p_clear: Array,
    outside_bound: Array,
    in_model_domain: BoolArray,
    in_refit_domain: BoolArray,
    refit: ScenarioCalibration | None = None,
) -> Array:
    """Return the safety probability of sites from log odds and upper bounds (n,).

    Outside the domain of the fits, or below the threshold of claimed safety (0.95), the log odds
    are reduced by a wider margin, and the probability is at most `outside_bound`. In the domain of
    a refit, its scenario's own sites account for rocks under the pads; elsewhere `p_clear` limits
    the probability. The result is mixed, with the weight `MapRegression.unknown_model_weight`,
    with a probability that ignores `p_clear` and `outside_bound`, so that sites of very low
    probability can still be ranked. Probabilities in the domain of a refit, and without a refit
    those from 0.95, are not mixed.

    Parameters
    ----------
    regression
        Declaration of the kind of map.
    odds
        Minimum log odds of the sites over the ensemble (n,).
    upper_bound, p_clear, outside_bound
        Results of `observed_terrain_bound`, `p_no_rock_under_pads` and `outside_domain_bound` for
        the sites (n,).
    in_model_domain, in_refit_domain
        Whether each site is in the domain of the ensemble, and in that of the refit (n,); equal
        without a refit.
    refit
        Calibration fitted to a scenario; None: none.
    """
    margin, weight = regression.outside_margin, regression.unknown_model_weight
    both = np.minimum(upper_bound, p_clear)
    unbound = ALMOST_CERTAINLY_SAFE_P * np.minimum(expit(odds), upper_bound)
    if refit is None:
        p = conservative_probability(odds, both, outside_bound, in_refit_domain, margin)
        is_final = p >= ALMOST_CERTAINLY_SAFE_P
    else:
        inside = np.minimum(refit.probability(odds, in_model_domain), upper_bound)
        unbound = np.minimum(unbound, inside)
        lowest = out_of_domain_bound(odds, both, outside_bound, margin)
        p = np.where(in_refit_domain, inside, np.minimum(inside, lowest))
        is_final = in_refit_domain
    return np.asarray(np.where(is_final, p, (1.0 - weight) * p + weight * unbound))
