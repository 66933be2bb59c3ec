"""Compute scaled features of the sites that a lander can choose."""

from __future__ import annotations

import numpy as np

from lunarsim.typing import Array, BoolArray
from lunarsim_envs.sites.site_inputs import SITES, SiteInputs

# Input quantities (features) of a site. The constants below are their scales.
FEATURES = (
    "log-odds of p_safe", "propellant minus that of the current site", "distance",
    "1 for the current site", "1 if observed", "altitude", "expected miss",
    "log-odds minus those of the best site",
)  # fmt: skip
_LOG_ODDS, _PROPELLANT, _DISTANCE, _ALTITUDE, _MISS = 5.0, 2.0, 30.0, 200.0, 1.0
# Bounds of p_safe before log-odds: beyond them, model errors of the map dominate.
_LEAST, _MOST = 1e-6, 0.999


def site_features(inputs: SiteInputs) -> tuple[Array, BoolArray]:
    """Compute network inputs (n, 21, features) of all sites that n landers can choose.

    Option 0 is the current site, option i is candidate site i - 1. Also returns which options are
    available (n, 21). `FEATURES` names the inputs.
    """
    n, m = len(inputs.site), min(SITES, inputs.p_safe.shape[1])
    p = np.zeros((n, SITES + 1))
    p[:, 0] = np.nan_to_num(inputs.here[:, 0], nan=0.0)
    p[:, 1 : m + 1] = inputs.p_safe[:, :m]
    good = np.zeros((n, SITES + 1), np.bool_)
    good[:, 0] = True
    known = np.arange(m) < inputs.count[:, None]
    good[:, 1 : m + 1] = known & np.isfinite(inputs.cost[:, :m])
    p = np.clip(np.where(good, p, 0.0), _LEAST, _MOST)
    odds = np.log(p / (1.0 - p)) / _LOG_ODDS
    stay = np.where(np.isfinite(inputs.here[:, 1]), inputs.here[:, 1], 0.0)
    x = np.zeros((n, SITES + 1, len(FEATURES)))
    x[..., 0] = odds
    more = np.where(good[:, 1 : m + 1], inputs.cost[:, :m], 0.0) - stay[:, None]
    x[:, 1 : m + 1, 1] = np.where(good[:, 1 : m + 1], more, 0.0) / _PROPELLANT
    x[:, 1 : m + 1, 2] = np.where(known, inputs.distance[:, :m], 0.0) / _DISTANCE
    x[:, 0, 3] = 1.0
    x[..., 4] = 1.0
    x[:, 0, 4] = np.isfinite(inputs.here[:, 0])
    x[..., 5] = ((inputs.position[:, 2] - inputs.site[:, 2]) / _ALTITUDE)[:, None]
    x[..., 6] = (np.nan_to_num(inputs.here[:, 2], nan=0.0) / _MISS)[:, None]
    x[..., 7] = odds - np.where(good, odds, -np.inf).max(axis=1, keepdims=True)
    return x, good
