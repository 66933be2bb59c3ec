"""Extent, steepness and errors of the relief's tiles against the plain reference."""

import numpy as np
import pytest

from lunarsim.sensors.rendering import _tile_kernels as kernels
from tests.reference import rendering as plain

SIDE, LEVELS, P = 8, 4, 0.5


@pytest.mark.parametrize("shape", [(17, 25), (20, 14), (9, 9), (11, 30)])
def test_tables_of_tiles(shape):
    """Whole tiles and those cut off by the end of the map."""
    z = np.random.default_rng(shape).normal(size=shape).astype(np.float32)
    low, top, steep, error = kernels.tile_tables(z, SIDE, LEVELS, P)
    rows, cols = (range(0, n - 1, SIDE) for n in shape)
    assert low.shape == top.shape == steep.shape == error.shape[1:] == (len(rows), len(cols))
    for a, i in enumerate(rows):
        for b, j in enumerate(cols):
            tile = z[i : i + SIDE + 1, j : j + SIDE + 1].astype(float)
            assert low[a, b] == tile.min()
            assert top[a, b] == tile.max()
            assert steep[a, b] == pytest.approx(plain.steepest(tile) / P)
            wanted = [plain.decimation_error(tile, 2**level) for level in range(LEVELS)]
            assert error[:, a, b] == pytest.approx(wanted)


def test_a_missing_post_forbids_coarser_levels_of_its_tiles():
    z = np.random.default_rng(0).normal(size=(17, 25)).astype(np.float32)
    z[3, 8] = np.nan  # on the edge between two tiles
    z[9:, 17:] = np.nan
    low, top, _, error = kernels.tile_tables(z, SIDE, LEVELS, P)
    assert np.isinf(error[1:]).all(axis=0).tolist() == [[True, True, False], [False, False, True]]
    assert not error[0].any()
    assert low[0, 0] == np.nanmin(z[:9, :9])
    assert top[0, 1] == np.nanmax(z[:9, 8:17])
