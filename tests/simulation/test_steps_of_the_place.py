"""Steps of the estimated position near the end of a flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.onboard.phases import Phase
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.vehicle.touchdown import Touchdown

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


def flown(phase: Phase, left: float, jump: float = 2.0) -> tuple[float, Touchdown, float]:
    """Fly; let the estimated position jump by `jump`, m, to the north.

    It jumps with the time `left` of the approach, s, or at the height `left` in the vertical
    descent, m. Return the maximum speed north until the end of this phase, m/s, the touchdown, and
    its offset from the estimated site, m.
    """
    simulation = Simulation(Scenario.from_dict(PLAIN), flight_seed(1, 0), None)
    computer = simulation.computer
    honest, jumped, fastest = computer.navigation.estimate, [False], 0.0

    def moved(time: float, mass: float):
        found = honest(time, mass)
        return replace(found, position=found.position + jumped[0] * np.array([0.0, jump, 0.0]))

    computer.navigation.estimate = moved
    while not simulation.done:
        here = computer.time_to_go if phase == Phase.APPROACH else computer.altitude
        jumped[0] = jumped[0] or (computer.phase == phase and here < left)
        simulation.step()
        if jumped[0] and computer.phase == phase:
            fastest = max(fastest, abs(float(simulation.state.velocity[1])))
    assert jumped[0]
    touchdown = simulation.flight().outcome.touchdown
    offset = computer.estimate.position[:2] - computer.site[:2]
    return fastest, touchdown, float(np.hypot(*offset))


def test_a_position_that_jumps_near_the_end_of_the_approach_is_followed_slowly(monkeypatch):
    steady, _, _ = flown(Phase.APPROACH, 4.0)
    as_it_is = "lunarsim.onboard.guidance.command_limits.PositionCorrectionLimiter.limit"
    monkeypatch.setattr(as_it_is, lambda self, estimate, left: estimate)
    followed, _, _ = flown(Phase.APPROACH, 4.0)
    assert steady < 0.35
    assert followed > 1.5 * steady


def test_a_position_that_jumps_early_is_followed_at_once():
    """The limit applies below 12 s. At its minimum rate, the speed would stay below 0.35 m/s."""
    followed, _, _ = flown(Phase.APPROACH, 14.0)
    assert followed > 0.4


def test_positions_of_an_external_navigation_system_are_not_limited(monkeypatch):
    plain = {**PLAIN, "sensors": {"fix": {"kind": "navigation-fix"}}, "control": {"kind": "ideal"}}
    simulation = Simulation(Scenario.from_dict(plain), flight_seed(1, 0), None)
    limit = "lunarsim.onboard.guidance.command_limits.PositionCorrectionLimiter.limit"
    calls: list[float] = []
    monkeypatch.setattr(limit, lambda self, estimate, left: calls.append(left) or estimate)
    for _ in range(10):
        simulation.step()
    assert not calls
    assert not simulation.computer.navigation.has_position_steps


def test_after_a_jump_in_the_vertical_descent_the_lander_returns_and_stops():
    _, touchdown, offset = flown(Phase.VERTICAL, 8.0)
    assert touchdown.horizontal_speed < 0.35
    assert offset < 1.2


@pytest.mark.parametrize("height", [6.0, 4.5, 3.0])
def test_after_a_small_jump_the_lander_touches_down_upright_without_rotation(height):
    _, touchdown, _ = flown(Phase.VERTICAL, height, 0.9)
    assert touchdown.horizontal_speed < 0.3
    assert np.rad2deg(touchdown.rate) < 1.5
    assert np.rad2deg(touchdown.tilt) < 1.0


def test_the_approach_after_a_hover_begins_with_the_estimated_position():
    """The position jumps by 12 m before the vertical descent; the second approach takes 9 s."""
    simulation = Simulation(Scenario.from_dict(PLAIN), flight_seed(1, 0), None)
    computer = simulation.computer
    honest, moved = computer.navigation.estimate, np.zeros(3)

    def jumped(time: float, mass: float):
        found = honest(time, mass)
        return replace(found, position=found.position + moved)

    computer.navigation.estimate = jumped
    hovered = False
    while computer.phase != Phase.VERTICAL:
        if computer.altitude < 14.0:
            moved[1] = 12.0
        simulation.step()
        if hovered and computer.phase == Phase.APPROACH:
            assert computer.time_to_go < 12.0  # s: the rate of corrections is limited
        hovered = hovered or computer.phase == Phase.HOVER
    assert hovered
    assert np.hypot(*(computer.estimate.position - computer.site)[:2]) < 3.0
