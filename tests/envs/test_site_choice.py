"""Dispersion wider than a map, and proofs that terrain is out of reach."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards import HazardMap
from lunarsim_envs.sites.flights import observation_of_lane
from tests.envs.site_scene import SMALL, lanes


def test_a_miss_wider_than_the_map_is_spread_all_the_same():
    wide = SMALL.changed(decisions={"touchdown_sigma_m": 40.0}, mappers={"dem": {"size_m": 14.0}})
    many = lanes(1, scenario=wide)
    while not many.maps.seen.any():
        many.decide(np.full((1, 3), np.nan), np.ones(1, bool))
    seen = observation_of_lane(many, 0)
    assert seen.expected_miss == 40.0
    held = HazardMap(
        Grid(*map(float, many.maps.corner[0]), 0.4, *many.maps.p.shape[1:]), many.maps.p[0],
        many.maps.seen[0],
    )  # fmt: skip
    assert many.maps.averaged[0] == pytest.approx(held.dispersed_p_safe(40.0), abs=1e-5)
    assert many.maps.averaged[0].max() > 0.0
