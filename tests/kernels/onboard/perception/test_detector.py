"""Measurement of dark patches against a plain reference."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import quat_from_rotation_vector
from lunarsim.onboard.perception import _patch_kernels as kernels
from tests.reference.shadows import patch
from tests.shadow_scene import SUN, at


def test_measuring_patches_equals_the_plain_reference():
    rng = np.random.default_rng(4)
    state, camera = at((20.0, -35.0, 60.0), quat_from_rotation_vector([0.1, 0.2, 0.3]))
    view = camera.view(state)
    labels = np.zeros((480, 640), np.int32)
    for label in range(1, 30):
        i, j = rng.integers(20, 440), rng.integers(20, 600)
        h, w = rng.integers(2, 20, 2)
        labels[i : i + h, j : j + w] = label
    count = int(labels.max())
    nothing = np.zeros((480, 640), np.uint8)
    level = np.hypot(SUN[0], SUN[1])
    table = kernels.measure_patches(
        labels, count, nothing, nothing, *camera.tangents, view.position, view.axes,
        0.5, SUN[0] / level, SUN[1] / level,
    )  # fmt: skip
    for label in np.unique(labels[labels > 0]):
        found = table[label, [kernels.ALONG, kernels.ACROSS, kernels.LENGTH, kernels.WIDTH,
                              kernels.PIXELS]]  # fmt: skip
        assert found == pytest.approx(patch(labels, label, view, 0.5, SUN), rel=1e-9, abs=1e-6)
