"""The path that is surveyed is the path that is flown: one object says where the approach ends."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.phases import Phase
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.conftest import SCENARIOS


def perfect(scenario: Scenario) -> Scenario:
    """Return a scenario whose vehicle does at once what it is told, and knows where it is."""
    return scenario.changed(
        rocks={"cover": 0.0},
        start={"position_sigma_m": 0.0, "velocity_sigma_m_s": 0.0},
        vehicle={"thrust_lag_s": 0.0},
        control={"kind": "ideal", "slew_limit_deg_s": 90.0},
        navigation={"kind": "fixes"},
        sensors={
            "imu": None,
            "altimeter": None,
            "velocimeter": None,
            "stars": None,
            "camera": None,
            "fix": {
                "kind": "navigation-fix", "position_bias_m": 0.0, "position_drift_m": 0.0,
                "velocity_m_s": 0.0, "attitude_deg": 0.0,
            },
            "flash": {"kind": "flash-lidar", "rows": 16, "cols": 16},
        },
        tasking={"camera": None, "flash": {"kind": "at-altitudes", "altitudes_m": [300.0]}},
        mappers={"rocks": None, "dem": {"kind": "gaussian-dem", "posting_m": 0.5, "size_m": 30.0}},
        approach={"time_to_go_s": None},
        simulation={"cycle_s": 0.02},
    )  # fmt: skip


@pytest.mark.parametrize("name", ["shadow_modified", "shadow_nominal", "golombek"])
def test_thrust_tilt_and_propellant_are_those_surveyed(name):
    scenario = perfect(Scenario.load(SCENARIOS / f"{name}.toml"))
    if scenario.target.scatter_m != (0.0, 0.0):
        scenario = scenario.changed(target={"scatter_m": [0.0, 0.0]})
    simulation = Simulation(scenario, 1)
    computer = simulation.computer
    cost = computer.cost_of(computer.site[None, :])
    simulation.move()
    while computer.phase != Phase.VERTICAL:
        simulation.step()
    t = {k: v[:-1] for k, v in simulation.recorder.trajectory().items()}
    q = np.column_stack([t[f"attitude_{a}"] for a in "xyzw"])
    tilt = np.arccos(quat_to_matrix(q)[1:, 2, 2]).max()
    assert t["thrust"][1:].max() == pytest.approx(cost.peak_thrust[0], rel=0.01)
    assert tilt == pytest.approx(cost.peak_tilt[0], rel=0.01)
    assert t["mass"][0] - t["mass"][-1] == pytest.approx(cost.propellant[0], rel=0.01)
    assert t["time"][-1] == pytest.approx(cost.time_to_go[0], rel=0.01)
