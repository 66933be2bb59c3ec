"""Scattered light and shadows of simple reliefs."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.sensors.rendering import _scattered_light_kernels as kernels


def slopes(z, posting):
    north, east = np.gradient(z, posting)
    return np.stack((east, north), axis=-1)


@pytest.mark.parametrize("angle", [10.0, 25.0, 40.0])
@pytest.mark.parametrize("turned", [False, True])
def test_side_of_a_long_groove_sees_the_other_side(angle, turned):
    """Two walls that rise at an angle t from a line, by the angle that the other one fills.

    What fills the angle a from a wall's own plane on gives it (1 - cos a) / 2 of its light.
    """
    tangent = np.tan(np.radians(angle))
    across = np.arange(-80.0, 81.0)
    z = np.broadcast_to(tangent * np.abs(across), (161, 161)).copy()
    z = z.T.copy() if turned else z
    shine = np.full(z.shape, 0.2)
    found = kernels.scattered_irradiance(z, slopes(z, 1.0), 1.0, shine, 24, 1.1)
    found = found.T if turned else found
    for x in (3.0, 6.0):
        fills = np.radians(angle) + np.arctan(tangent * (80.0 - x) / (80.0 + x))
        told = 0.2 * 0.5 * (1.0 - np.cos(fills))
        assert found[80, 80 + int(x)] == pytest.approx(told, rel=0.05)
        assert found[80, 80 - int(x)] == pytest.approx(told, rel=0.05)


def test_a_plane_sees_nothing_of_itself():
    x, y = np.meshgrid(np.arange(40.0), np.arange(30.0))
    z = 0.3 * x - 0.2 * y
    found = kernels.scattered_irradiance(z, slopes(z, 1.0), 1.0, np.ones(z.shape), 16, 1.2)
    assert np.all((found >= 0.0) & (found < 1e-9))


@pytest.mark.parametrize(("elevation", "azimuth"), [(10.0, 90.0), (25.0, 270.0), (20.0, 0.0)])
def test_a_step_hides_the_sun_as_far_as_it_is_high_over_its_tangent(elevation, azimuth):
    sun = np.radians([azimuth, elevation])
    way = np.array([np.sin(sun[0]), np.cos(sun[0]), 0.0]) * np.cos(sun[1])
    way[2] = np.sin(sun[1])
    along = np.arange(120.0) - 60.0
    ramp = np.where(along >= 0.0, 3.0, 0.0)  # high towards the Sun
    ramp = ramp if azimuth in (90.0, 0.0) else ramp[::-1]
    z = np.tile(ramp, (50, 1)) if azimuth != 0.0 else np.tile(ramp[:, None], (1, 50))
    lit = kernels.lit_posts(z, 1.0, way)
    middle = lit[25] if azimuth != 0.0 else lit[:, 25]
    assert np.count_nonzero(~middle) == pytest.approx(3.0 / np.tan(sun[1]) - 1.0, abs=1.1)
    high = ramp == 3.0
    assert middle[high].all()
