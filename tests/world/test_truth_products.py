from __future__ import annotations

import numpy as np
import pytest
import xarray
from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.rocks.field import RockField
from lunarsim.world import World
from lunarsim.world.light import Light
from lunarsim.world.terrain import Terrain
from lunarsim.world.truth_products import TruthProducts, truth_grid
from tests.worlds import SCENARIOS, flat_terrain


def test_maps_of_one_hemisphere_are_its_closed_forms():
    rock = RockField.hemispheres(0.0, 0.0, 0.0, 1.0)
    light = Light(1.5 * np.pi, np.radians(20.0))  # the Sun in the west
    world = World(Terrain(flat_terrain(60.0).relief, rock), 1.622, light)
    maps = TruthProducts.of(world, Lander(), Grid.centred((0.0, 0.0), 24.0, 0.1))
    x, y = np.moveaxis(maps.grid.centres(), -1, 0)
    r = np.hypot(x, y)
    on = r < 0.99
    assert np.array_equal(maps.rock[on], np.zeros(on.sum()))
    assert np.all(maps.rock[r > 1.01] == -1)
    assert np.allclose(maps.elevation[on], np.sqrt(1.0 - r[on] ** 2), atol=1e-6)
    assert np.allclose(maps.slope[on], np.arcsin(r[on]), atol=1e-4)
    assert np.all(maps.slope[r > 1.01] < 1e-6)
    # The shadow on flat ground: the rock's outline drawn out along the Sun's rays.
    c = 1.0 / np.tan(light.elevation)
    inside = (np.abs(y) < 1.0) & (x > 0.0) & (y**2 + (x**2) / (1.0 + c * c) < 1.0) & (r > 1.05)
    edge = np.abs(y**2 + x**2 / (1.0 + c * c) - 1.0) < 0.15
    ground = (r > 1.05) & ~edge
    assert np.array_equal(maps.shadow[ground], inside[ground])
    assert maps.safe.any() and not maps.safe[r < 1.0].any()


def test_night_is_dark_everywhere():
    rock = RockField.hemispheres(0.0, 0.0, 0.0, 1.0)  # its sides are turned towards the Sun
    world = World(Terrain(flat_terrain().relief, rock), 1.622, Light(0.0, -0.1))
    assert TruthProducts.of(world, Lander(), Grid.centred((0.0, 0.0), 20.0, 0.5)).shadow.all()


def test_command_writes_maps_that_open_without_the_package(tmp_path):
    out = tmp_path / "truth.nc"
    arguments = ["terrain", "truth", str(SCENARIOS / "golombek.toml"), "--size", "20"]
    done = CliRunner().invoke(main, [*arguments, "--out", str(out)])
    assert done.exit_code == 0, done.output
    with xarray.open_dataset(out, engine="h5netcdf") as maps:
        assert maps.elevation.attrs["units"] == "m"
        assert maps.safe.shape == (100, 100)
    nowhere = str(tmp_path / "none" / "x.nc")
    assert CliRunner().invoke(main, [*arguments, "--out", nowhere]).exit_code == 2
    for bad in (["--posting", "0"], ["--size", "1e4"]):
        again = tmp_path / "bad.nc"
        assert CliRunner().invoke(main, [*arguments, *bad, "--out", str(again)]).exit_code == 2
        assert not again.exists()


def test_square_beyond_the_terrain_is_refused():
    with pytest.raises(InputError, match="at most"):
        truth_grid(World(flat_terrain(), 1.622), (15.0, 0.0), 20.0, 0.2)
