"""Counts of black and lit pixels against plain sums."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.perception import _image_quality_kernels as kernels


def test_black_and_lit_equal_plain_sums():
    rng = np.random.default_rng(6)
    relative, above = (1.3 * rng.random((2, 30, 36))).astype(np.float32)
    patch, ring = np.zeros((2, 30, 36), np.uint16)
    patch[5:12, 6:14], patch[15:25, 20:30] = 1, 2
    ring[3:14, 4:16], ring[13:27, 18:32] = 1, 2
    found = kernels.sum_black_and_lit(relative, above, patch, ring, 2, 0.35, 0.15, 0.5, 0.1)
    v, u = np.mgrid[:30, :36]
    for k in (1, 2):
        own, beside = patch == k, (ring == k) & (patch == 0)
        black = np.where(own, np.clip(0.35 - relative.astype(float), 0.0, None), 0.0)
        lit = np.where(own, np.clip(relative.astype(float) - 0.15, 0.0, 0.5), 0.0)
        lit += np.where(beside, np.clip(above.astype(float) - 1.1, 0.0, 1.0), 0.0)
        sums = [(w * c).sum() for w in (black, lit) for c in (1.0, u, v)]
        assert found[k] == pytest.approx(sums, rel=1e-5)
    assert not found[0].any()
