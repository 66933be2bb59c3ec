"""What is known never meets what is true: recorded measurements alone give the same commands."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

from lunarsim.onboard.policies.library import Safest, ScoreboardChoice
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight, Simulation
from lunarsim.simulation.recorder import MessageRecorder
from tests.conftest import ROOT, SCENARIOS
from tests.flight_comparison import assert_the_same, replayed

FLASH = {
    "name": "flash",
    "simulation": {"cycle_s": 0.2},
    "sensors": {
        "imu": {"kind": "imu"},
        "fix": {"kind": "navigation-fix"},
        "flash": {"kind": "flash-lidar"},
    },
    "terrain": {"size_m": 80.0},
    "rocks": {"cover": 0.04, "min_diameter_m": 0.4},
    "mappers": {"dem": {"kind": "gaussian-dem", "posting_m": 0.5, "size_m": 50.0}},
}


def flash() -> Scenario:
    return Scenario.from_dict(FLASH)


def camera() -> Scenario:
    return Scenario.load(SCENARIOS / "shadow_nominal.toml").changed(
        terrain={"size_m": 160.0},
        rocks={"min_diameter_m": 0.5},
        start={"position_m": [-90.0, -90.0, 130.0], "velocity_m_s": [8.0, 8.0, -9.0]},
        approach={"time_to_go_s": None},
        sensors={"camera": {"width": 240, "height": 180}},
        tasking={"camera": {"rate_hz": 2.0}},
        mappers={"rocks": {"posting_m": 0.5, "size_m": 50.0}},
        simulation={"cycle_s": 0.2, "max_time_s": 12.0},
    )


def sweep() -> Scenario:
    return Scenario.load(SCENARIOS / "morpheus.toml").changed(
        terrain={"size_m": 200.0, "field_m": 60.0, "boulders": 100, "craters": 8},
        start={"position_m": [-220.0, 0.0, 150.0], "position_sigma_m": 1.0},
        approach={"time_to_go_s": 30.0},
        simulation={"cycle_s": 0.2, "max_time_s": 12.0},
        tasking={"flash": {"duration_s": 9.0, "rate_hz": 5.0, "size_m": 50.0}},
        prior_map={"size_m": 180.0},
        sensors={"flash": {"rows": 96, "cols": 96, "half_fov_tangent": 0.025}},
        mappers={"sites": {"size_m": 64.0}},
        initial_uncertainty={"position_m": 6.0},
    )


def sites(folder: Path) -> Scenario:
    """Return a sweep that is decided upon while it goes on; the mission wants the north alone."""
    value = np.repeat([0.0, 0.0, 0.0, 1.0, 0.5, 0.5], 6).reshape(6, 6)
    np.savez(folder / "north.npz", value=value, x0=-25.0, y0=-25.0, posting=10.0)
    return sweep().changed(
        start={"position_m": [-220.0, 0.0, 150.0]},
        initial_uncertainty={"position_m": 3.0},
        mappers={"sites": {"interest_path": str(folder / "north.npz")}},
        decisions={"first_altitude_m": 400.0},
    )


def both() -> Scenario:
    return Scenario.load(SCENARIOS / "camera_and_lidar.toml").changed(
        terrain={"size_m": 120.0},
        rocks={"min_diameter_m": 0.5},
        target={"scatter_m": [5.0, 5.0]},
        start={"position_m": [-140.0, 0.0, 180.0], "velocity_m_s": [11.0, 0.0, -9.0]},
        sensors={"camera": {"width": 240, "height": 180}, "flash": {"rows": 64, "cols": 64}},
        tasking={
            "camera": {"rate_hz": 2.0, "first_altitude_m": 160.0},
            "flash": {"altitudes_m": [150.0, 110.0]},
        },
        mappers={
            "dem": {"posting_m": 0.5, "size_m": 50.0},
            "rocks": {"posting_m": 0.5, "size_m": 50.0},
        },
        decisions={"first_altitude_m": 120.0, "last_altitude_m": 40.0},
        simulation={"cycle_s": 0.2, "max_time_s": 12.0},
    )


def instruments() -> Scenario:
    return Scenario.load(SCENARIOS / "instruments.toml").changed(
        terrain={"size_m": 160.0},
        rocks={"min_diameter_m": 0.6},
        start={"position_m": [-140.0, 0.0, 180.0], "velocity_m_s": [11.0, 0.0, -9.0]},
        initial_uncertainty={"position_m": 5.0},
        sensors={"flash": {"rows": 64, "cols": 64}},
        tasking={"flash": {"kind": "periodic", "rate_hz": 2.0}},
        mappers={"dem": {"posting_m": 0.5, "size_m": 50.0}},
        simulation={"cycle_s": 0.2, "max_time_s": 12.0},
    )


# Kinds of measurements that each gives.
_KINDS = {"flash": 3, "camera": 3, "both": 4, "instruments": 5}


def test_a_policy_gets_interest_and_scoreboard_where_there_is_no_world(tmp_path):
    tap = MessageRecorder()
    simulation = Simulation(sites(tmp_path), 2, "scoreboard", tap=tap)
    flight = simulation.run()
    assert flight.decisions
    assert {d["reason"] for d in flight.decisions} == {"best ranked site"}
    observation = simulation.observe()
    board = observation.scoreboard
    assert (board.position[:, 1] > 0.0).all()
    assert observation.hazard_map.value.max() == 1.0
    ranked = [s for s in observation.candidates.source if s == "sites: ranked"]
    assert len(ranked) == len(board.score) > 0
    assert observation.site_eligible
    assert np.isfinite(board.current_site_score)
    hazard_map = flight.hazard_map
    assert not hazard_map.eligible[hazard_map.value == 0.0].any()
    again = Flight.load(flight.save(tmp_path / "flight")).hazard_map
    for layer in ("eligible", "value"):
        a, b = getattr(hazard_map, layer), getattr(again, layer)
        assert a.dtype == b.dtype
        assert np.array_equal(a, b)
    assert_the_same(tap.exchanges, replayed(tap, ScoreboardChoice(), tmp_path))


# The test above replays a sweep; `both` has a camera too.
@pytest.mark.parametrize(
    "make",
    [flash, both, instruments, pytest.param(camera, marks=pytest.mark.slow)],
    ids=lambda f: f.__name__,
)
def test_replayed_measurements_give_the_same_commands_without_a_world(make, tmp_path):
    tap = MessageRecorder()
    simulation = Simulation(make(), 6, "safest", tap=tap)
    flight = simulation.run()
    kinds = {type(m).__name__ for inputs, _, _ in tap.exchanges for _, m in inputs.items}
    assert len(kinds) == _KINDS[make.__name__], kinds
    assert flight.maps
    assert_the_same(tap.exchanges, replayed(tap, Safest(), tmp_path))


def test_the_wall_of_the_replay_stands():
    code = (
        "import sys; sys.path.insert(0, 'tests/simulation'); import replay; "
        "sys.meta_path.insert(0, replay.Wall()); import lunarsim.world"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode != 0
    assert "cannot be imported onboard" in done.stderr


def modules_within(value, seen: set[int]) -> set[str]:
    """Return the modules of all objects that can be reached from a value."""
    if id(value) in seen or isinstance(value, type):
        return set()
    seen.add(id(value))
    found = {type(value).__module__}
    if is_dataclass(value):
        inner = [getattr(value, f.name) for f in fields(value)]
    elif isinstance(value, dict):
        inner = [*value.keys(), *value.values()]
    elif isinstance(value, list | tuple | set):
        inner = list(value)
    elif hasattr(value, "__dict__") and found.isdisjoint({"numpy", "builtins"}):
        inner = list(vars(value).values())
    else:
        inner = []
    return found.union(*(modules_within(v, seen) for v in inner)) if inner else found


@pytest.mark.parametrize(
    "make", [flash, camera, sweep, both, instruments], ids=lambda f: f.__name__
)
def test_no_object_of_the_world_is_within_the_computer(make):
    simulation = Simulation(make(), 6, "truth-oracle")
    for _ in range(3):
        simulation.step()
    within = modules_within(simulation.computer, set())
    assert "lunarsim.onboard.computer" in within
    true = ("lunarsim.world", "lunarsim.vehicle", "lunarsim.sensors", "lunarsim.simulation")
    assert not {m for m in within if m.startswith(true)}


def test_the_computer_does_not_receive_the_true_start():
    simulation = Simulation(camera(), 6)
    start = simulation.computer.briefing.start
    error = start.position - simulation.state.position
    assert 0.1 < np.linalg.norm(error) < 5.0 * np.sqrt(3.0) * start.position_sigma
    assert np.array_equal(simulation.computer.estimate.position, start.position)


def test_mass_onboard_is_what_the_commands_have_burnt():
    simulation = Simulation(flash(), 6, "no-divert")
    flight = simulation.run()
    true, known = flight.trajectory["mass"], flight.trajectory["estimated_mass"]
    assert known[0] == true[0]
    assert not np.array_equal(known, true)
    # The engine's lag is all that tells them apart.
    lag = simulation.lander.thrust_lag * simulation.lander.thrust_max
    assert np.abs(known - true).max() < 1.5 * lag / simulation.lander.exhaust_velocity
