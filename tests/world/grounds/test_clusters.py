"""Blocks about craters."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.world.terrain import CraterClusters, place_rocks
from tests.worlds import flat_terrain


def test_blocks_thin_with_the_cube_of_the_distance():
    """Of those between the rim and five radii, (1 - 1/q) / (1 - 1/5) lie within q radii."""
    plane = flat_terrain(size=400.0).relief
    x, y, radius = np.array([-60.0, 80.0]), np.array([20.0, -50.0]), np.array([20.0, 10.0])
    rng = np.random.default_rng(3)
    rocks = place_rocks(
        plane, np.full(4000, 0.02), rng, clusters=CraterClusters(x, y, radius, 0.75)
    )
    away = np.hypot(rocks.x[:, None] - x, rocks.y[:, None] - y) / radius
    # Even ground has 1000 in 160,000 m^2; the areas within five radii hold some of them too.
    even = 1000.0 / 400.0**2
    for k, share in enumerate((0.8, 0.2)):  # by area
        for q in (1.5, 2.0, 3.0, 5.0):
            inside = np.sum((away[:, k] >= 1.0) & (away[:, k] <= q))
            wanted = 3000.0 * share * (1.0 - 1.0 / q) / 0.8
            wanted += even * np.pi * radius[k] ** 2 * (q**2 - 1.0)
            assert inside == pytest.approx(wanted, abs=4.0 * np.sqrt(wanted) + 1.0)
    none = np.sum(away < 1.0)
    assert none == pytest.approx(even * np.pi * 500.0, abs=12.0)


def scenario(**changes: dict) -> Scenario:
    table = {
        "name": "blocks",
        "terrain": {
            "size_m": 200.0, "posting_m": 1.0, "detail_m": 0.0, "preset": "mare",
            "crater_degradation": "diffusion",
        },
        "rocks": {"min_diameter_m": 0.5, "cluster_fraction": 0.8,
        "min_block_crater_diameter_m": 12.0},
    }  # fmt: skip
    for name, values in changes.items():
        table[name] = {**table.get(name, {}), **values}
    return Scenario.from_dict(table)


def test_a_scenario_has_them_about_its_own_craters():
    near = {}
    for share in (0.0, 0.8):
        made = scenario(rocks={"cluster_fraction": share, "min_block_crater_diameter_m": 30.0})
        ground = made.terrain.make()
        rocks = ground.build(made.rocks.make(), RandomStreams(5)).rocks
        craters = ground.craters(ground.relief())
        large = craters.diameter >= 30.0
        away = np.hypot(rocks.x[:, None] - craters.x[large], rocks.y[:, None] - craters.y[large])
        away /= 0.5 * craters.diameter[large]
        near[share] = ((away > 1.0) & (away < 2.0)).any(axis=1).mean()
    assert 0.0 < near[0.0] < 0.5
    assert near[0.8] > 1.4 * near[0.0]


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"terrain": {"crater_degradation": "uniform"}}, "rocks.cluster_fraction"),
        ({"terrain": {"crater_density": 0.0}}, "rocks.cluster_fraction"),
        ({"rocks": {"min_block_crater_diameter_m": 500.0}}, "rocks.cluster_fraction"),
        ({"rocks": {"cluster_fraction": 1.5}}, "rocks.cluster_fraction"),
    ],
)
def test_blocks_need_craters(changes, field):
    with pytest.raises(InputError, match=field):
        made = scenario(**changes)
        made.terrain.make().build(made.rocks.make(), RandomStreams(5))
