"""Failures of past missions: the scenarios, and the study that flies them."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim import Simulation
from lunarsim.studies import Case

MISSIONS = ("hakuto_r_m1", "im1", "im2", "slim")


@pytest.fixture
def study(script):
    """Return the script of the study."""
    return script("flown_failures", "flown_failures")


@pytest.mark.parametrize("mission", MISSIONS)
@pytest.mark.parametrize("arm", ["failure", "no fault", "changed"])
def test_each_arm_differs_from_the_flown_failure(study, mission, arm):
    scenario = study.scenario_of(mission, arm)
    flown = study.scenario_of(mission, "failure")
    assert flown.sensor_faults or flown.faults
    assert (scenario == flown) == (arm == "failure")
    if arm == "no fault":
        assert not scenario.sensor_faults
        assert scenario.faults is None


def test_an_engine_lost_halves_the_thrust_of_the_throttle(study):
    lost, usual = (
        Simulation(study.scenario_of("slim", arm), 1, "no-divert").run()
        for arm in ("failure", "no fault")
    )
    n = int(np.searchsorted(usual.trajectory["time"], 16.5 - 1e-6))  # the last common row
    thrust, halved = usual.trajectory["thrust"], lost.trajectory["thrust"]
    assert np.array_equal(halved[: n + 1], thrust[: n + 1])
    # Both engines follow the same command with their lag in the next cycle.
    cycle = usual.trajectory["time"][n + 1] - usual.trajectory["time"][n]
    lag = study.scenario_of("slim", "failure").vehicle.thrust_lag_s
    followed = 1.0 - np.exp(-cycle / lag)
    command = thrust[n] + (thrust[n + 1] - thrust[n]) / followed
    expected = thrust[n] + (0.5 * command - thrust[n]) * followed
    assert halved[n + 1] == pytest.approx(expected, rel=1e-3)
    assert [e for e in lost.events if e["name"] == "fault-started"] == [
        {"time": 16.5, "name": "fault-started", "fault": "engine"}
    ]
    assert lost.trajectory["velocity_z"][-1] < usual.trajectory["velocity_z"][-1] - 0.5


def test_a_flight_of_the_study_reports_its_touchdown(study):
    row = study.fly(Case({"mission": "slim", "arm": "no fault"}, 1, 0))
    assert row["safe"]
    assert 1.5 < row["vertical_speed"] < 2.5
    assert not row["lost"]
