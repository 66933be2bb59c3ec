"""Rate of change of the state with all actuators."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.vehicle import _kernels as kernels
from lunarsim.vehicle.dynamics import build_rig
from tests.reference import dynamics as plain


@pytest.mark.parametrize("seed", range(6))
def test_rate_of_change_with_all_that_acts(seed):
    rng = np.random.default_rng(seed)
    q = rng.standard_normal(4)
    y = np.concatenate(
        (
            rng.normal(0.0, 100.0, 6),
            q / np.linalg.norm(q),
            rng.normal(0.0, 0.5, 3),
            [1300.0, 2500.0],
        )
    )
    direction = np.array([*rng.normal(0.0, 0.1, 2), 1.0])
    rig = {
        "force": rng.normal(0.0, 80.0, 3), "flow": 0.05,
        "engine": direction / np.linalg.norm(direction), "pivot": rng.normal(0.0, 1.0, 3),
        "com_dry": rng.normal(0.0, 0.1, 3), "com_full": rng.normal(0.0, 0.3, 3),
    }  # fmt: skip
    args = (
        4000.0, rng.normal(0.0, 50.0, 3), 1.6, 3000.0, 0.2, 900.0, 1500.0,
        np.array([700.0, 800.0, 1100.0]), np.array([900.0, 1500.0, 1900.0]),
    )  # fmt: skip
    out = np.empty(15)
    kernels.derivative(y, out, *args, build_rig(**rig))
    wanted = plain.rigged_rate_of_change(y, *args, **rig)
    assert out == pytest.approx(wanted, rel=1e-12, abs=1e-12)
