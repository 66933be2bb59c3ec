"""Rasters of many formats, orientations, units, scales, projections, no-data and types."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.world.terrain.dtm import load_terrain
from tests.world.terrain.raster_cases import CASES
from tests.world.terrain.rasters import terrain


def test_there_are_many():
    assert len(CASES) >= 40


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_terrain_is_the_analytic_one(case, tmp_path):
    path = case.write(tmp_path)
    if case.refused:
        with pytest.raises(InputError, match=case.refused) as caught:
            load_terrain(path, **dict(case.options))
        assert str(path) in str(caught.value)
        return
    loaded = load_terrain(path, **dict(case.options))
    known = np.isfinite(loaded.z)
    exact = terrain(*np.moveaxis(loaded.grid.centres(), -1, 0), case.size)
    error = loaded.z - exact
    error -= np.median(error[known])
    rounding = 0.5 * case.scale * case.metres if case.dtype.startswith(("int", "uint")) else 0.0
    inner = ndimage.binary_erosion(known, iterations=4)
    assert np.abs(error[inner]).max() <= 1e-3 + 2.0 * rounding
    half_a_post = 0.5 * loaded.grid.posting * np.abs(np.gradient(exact, loaded.grid.posting)).max()
    assert np.abs(error[known]).max() <= 1e-3 + 2.0 * rounding + 0.1 * half_a_post
    assert np.ptp(exact) > 40.0 * (2e-3 + rounding)
    gaps = known.size - known.sum()
    assert (gaps > 0) or case.no_data is None
    assert known.mean() > 0.4
    posting = loaded.grid.posting
    assert min(case.map.true_step) * 0.9 <= posting <= max(case.map.true_step) * 1.3
