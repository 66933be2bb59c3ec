"""The compiled survey of times-to-go against paths sampled one by one."""

import numpy as np
import pytest

from lunarsim.onboard.guidance import _kernels as kernels
from tests.reference import divert as plain


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("least", "most", "tan_tilt", "glide"),
    [
        (0.0, 1e9, 1e9, -1e9),  # nothing limits
        (2300.0, 5000.0, 1e9, -1e9),
        (0.0, 1e9, 0.4, -1e9),
        (0.0, 1e9, 1e9, 0.6),
        (1500.0, 5500.0, 0.7, 0.3),
    ],
)
def test_cheapest_admissible_time(seed, least, most, tan_tilt, glide):
    rng = np.random.default_rng(seed)
    count, samples = 30, 12
    r, v = np.array([-200.0, 40.0, 260.0]), np.array([14.0, -3.0, -12.0])
    targets = np.column_stack((rng.uniform(-80.0, 80.0, (count, 2)), rng.normal(0.0, 5.0, count)))
    v_f, a_f = np.array([0.3, -0.2, -2.0]), np.array([0.1, 0.05, 0.2])
    times = rng.uniform(15.0, 60.0, (count, 9))
    figures = (samples, 1.62, 1480.0, 3050.0, least, most, tan_tilt, glide)
    out = np.empty((count, 4))
    kernels.survey(r, v, targets, v_f, a_f, times, *figures, out)
    wanted = np.array([
        plain.best(r, v, target, v_f, a_f, row, *figures)
        for target, row in zip(targets, times, strict=True)
    ])  # fmt: skip
    assert out == pytest.approx(wanted, rel=1e-9, nan_ok=True)
    assert np.isfinite(wanted[:, 0]).sum() >= 3
