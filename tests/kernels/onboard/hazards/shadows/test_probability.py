"""The scaled Bessel function against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import i0e

from lunarsim.onboard.hazards.shadows import _probability_kernels as kernels


def test_the_scaled_bessel_function_is_that_of_scipy():
    x = np.concatenate(([0.0, 3.75], np.geomspace(1e-3, 700.0, 200)))
    assert [kernels.i0e(v) for v in x] == pytest.approx(i0e(x).tolist(), rel=6e-7)
