from __future__ import annotations

import numpy as np
import pytest

from lunarsim.rocks.shapes import IRREGULAR, shape_table
from tests.reference import terrain as reference


def test_unit_shapes_stand_upright_with_top_one_and_the_outline_of_a_disc():
    table = shape_table()
    for shape in range(IRREGULAR, len(table.count)):
        planes = table.planes[shape, : table.count[shape]]
        assert np.all(planes[:, 2] >= 0.0)
        e, f = np.meshgrid(np.linspace(-1.5, 1.5, 301), np.linspace(-1.5, 1.5, 301))
        height = reference.unit_height(table.vertices[shape], e.ravel(), f.ravel())
        inside = np.isfinite(height)
        # Points on the top lie on the surface of the half spaces.
        q = np.stack((e.ravel()[inside], f.ravel()[inside], height[inside]), axis=-1)
        assert (q @ planes[:, :3].T - planes[:, 3]).max(axis=1) == pytest.approx(0.0, abs=1e-9)
        assert np.all(height[inside] >= -1e-9)
        assert height.max() == pytest.approx(1.0, abs=0.03)
        assert inside.sum() * 0.01**2 == pytest.approx(np.pi, rel=0.01)
        assert np.hypot(e.flat[inside], f.flat[inside]).max() <= table.reach[shape] + 1e-9
