"""Ground from a raster."""

from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.world.grounds.measured import MeasuredGround
from tests.conftest import SCENARIOS

DTM = SCENARIOS / "data" / "hirise_dteec_010228_1490_crop.tif"


def test_posts_too_fine_for_memory_are_refused():
    with pytest.raises(InputError, match=r"terrain\.posting_m = 0\.0001: .*at least 0\.\d+ m"):
        MeasuredGround(path=DTM, posting=1e-4).relief()
