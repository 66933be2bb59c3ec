"""Light that ground throws on ground: closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.sensors.rendering.scattered_light import scattered_light_map
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield


def test_straight_above_and_below_the_horizon():
    grid = Grid.centred((0.0, 0.0), 20.0, 1.0)
    z = np.random.default_rng(0).normal(size=grid.shape).astype(np.float32)
    z[3, 4] = np.nan
    relief = Heightfield(grid, z)
    assert np.all(scattered_light_map(relief, Light(0.0, -0.1, scattered_light=True)).values == 0.0)
    noon = scattered_light_map(relief, Light(0.0, 0.5 * np.pi, scattered_light=True)).values
    assert np.isfinite(noon).all() and (noon[..., 0] >= 0.0).all() and noon[..., 0].max() > 0.0


def test_map_lies_over_its_terrain():
    grid = Grid(100.0, -40.0, 2.0, 30, 20)
    relief = Heightfield(grid, np.zeros(grid.shape, np.float32))
    found = scattered_light_map(relief, Light(scattered_light=True))
    scale = found.from_camera(np.array([110.0, -20.0, 50.0]))
    # The camera is over post (5, 10): the middle of that texel.
    rows, cols = found.values.shape[:2]
    assert scale[2] * cols == pytest.approx(5.5)
    assert scale[3] * rows == pytest.approx(10.5)
    assert scale[0] * cols == pytest.approx(0.5)


def test_hemispherical_albedo_of_lambert_terrain_is_its_albedo():
    light = Light(photometry="lambert", albedo=0.3)
    assert light.hemispheric_albedo([0.1, 0.5, 1.0]) == pytest.approx(0.3, rel=1e-3)
    assert light.diffuse_albedo == pytest.approx(0.3, rel=2e-3)
    # Lunar soil throws a good part of its light back to the Sun: its Bond-like albedo is lower.
    assert 0.02 < Light(photometry="hapke").diffuse_albedo < 0.12


@pytest.mark.parametrize("elevation", [0.5, 1.0, 3.0])
def test_no_light_is_negative_under_a_low_sun(elevation):
    x, y = np.meshgrid(np.arange(90.0), np.arange(90.0))
    z = 4.0 * np.sin(0.15 * x) * np.cos(0.11 * y) + np.random.default_rng(1).normal(0, 0.3, x.shape)
    relief = Heightfield(Grid(0.0, 0.0, 1.0, 90, 90), z.astype(np.float32))
    values = scattered_light_map(relief, Light(elevation=np.radians(elevation))).values
    assert np.all(np.isfinite(values)) and values.min() >= 0.0
    assert np.count_nonzero(values[..., 1] == 0.0) > 50, "some ground about is dark"
