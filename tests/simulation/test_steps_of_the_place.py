"""A place that jumps aside near the ground: guidance does not chase it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.onboard.phases import Phase
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

STEP = np.array([0.0, 2.0, 0.0])
PLAIN = {
    "name": "level",
    "simulation": {"cycle_s": 0.2},
    "terrain": {"kind": "fractal", "size_m": 160.0, "posting_m": 1.0, "rms_slope_deg": 0.2},
    "rocks": {"cover": 0.0},
    "start": {
        "position_m": [-200.0, 0.0, 180.0],
        "velocity_m_s": [14.0, 0.0, -12.0],
        "position_sigma_m": 0.0,
        "velocity_sigma_m_s": 0.0,
    },
    "sensors": {
        "imu": {"kind": "imu"},
        "altimeter": {"kind": "radar-altimeter"},
        "velocimeter": {"kind": "velocimeter"},
        "stars": {"kind": "star-tracker"},
    },
    "tasking": {},
    "mappers": {},
}


def flown(phase: str, left: float) -> float:
    """Fly; return the greatest speed north once the place has jumped by 2 m, m/s.

    It does so with so much of the approach left, s, or in the vertical descent from a height, m.
    """
    simulation = Simulation(Scenario.from_dict(PLAIN), flight_seed(1, 0), None)
    computer = simulation.computer
    honest, jumped, fastest = computer.navigation.estimate, [False], 0.0

    def moved(time: float, mass: float):
        found = honest(time, mass)
        return replace(found, position=found.position + jumped[0] * STEP)

    computer.navigation.estimate = moved
    while not simulation.done:
        here = computer.time_to_go if phase == Phase.APPROACH else computer.altitude
        jumped[0] = jumped[0] or (computer.phase == phase and here < left)
        simulation.step()
        if jumped[0]:
            fastest = max(fastest, abs(float(simulation.state.velocity[1])))
    assert jumped[0]
    return fastest


@pytest.mark.parametrize(("phase", "left"), [(Phase.APPROACH, 4.0), (Phase.VERTICAL, 8.0)])
def test_a_place_that_jumps_near_the_end_is_not_chased(phase, left, monkeypatch):
    steady = flown(phase, left)
    as_it_is = "lunarsim.onboard.guidance.command_limits.PositionCorrectionLimiter.limit"
    monkeypatch.setattr(as_it_is, lambda self, estimate, left: estimate)
    chased = flown(phase, left)
    assert steady < 0.35
    assert chased > 1.5 * steady
