"""Figures of flights: what they show is there, and a failure can be seen."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.rng import flight_seed
from lunarsim.rocks.field import RockField
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.map_record import map_remark
from lunarsim.viz import draw_comparison, draw_flight
from lunarsim.viz.comparison import paired_differences
from lunarsim.viz.footprint import draw_footprint
from lunarsim.world import World
from lunarsim.world.terrain import Terrain
from tests.worlds import TINY_FLIGHT

RED = np.array([0xC0, 0, 0])


def _map(p, observed=True, in_domain=None):
    grid = Grid.centred((0.0, 0.0), 4.0, 1.0)
    blank = HazardMap.unobserved(grid)
    p_safe = np.full(grid.shape, 0.0, np.float32)
    p_safe[:] = p
    domain = None if in_domain is None else np.full(grid.shape, in_domain)
    seen = np.full(grid.shape, observed)
    return HazardMap(grid, p_safe, seen, blank.elevation, blank.variance, in_domain=domain)


@pytest.mark.parametrize(
    ("hazard_map", "words"),
    [
        (None, "observed nothing"),
        (_map(0.9, observed=False), "observed nothing"),
        (_map(0.98), "classifies all observed terrain safe: p_safe 0.98 to 0.98"),
        (_map(0.98, in_domain=False), "safe: p_safe 0.98 to 0.98, outside its calibrated domain"),
        (_map(0.1), "classifies no observed terrain safe"),
        (_map([0.1, 0.9, 0.5, 0.6], in_domain=False), "is outside its calibrated domain"),
    ],
)
def test_a_map_that_reports_nothing_is_spoken_of(hazard_map, words):
    assert words in map_remark(hazard_map)


def test_a_map_that_distinguishes_one_place_from_another_is_not():
    assert map_remark(_map([0.1, 0.9, 0.5, 0.6])) is None
    assert map_remark(_map([0.1, 0.9, 0.5, 0.6], in_domain=True)) is None


def test_a_boulder_under_the_belly_is_seen(tmp_path):
    """The same touchdown on level ground, and with one rock put under the lander."""
    scenario = Scenario.from_dict(TINY_FLIGHT).changed(
        rocks={"cover": 0.0}, terrain={"rms_slope_deg": 0.2}
    )
    simulation = Simulation(scenario, flight_seed(1, 0), "no-divert")
    record = simulation.run()
    assert record.outcome.safe
    draw_flight(record, simulation.world, simulation.truth, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "descent.png", "maps.png", "touchdown.png",
    }  # fmt: skip
    x, y = record.outcome.touchdown.position[:2]
    bare = simulation.world.terrain
    one = [np.array([v]) for v in (x, y, float(bare.elevation([x, y])), 0.5, 0.5, 0.6, 0.0)]
    rocky = Terrain(bare.relief, RockField(*one, np.array([0])))
    draw_footprint(record, World(rocky, 1.622, simulation.world.light), tmp_path / "rocky.png")
    assert _red(tmp_path / "touchdown.png") == 0
    assert _red(tmp_path / "rocky.png") > 100


def _red(path):
    """Count the pixels that say that ground touches the belly."""
    picture = cv2.imread(str(path))[..., ::-1].astype(int)
    return int((np.abs(picture - RED).max(axis=2) < 8).sum())


def test_differences_are_of_the_same_flight():
    rows = [
        {"policy": policy, "flight": flight, "tilt_deg": tilt}
        for policy, flight, tilt in [
            ("a", 0, 1.0), ("a", 1, 2.0), ("a", 2, float("nan")),
            ("b", 2, 9.0), ("b", 1, 2.5), ("b", 0, 0.5), ("b", 3, 7.0),
        ]
    ]  # fmt: skip
    assert paired_differences(rows, "a", "b", "tilt_deg").tolist() == [-0.5, 0.5]
    assert paired_differences(rows, "a", "a", "tilt_deg").tolist() == [0.0, 0.0]


def test_a_comparison_in_which_all_failed_is_drawn(tmp_path):
    row = {
        "safe": False, "failure_causes": "slope,belly", "aborted": False, "propellant_kg": 40.0,
        "divert_m": 1.0, "vertical_speed_m_s": 2.0, "horizontal_speed_m_s": 0.1, "tilt_deg": 1.0,
        "map_true_safe": 0, "map_false_safe": 0, "map_false_unsafe": 0, "safe_site_in_reach": False,
    }  # fmt: skip
    rows = [{**row, "policy": p, "flight": f} for p in ("a", "b") for f in range(2)]
    draw_comparison(rows, Scenario.from_dict({}), tmp_path / "c.png")
    assert cv2.imread(str(tmp_path / "c.png")).std() > 20
