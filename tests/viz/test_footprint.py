"""The picture of a touchdown: pads, planes and bars against the record itself."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import quat_rotate
from lunarsim.rng import flight_seed
from lunarsim.rocks.field import RockField
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.viz import footprint
from lunarsim.world import World
from lunarsim.world.terrain import Terrain
from tests.worlds import TINY_FLIGHT, flat_terrain


@pytest.fixture(scope="module")
def flown():
    """Return a flight that comes down at a heading which no turn of a square hides."""
    scenario = Scenario.from_dict(TINY_FLIGHT).changed(
        rocks={"cover": 0.0}, terrain={"rms_slope_deg": 0.2}, start={"heading_deg": 65.0}
    )
    simulation = Simulation(scenario, flight_seed(1, 0), "no-divert")
    return simulation.run(), simulation.world, simulation.lander


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Return a function that draws and returns the two axes of the picture."""
    kept = []
    monkeypatch.setattr(footprint, "save", lambda figure, path: kept.append(figure))

    def draw(record, world):
        footprint.draw_footprint(record, world, tmp_path / "touchdown.png")
        return kept[-1].axes[:2]

    return draw


def _pads(record, lander):
    """Return the pads over the ground (legs, 2) by the attitude that the record ends with."""
    q = np.array([record.trajectory[f"attitude_{a}"][-1] for a in "xyzw"])
    return record.outcome.touchdown.position[:2] + quat_rotate(q, lander.pads)[:, :2]


def _ground_above(axes, points):
    """Return what the picture shows at points (n, 2), m."""
    image = axes.images[1]
    z, (west, east, south, north) = image.get_array(), image.get_extent()
    rows = ((points[:, 1] - south) / (north - south) * z.shape[0]).astype(int)
    cols = ((points[:, 0] - west) / (east - west) * z.shape[1]).astype(int)
    return np.asarray(z[rows, cols])


def test_pads_stand_as_the_lander_came_down(flown, drawn):
    record, world, lander = flown
    left, _ = drawn(record, world)
    outline = left.patches[0].get_xy()[:-1]
    assert np.abs(outline - _pads(record, lander)).max() < 0.05
    circles = [patch for patch in left.patches if hasattr(patch, "get_radius")]
    assert [c.get_radius() for c in circles] == [0.5 * lander.pad_diameter] * len(outline)
    assert np.array([c.get_center() for c in circles]) == pytest.approx(outline)


@pytest.mark.parametrize("raised", range(4))
def test_no_pad_stands_below_the_terrain(flown, drawn, raised):
    """One pad on a rock: two of the planes of three pads would need another one in the ground."""
    record, world, lander = flown
    level = flat_terrain(size=160.0)
    x, y = _pads(record, lander)[raised]
    one = [np.array([v]) for v in (x, y, 0.0, 0.4, 0.4, 0.2, 0.0)]
    rocky = Terrain(level.relief, RockField(*one, np.array([0])))
    left, _ = drawn(record, World(rocky, 1.622, world.light))
    above = _ground_above(left, left.patches[0].get_xy()[:-1])
    stands = np.abs(above) < 0.05
    assert stands.sum() == 3 and stands[raised] and stands[(raised + 2) % 4]
    assert above[~stands] < -0.1


def test_a_rock_beside_a_pad_lifts_no_pad(flown, drawn):
    record, world, lander = flown
    level = flat_terrain(size=160.0)
    middle, pads = record.outcome.touchdown.position[:2], _pads(record, lander)
    aside = pads[0] + 0.4 * (middle - pads[0]) / np.linalg.norm(middle - pads[0])
    one = [np.array([v]) for v in (*aside, 0.0, 0.15, 0.15, 0.2, 0.0)]
    rocky = Terrain(level.relief, RockField(*one, np.array([0])))
    left, _ = drawn(record, World(rocky, 1.622, world.light))
    assert _ground_above(left, left.patches[0].get_xy()[:-1]) == pytest.approx(0.0, abs=0.01)
    assert _ground_above(left, aside[None]) == pytest.approx(0.2, abs=0.05)


def test_bars_are_the_figures_over_their_limits(flown, drawn):
    record, world, lander = flown
    _, right = drawn(record, world)
    found = record.outcome.touchdown
    names = [text.get_text() for text in right.get_yticklabels()]
    bars = dict(zip(names, (bar.get_width() for bar in right.patches), strict=True))
    assert bars == pytest.approx({
        "Slope": found.slope / lander.slope_limit,
        "Roughness": found.roughness / lander.roughness_limit,
        "Belly clearance": found.roughness / lander.belly_clearance,
        "Vertical speed": found.vertical_speed / lander.vertical_speed_limit,
        "Lateral speed": found.horizontal_speed / lander.horizontal_speed_limit,
        "Tilt": found.tilt / lander.tilt_limit,
        "Angular rate": found.rate / lander.rate_limit,
        "Tipping energy": 1.0 - found.tip_margin,
    })  # fmt: skip
    assert bars["Vertical speed"] > 0.5
