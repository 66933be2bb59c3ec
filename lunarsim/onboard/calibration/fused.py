"""Last stage of a fused map: C in p = C[pi exp(-Lambda) prod_i (1 - r_i q_i)].

C is close to the identity and increases with the fused probability. A second map of the same
returns contains no independent information, so the two are never multiplied. The second map is
instead a feature of C, with a weight fitted on worlds that are not used for evaluation:

    logit C = logit p + clip(a + (b - 1) logit p + c logit q),  b, c >= 0,

where q is the probability of the second map. The last term is omitted where that map has no
observation.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import expit, logit

from lunarsim.errors import InputError
from lunarsim.onboard.calibration.calibration_files import CalibrationTable, StoredCalibration
from lunarsim.onboard.calibration.stage import StageWeights
from lunarsim.typing import Array

# Maximum magnitude of the log odds, and of their change.
_MAX_LOG_ODDS, _MAX_LOG_ODDS_CHANGE = 10.0, 2.0


@dataclass(frozen=True)
class FusedCalibration(StageWeights, StoredCalibration):
    """Weights of the calibration C of the fused landing probability.

    The calibrated log odds are logit p + clip(a + (b - 1) logit p + c logit q), where p is the
    fused probability and q the probability of a second elevation map.

    Attributes
    ----------
    intercept, slope
        Weights a and b; the defaults leave the log odds unchanged.
    other
        Weight c of the log odds of the second elevation map.
    """

    file_format = "lunarsim fused calibration 1"
    writer = "scenarios/sensor_fusion_calibration.py"

    other: float = 0.0

    def probability(
        self, p: ArrayLike, p_second: ArrayLike, is_second_observed: ArrayLike
    ) -> NDArray[np.float32]:
        """Return the calibrated probability C of a safe landing (...).

        Where `p` is 0, the result is 0.

        Parameters
        ----------
        p, p_second
            Probabilities of a safe landing in the fused map and in the second elevation map (...).
        is_second_observed
            Where the second map has observed the terrain (...).
        """
        own = np.asarray(p, np.float32)
        x, y = _log_odds(own), np.where(is_second_observed, _log_odds(p_second), 0.0)
        change = self.intercept + (self.slope - 1.0) * x + self.other * y
        changed = expit(x + np.clip(change, -_MAX_LOG_ODDS_CHANGE, _MAX_LOG_ODDS_CHANGE)).astype(
            np.float32
        )
        return np.where((own > 0.0) & (change != 0.0), changed, own)

    @classmethod
    def fit(
        cls,
        p: ArrayLike,
        p_second: ArrayLike,
        is_second_observed: ArrayLike,
        safe: ArrayLike,
        unsafe: ArrayLike,
        *,
        site_weight: float = 1.0,
    ) -> FusedCalibration:
        """Fit the weights to groups of sites with known safety by maximum a posteriori.

        The prior has the weight of one site; its mean is the identity (C = p).

        Parameters
        ----------
        p, p_second, is_second_observed
            Probability in the fused map, probability in the second map and whether the second map
            has observed the site, for each group (n,).
        safe, unsafe
            Numbers of safe and unsafe sites in each group (n,).
        site_weight
            Weight of one site in the likelihood, less than 1 because neighbouring sites share their
            terrain.

        Raises
        ------
        InputError
            If safe or unsafe sites are missing.
        """
        x, y = _log_odds(p), np.where(is_second_observed, _log_odds(p_second), 0.0)
        good, bad = (site_weight * np.asarray(n, dtype=np.float64) for n in (safe, unsafe))
        for name, count in (("safe", good.sum()), ("unsafe", bad.sum())):
            if not count > 0.0:
                raise InputError(
                    name, count, "must be more than 0 for some group",
                    "A fit needs safe and unsafe sites.", show_value=False,
                )  # fmt: skip
        identity = np.array([0.0, 1.0, 0.0])
        columns = np.column_stack((np.ones_like(x), x, y))

        def loss(w: Array) -> tuple[float, Array]:
            """Return the negative log posterior of the weights `w` (3,) and its gradient (3,)."""
            odds = columns @ w
            chance = expit(odds)
            value = good @ np.logaddexp(0.0, -odds) + bad @ np.logaddexp(0.0, odds)
            slope = columns.T @ (chance * (good + bad) - good)
            off = w - identity
            return float(value + 0.5 * off @ off), np.asarray(slope + off)

        bounds = [(None, None), (0.0, None), (0.0, None)]
        found = minimize(loss, identity, jac=True, method="L-BFGS-B", bounds=bounds)
        return cls(*(float(w) for w in found.x))

    @classmethod
    def _parsed(cls, table: CalibrationTable) -> FusedCalibration:
        return cls(*(table.number(f.name) for f in fields(cls)))


def _log_odds(p: ArrayLike) -> Array:
    """Return the log odds of probabilities (...), limited to +-10."""
    with np.errstate(divide="ignore"):
        return np.asarray(
            np.clip(logit(np.asarray(p, dtype=np.float64)), -_MAX_LOG_ODDS, _MAX_LOG_ODDS)
        )
