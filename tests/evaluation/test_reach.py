"""Reach from a flight record: that of the onboard computer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.evaluation.reach import divert_cost_from, estimate_at_row
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation


def test_sites_out_of_reach_of_weak_thrusters_are_out_of_reach_in_the_record():
    scenario = Scenario.from_dict(
        {
            "name": "weak",
            "terrain": {"size_m": 80.0, "rms_slope_deg": 0.0},
            "rocks": {"cover": 0.0},
            "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix"}},
            "tasking": {},
            "mappers": {},
            "vehicle": {"kind": "jet-lander", "thrusters": {"force_n": 4.0}},
            "control": {"kind": "phase-plane"},
            "simulation": {"max_time_s": 1.0},
        }
    )
    simulation = Simulation(scenario, 3, "no-divert")
    flight = simulation.run()
    estimate = replace(
        estimate_at_row(flight, -1), position=np.array([-300.0, 0.0, 250.0]),
        velocity=np.array([20.0, 0.0, -15.0]), attitude=np.array([0.0, 0.0, 0.0, 1.0]),
    )  # fmt: skip
    sites = np.array([[0.0, y, 0.0] for y in (0.0, 40.0, 80.0, 160.0)])
    onboard = simulation.computer.cost_of(sites, estimate)
    recorded = divert_cost_from(flight, estimate, sites)
    assert np.array_equal(recorded.time_to_go, onboard.time_to_go, equal_nan=True)
    free = replace(
        simulation.computer.site_evaluator.rotation_limits, torque=np.inf, max_rate=np.inf
    )
    simulation.computer.site_evaluator.rotation_limits = free
    unlimited = simulation.computer.cost_of(sites, estimate)
    assert not np.array_equal(recorded.time_to_go, unlimited.time_to_go, equal_nan=True)
