"""Compiled projection against that of the camera model."""

import numpy as np

from lunarsim.models._pinhole_kernels import to_pixel, to_tangents
from lunarsim.models.pinhole import Pinhole

HOLE = Pinhole(500.0, 510.0, 319.5, 200.0)


def _points(count=50, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack((rng.uniform(-5.0, 5.0, (count, 2)), rng.uniform(2.0, 20.0, count)))


def test_compiled_kernels_project_as_the_plain_code_does():
    for point, pixel in zip(_points(), HOLE.project(_points()), strict=True):
        np.testing.assert_allclose(to_pixel(*point, *HOLE), pixel, rtol=1e-12)
        tangents = to_tangents(*pixel, *HOLE)
        np.testing.assert_allclose(tangents, point[:2] / point[2], atol=1e-12)
