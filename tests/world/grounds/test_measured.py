"""Ground from a raster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.world.grounds.measured import MeasuredGround
from tests.conftest import SCENARIOS

DTM = SCENARIOS / "data" / "hirise_dteec_010228_1490_crop.tif"


def test_posts_too_fine_for_memory_are_refused():
    with pytest.raises(InputError, match=r"terrain\.posting_m = 0\.0001: .*at least 0\.\d+ m"):
        MeasuredGround(path=DTM, posting=1e-4).relief()


def test_ground_between_measured_posts_is_rough_unless_it_is_asked_not_to_be():
    """The posts keep their elevations; between them a spline is smooth."""
    ground = MeasuredGround(
        path=DTM, dtm_window=(0, 60, 0, 60), relief_scale=0.2, rms_slope=np.deg2rad(3.0)
    )
    rough, smooth = ground.relief(), replace(ground, detail=False).relief()
    assert rough.grid == smooth.grid
    every = round(1.0 / rough.grid.posting)
    assert rough.z[::every, ::every] == pytest.approx(smooth.z[::every, ::every], abs=1e-4)
    bend = [np.std(np.diff(relief.z, 2)) for relief in (rough, smooth)]
    assert bend[0] > 1.5 * bend[1]
