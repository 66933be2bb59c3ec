"""Ground from a raster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.world.terrain_models.measured import RasterTerrain
from tests.conftest import SCENARIOS

DTM = SCENARIOS / "data" / "hirise_dteec_010228_1490_crop.tif"


def test_posts_too_fine_for_memory_are_refused():
    with pytest.raises(InputError, match=r"terrain\.posting_m: must be at least 0\.\d+ m"):
        RasterTerrain(path=DTM, posting=1e-4).relief()


def test_terrain_between_measured_posts_is_rough_unless_it_is_asked_not_to_be():
    """The posts keep their elevations; between them a spline is smooth."""
    ground = RasterTerrain(
        path=DTM, dtm_window=(0, 60, 0, 60), relief_scale=0.2, rms_slope=np.deg2rad(3.0)
    )
    rough, smooth = ground.relief(), replace(ground, detail=False).relief()
    assert rough.grid == smooth.grid
    every = round(1.0 / rough.grid.posting)
    assert rough.z[::every, ::every] == pytest.approx(smooth.z[::every, ::every], abs=1e-4)
    bend = [np.std(np.diff(relief.z, 2)) for relief in (rough, smooth)]
    assert bend[0] > 1.5 * bend[1]


def test_terrain_is_carried_on_beyond_its_raster_by_mirrors():
    """The middle is what was measured; beyond it lies what lies as far within its edges."""
    own = RasterTerrain(path=DTM, relief_scale=0.2, detail=False, posting=2.0)
    wide, narrow = replace(own, mirrored_size=300.0).relief(), own.relief()
    west, east, south, north = wide.grid.extent
    assert 300.0 <= min(east - west, north - south) < 306.0
    col, row = (
        round((a - b) / narrow.grid.posting)
        for a, b in ((narrow.grid.x0, wide.grid.x0), (narrow.grid.y0, wide.grid.y0))
    )
    rows, cols = narrow.grid.shape
    assert np.array_equal(wide.z[row : row + rows, col : col + cols], narrow.z)
    assert wide.grid.centre_of(row, col) == pytest.approx(narrow.grid.centre_of(0, 0))
    for off in (1, 7, cols - 1):
        last = col + cols - 1
        assert np.array_equal(wide.z[:, last + off], wide.z[:, last - off])
        assert np.array_equal(wide.z[:, col - off], wide.z[:, col + off])
    assert np.array_equal(wide.z[row - 5], wide.z[row + 5])
    assert replace(own, mirrored_size=10.0).relief().grid == narrow.grid
    with pytest.raises(InputError, match=r"terrain\.posting_m: must be at least"):
        replace(own, mirrored_size=1e6).relief()
