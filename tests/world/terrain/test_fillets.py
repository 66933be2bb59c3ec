"""Soil banked against rocks."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.rng import RandomStreams
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.scenario import Scenario
from lunarsim.world.terrain import Terrain, add_fillets, place_rocks
from lunarsim.world.terrain.fillets import FILLET_WIDTH_RADII
from tests.reference.terrain import soil_about
from tests.worlds import flat_terrain


def test_soil_lies_about_rocks_as_a_plain_loop_lays_it():
    relief = flat_terrain(12.0, 0.25).relief
    sizes = np.array([1.5, 1.0, 0.6, 0.6, 2.0])
    rocks = place_rocks(relief, sizes, np.random.default_rng(4), model=RockModel("mixed"))
    # One beyond the edge.
    rocks.x[-1] = 6.5
    found = add_fillets(relief, rocks, 0.3)
    ground = Terrain(relief).elevation(np.column_stack((rocks.x, rocks.y)))
    ground = np.where(np.isfinite(ground), ground, rocks.base + rocks.height)
    points = relief.grid.centres().reshape(-1, 2)
    soil = [soil_about(rocks, 0.3, ground, FILLET_WIDTH_RADII, p) for p in points]
    assert (found.z - relief.z).ravel() == pytest.approx(np.array(soil), abs=1e-6)
    assert 0.0 < np.mean(np.array(soil) > 0.0) < 0.5


def test_no_soil_is_asked_for_by_default():
    relief = flat_terrain(12.0, 0.25).relief
    rocks = RockField.hemispheres([0.0], [0.0], 0.0, 1.0)
    assert add_fillets(relief, rocks, 0.0) is relief
    assert add_fillets(relief, RockField.empty(), 0.3) is relief
    assert Scenario.from_dict({}).rocks.fillet_height_ratio == 0.0


@pytest.mark.parametrize("share", [-0.1, 0.6, float("nan")])
def test_a_share_that_is_none_is_refused(share):
    rocks = RockField.hemispheres([0.0], [0.0], 0.0, 1.0)
    with pytest.raises(InputError, match=r"rocks\.fillet"):
        add_fillets(flat_terrain(12.0, 0.25).relief, rocks, share)


def test_a_scenarios_soil_is_a_part_of_the_terrain_that_all_see():
    plain = {"terrain": {"size_m": 40.0, "posting_m": 0.1}, "rocks": {"cover": 0.05}}
    banked = Scenario.from_dict(plain).changed(rocks={"fillet_height_ratio": 0.3})
    bare = Scenario.from_dict(plain)
    grounds = [
        s.terrain.make().build(s.rocks.make(), RandomStreams(3)) for s in (bare, banked)
    ]  # fmt: skip
    raised = grounds[1].relief.z - grounds[0].relief.z
    assert raised.min() >= 0.0 and raised.max() > 0.05
    assert np.array_equal(grounds[0].rocks.rows(), grounds[1].rocks.rows())
    i, j = np.unravel_index(np.argmax(raised), raised.shape)
    g = grounds[1].relief.grid
    at = np.array([[g.x0 + j * g.posting, g.y0 + i * g.posting, 50.0]])
    hit = grounds[1].cast(at, np.array([[0.0, 0.0, -1.0]]))
    assert 50.0 - hit.range[0] == pytest.approx(float(grounds[1].elevation(at[:, :2])[0]), abs=1e-3)
