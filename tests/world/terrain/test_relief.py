from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.world.terrain import Heightfield, fractal_relief


@pytest.mark.parametrize("hurst", [0.5, 0.8])
def test_fractal_relief_has_the_asked_roughness(hurst):
    grid = Grid.centred((0.0, 0.0), 128.0, 0.5)
    relief = fractal_relief(grid, np.random.default_rng(4), hurst=hurst, rms_slope=np.deg2rad(5.0))
    z = relief.z.astype(float)
    dx, dy = (z[:, 2:] - z[:, :-2]) / 1.0, (z[2:] - z[:-2]) / 1.0
    rms = np.sqrt(np.mean(dx**2) + np.mean(dy**2))
    assert np.rad2deg(np.arctan(rms)) == pytest.approx(5.0, rel=1e-3)
    # The structure function grows as lag^(2 H): compare lags of 2 m and 8 m.
    growth = [np.mean((z[:, s:] - z[:, :-s]) ** 2) for s in (4, 16)]
    assert np.log(growth[1] / growth[0]) / np.log(4.0) / 2.0 == pytest.approx(hurst, abs=0.15)


def test_relief_refuses_nonsense():
    grid = Grid.centred((0.0, 0.0), 16.0, 0.5)
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="hurst"):
        fractal_relief(grid, rng, hurst=1.5, rms_slope=0.1)
    with pytest.raises(InputError, match="rms_slope"):
        fractal_relief(grid, rng, hurst=0.5, rms_slope=2.0)
    with pytest.raises(InputError, match="all values are NaN"):
        Heightfield(grid, np.full(grid.shape, np.nan, np.float32))
