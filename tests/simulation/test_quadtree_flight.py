"""The closed loop by LiDAR sweep: lock, sites, policy, touchdown."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.conftest import ROOT


def scenario(**changes):
    base = Scenario.load(ROOT / "scenarios" / "morpheus.toml").changed(
        terrain={"size_m": 200.0, "field_m": 70.0, "boulders": 150, "craters": 12},
        start={"position_m": [-220.0, 0.0, 150.0], "position_sigma_m": 1.0},
        approach={"time_to_go_s": 30.0},
        simulation={"cycle_s": 0.1},
        tasking={"flash": {"duration_s": 9.0, "rate_hz": 10.0, "size_m": 50.0}},
        prior_map={"size_m": 180.0},
        sensors={"flash": {"half_fov_tangent": 0.025}},
        mappers={"sites": {"size_m": 64.0}},
        initial_uncertainty={"position_m": 8.0},
        decisions={"first_altitude_m": 80.0},
    )
    return base.changed(**changes)


# A quarter of the returns of a scan.
FEW = {"flash": {"rows": 64, "cols": 64}}


def filter_of(simulation):
    return simulation.computer.navigation


def mapper_of(simulation):
    return simulation.computer.mappers["sites"]


@pytest.fixture(scope="module")
def flown():
    """A flight, with the state of its first 9 s, and what was known before and after the lock."""
    simulation = Simulation(scenario(), 2, "safest")
    known = SimpleNamespace(simulation=simulation, states=[], offsets=[], points=None)
    while not simulation.done:
        navigation, mapper = filter_of(simulation), mapper_of(simulation)
        before = mapper.map.points.copy() if known.points is None else None
        turned = navigation.map_rotation
        simulation.step()
        if navigation.locked:
            sigma = np.sqrt(np.diag(simulation.estimate.covariance)[:3])
            known.at_lock = simulation.site_error, sigma
            if known.points is None:
                known.points, known.points_after = before, mapper.map.points.copy()
                known.turn = (
                    navigation.map_rotation.rotation_since(turned.rotation)[0],
                    turned.pivot,
                )
                known.grid, known.site = mapper.grid, simulation.site.copy()
                known.lock_time = simulation.time
        if simulation.time < 9.0:
            estimate = simulation.estimate
            known.states.append(np.concatenate((estimate.position, estimate.velocity)))
            known.offsets.append(navigation.site_to_local.offset)
            known.early_site, known.early_grid = simulation.site.copy(), mapper.grid
    known.flight = simulation.flight()
    return known


def test_a_policy_lands_on_the_quadtree(flown):
    simulation, flight = flown.simulation, flown.flight
    assert flight.outcome.safe, flight.outcome
    names = [event["name"] for event in flight.events]
    assert names[:2] == ["scan", "lock"]
    assert len(flight.decisions)
    hazard_map = flight.hazard_map
    assert hazard_map.observed.mean() > 0.3
    # After the lock the site frame and the ground agree; the local frame stays where it was.
    shift = filter_of(simulation).site_to_local.offset
    assert 0.0 < np.linalg.norm(flight.map_error - shift) < 0.5
    assert np.linalg.norm(flight.map_error) > 2.0
    touchdown = flight.outcome.touchdown.position
    aimed = simulation.site - simulation.navigation_error
    assert np.linalg.norm(touchdown[:2] - aimed[:2]) < 0.7


def test_the_map_distinguishes_safe_from_unsafe(flown):
    simulation, flight = flown.simulation, flown.flight
    hazard_map = flight.hazard_map
    there = hazard_map.grid.centres() - flight.map_error[:2]
    safe = simulation.truth.is_safe_at(there)
    seen = hazard_map.observed
    assert hazard_map.p_safe[seen & safe].mean() > hazard_map.p_safe[seen & ~safe].mean() + 0.2
    ground = simulation.world.terrain.relief
    z = type(simulation.world.terrain)(ground).elevation(there)
    gap = hazard_map.elevation - flight.map_error[2] - z
    assert np.nanmedian(np.abs(gap[np.isfinite(hazard_map.elevation)])) < 0.05


def test_the_estimate_is_as_good_as_it_says(flown):
    error, sigma = flown.at_lock
    assert (np.abs(error) < 4.0 * sigma + 0.05).all()
    assert np.linalg.norm(error) < 0.5


def test_a_map_that_lies_aside_moves_the_site_frame_alone():
    offset = np.array([4.0, -3.0, 2.0])
    aside = scenario(
        prior_map={"offset_m": offset.tolist()}, simulation={"max_time_s": 9.0}, sensors=FEW
    )
    simulation = Simulation(aside, 2, "truth-oracle")
    flight = simulation.run()
    assert filter_of(simulation).has_located
    assert simulation.site_error == pytest.approx(offset, abs=0.5)
    # Lander and map share the error: what the map shows at a place is the ground there.
    hazard_map = flight.hazard_map
    z = simulation.world.terrain.elevation(hazard_map.grid.centres() - flight.map_error[:2])
    gap = hazard_map.elevation - flight.map_error[2] - z
    assert np.nanmedian(gap) == pytest.approx(0.0, abs=0.2)


def test_the_local_frame_never_jumps(flown):
    rows, offsets = np.array(flown.states), np.array(flown.offsets)
    assert flown.lock_time < 9.0
    # The lock moves the map by metres, the lander in its local frame by no more than it flies.
    assert np.abs(np.diff(offsets, axis=0)).max() > 3.0
    stride = np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1)
    due = np.linalg.norm(rows[1:, 3:], axis=1) * flown.simulation.scenario.simulation.cycle_s
    # Its first two scans tell of a tilt, 450 m from the ground (1.2 to 1.6 m an axis till then).
    assert stride[0] < due[0] + 0.36
    assert (stride[1:] < due[1:] + 0.35).all()
    # The site is where the briefed target is now known to lie.
    target = flown.simulation.computer.briefing.target
    assert flown.early_site[:2] == pytest.approx((target + offsets[-1])[:2])
    assert flown.early_grid.contains(flown.early_site[:2])


def test_two_flights_of_a_seed_are_the_same():
    short = scenario(simulation={"max_time_s": 1.0}, sensors=FEW)
    a, b = (Simulation(short, 5, "safest") for _ in range(2))
    a.run()
    b.run()
    assert np.array_equal(a.estimate.position, b.estimate.position)
    assert np.array_equal(mapper_of(a).map.points, mapper_of(b).map.points)


def test_terrain_is_mapped_from_the_first_scan_and_a_lock_moves_none_of_it(flown):
    before, after = flown.points, cKDTree(flown.points_after)
    assert len(before) > 50_000
    # The site moved by metres, and the map was perhaps laid about it: its points did not move, but
    # for the tilt that the map has told.
    assert np.linalg.norm(flown.site - flown.simulation.computer.briefing.target) > 3.0
    turn, pivot = flown.turn
    there = (before[::50] - pivot) @ turn.T + pivot
    there = there[flown.grid.contains(there[:, :2])]
    assert len(there) > 500
    # Of points as far apart as these a sixth would meet others by chance.
    assert np.mean(after.query(there)[0] < 0.06) > 0.8


def test_interest_comes_from_a_file(tmp_path):
    grid = {"x0": -30.0, "y0": -30.0, "posting": 10.0}
    np.savez(tmp_path / "west.npz", value=np.tile([1.0, 1, 1, 0, 0, 0, 0], (7, 1)), **grid)
    given = scenario(mappers={"sites": {"interest_path": str(tmp_path / "west.npz")}}, sensors=FEW)
    given.save(tmp_path / "s.toml")
    simulation = Simulation(Scenario.load(tmp_path / "s.toml"), 2)
    while simulation.time < 4.0:
        simulation.step()
    ranked = mapper_of(simulation).select().ranked
    assert len(ranked) > 0
    assert max(site.position[0] for site in ranked) < -5.0
    (tmp_path / "none.npz").write_text("no archive")
    for path in ("none.npz", "missing.npz"):
        wrong = scenario(mappers={"sites": {"interest_path": str(tmp_path / path)}})
        with pytest.raises(InputError, match=r"interest_path"):
            Simulation(wrong, 2)
    np.savez(tmp_path / "high.npz", value=np.full((7, 7), 1.5), **grid)
    with pytest.raises(InputError, match="interest"):
        Simulation(scenario(mappers={"sites": {"interest_path": str(tmp_path / "high.npz")}}), 2)


def test_no_site_is_an_answer_too():
    # No ground is even enough: the policy gets a map on which nothing is worth aiming at.
    strict = scenario(
        mappers={"sites": {"sites": {"slope_limit_deg": 1e-3}}}, simulation={"max_time_s": 4.0},
        decisions={"first_altitude_m": 400.0}, sensors=FEW,
    )  # fmt: skip
    simulation = Simulation(strict, 2, "safest")
    simulation.run()
    selection = mapper_of(simulation).select()
    assert selection.ranked == ()
    assert len(selection.nodes) > 100
    observation = simulation.observe()
    assert observation.hazard_map.observed.any()
    assert len(observation.candidates) == 0
    # Without a lock there is a map all the same, and the policy decides on it.
    blind = Simulation(
        scenario(prior_map={"offset_m": [0.0, 0.0, 500.0]}, simulation={"max_time_s": 4.0},
                 decisions={"first_altitude_m": 400.0}, sensors=FEW), 2, "safest",
    )  # fmt: skip
    flight = blind.run()
    assert not filter_of(blind).has_located
    assert flight.hazard_map.observed.any()
    assert len(blind.observe().candidates) > 0


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"tasking": {"flash": {"rate_hz": 30.0}}}, "tasking.flash.rate_hz"),
        ({"tasking": {"flash": {"dwell_rate_hz": 30.0}}}, "tasking.flash.dwell_rate_hz"),
        ({"tasking": {"flash": {"size_m": -1.0}}}, "tasking.flash.size_m"),
        ({"prior_map": {"sigma_m": 0.0}}, "prior_map.sigma_m"),
        ({"prior_map": {"size_m": 600.0}}, None),
        ({"prior_map": {"outdated_fraction": 1.0}}, "prior_map.outdated_fraction"),
        (
            {"mappers": {"sites": {"sites": {"zone_half_side_m": 0.0}}}},
            "mappers.sites.sites.zone_half_side_m",
        ),
        (
            {"mappers": {"sites": {"sites": {"mesh_band_m": [3.2, 1.6]}}}},
            "mappers.sites.sites.mesh_band",
        ),
        ({"mappers": {"sites": {"min_cell_size_m": 1e-9}}}, "mappers.sites.min_cell_size_m"),
        ({"mappers": {"sites": {"split_count": 1}}}, "mappers.sites.split_count"),
        ({"mappers": {"sites": {"size_m": 5.0}}}, "mappers.sites.size_m"),
        ({"terrain": {"field_m": 900.0}}, "terrain.field_m"),
    ],
)
def test_impossible_scenarios_are_refused(changes, field):
    if field is None:
        # A map larger than the ground is a map with an unknown edge.
        simulation = Simulation(scenario(**changes), 1)
        assert np.isnan(filter_of(simulation).matcher.prior.elevation).any()
        return
    with pytest.raises(InputError, match=field):
        Simulation(scenario(**changes), 1)
