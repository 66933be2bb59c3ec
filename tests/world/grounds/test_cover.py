"""How much of the ground the rocks of a scenario cover."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.rng import RandomStreams
from lunarsim.rocks.size_distribution import golombek_cover
from lunarsim.scenario import Scenario


@pytest.mark.parametrize(
    ("rocks", "share"),
    [
        ({"shape": "cube"}, 1.0),
        ({"shape": "cube", "cube_area": "disc"}, 4.0 / np.pi),
        ({"shape": "hemisphere"}, 1.0),
        # The area that cubes count by is no other rock's.
        ({"shape": "hemisphere", "cube_area": "disc"}, 1.0),
    ],
)
def test_rocks_cover_what_the_law_says(rocks, share):
    table = {"size_m": 300.0, "posting_m": 3.0, "rms_slope_deg": 0.0}
    made = Scenario.from_dict({"terrain": table, "rocks": {"cover": 0.1, **rocks}})
    field = made.terrain.make().build(made.rocks.make(), RandomStreams(3)).rocks
    width = 2.0 * field.a
    area = width**2 if rocks["shape"] == "cube" else 0.25 * np.pi * width**2
    for least in (0.15, 0.4):
        law = golombek_cover(least, 0.1) - golombek_cover(3.0, 0.1)
        covered = float(area[width >= least].sum()) / 297.0**2
        assert covered == pytest.approx(share * float(law), rel=0.03)


def test_an_area_that_is_none_is_refused():
    with pytest.raises(ValueError, match="cube_area"):
        Scenario.from_dict({"rocks": {"cube_area": "round"}})
