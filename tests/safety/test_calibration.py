from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import SafetyMap
from lunarsim.safety import calibration as dem
from lunarsim.safety.conservative import StochasticSafety

LANDER = Lander()

SPACINGS = ((0.156, 0.156), (0.39, 0.39), (0.8, 0.39), (1.6, 0.78), (0.5, 0.3), (2.0, 0.1))


def maps(p_slope, p_rough, slope, rough, seen=None):
    """Return the two maps of sites with these bounds and shares of the limits (rows, cols)."""
    layers = np.broadcast_arrays(
        *(np.asarray(v, np.float32) for v in (p_slope, p_rough, slope, rough))
    )
    p_slope, p_rough, slope, rough = (np.atleast_2d(v) for v in layers)
    grid = Grid(0.0, 0.0, 1.0, *p_slope.shape)
    seen = np.ones(grid.shape, bool) if seen is None else seen
    nominal = SafetyMap(
        grid, slope * LANDER.slope_limit, rough * LANDER.roughness_limit,
        (slope < 1.0) & (rough < 1.0), np.ones(grid.shape, bool),
    )  # fmt: skip
    return StochasticSafety(grid, p_slope, p_rough, p_slope * p_rough, seen), nominal


@pytest.mark.parametrize("spacing", SPACINGS)
def test_better_ground_never_lowers_the_probability(spacing):
    bounds = ndtr(np.linspace(-6.0, 6.0, 41))
    shares = np.linspace(3.0, 0.0, 41)
    p = dem.calibrated_safety(*maps(bounds[:, None], bounds, 0.5, 0.5), LANDER, spacing)
    assert (np.diff(p, axis=0) >= -1e-6).all()
    assert (np.diff(p, axis=1) >= -1e-6).all()
    p = dem.calibrated_safety(*maps(0.5, 0.5, shares[:, None], shares), LANDER, spacing)
    assert (np.diff(p, axis=0) >= -1e-6).all()
    assert (np.diff(p, axis=1) >= -1e-6).all()
    ends = [
        float(dem.calibrated_safety(*maps(*site), LANDER, spacing)[0, 0])
        for site in ((0.0, 0.0, 3.0, 3.0), (1.0, 1.0, 0.0, 0.0))
    ]
    assert ends[0] < 0.1
    assert ends[1] > 0.9


def test_unobserved_ground_is_not_safe_and_requests_are_checked():
    seen = np.zeros((4, 4), bool)
    seen[1:3] = True
    safety, nominal = maps(np.full((4, 4), 0.9), 0.9, 0.3, 0.3, seen)
    out = dem.calibrated_safety(safety, nominal, LANDER, (0.4, 0.4))
    assert (out[~seen] == 0.0).all()
    assert (out[seen] > 0.5).all()
    for spacing in ((0.0, 0.4), (0.4, 5.0), (np.nan, 0.4)):
        with pytest.raises(InputError, match=r"calibration\.spacing"):
            dem.calibrated_safety(safety, nominal, LANDER, spacing)
    with pytest.raises(InputError, match=r"calibration\.nominal"):
        dem.calibrated_safety(safety, maps(0.9, 0.9, 0.3, 0.3)[1], LANDER, (0.4, 0.4))
