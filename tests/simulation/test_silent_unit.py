"""An inertial unit that falls silent, and measurements in another order, through the whole loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.messages.measurements import InertialSamples, Measurements
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

SCENARIO = Path(__file__).parents[2] / "scenarios" / "instruments.toml"


def flown(change: Callable[[Measurements], Measurements], seconds: float) -> Simulation:
    """A flight of some seconds whose computer gets other measurements than were made."""
    scenario = Scenario.load(SCENARIO).changed(
        sensors={"flash": {"rows": 48, "cols": 48}}, terrain={"size_m": 400.0}
    )
    simulation = Simulation(scenario, 4, None)
    honest = simulation.computer.update
    simulation.computer.update = lambda given: honest(change(given))
    while simulation.time < seconds - 1e-9:
        simulation.move()
    return simulation


def error(simulation: Simulation) -> np.ndarray:
    """Of velocity and attitude in the site frame (6,), in deviations."""
    navigation, true = simulation.computer.navigation, simulation.state
    believed = navigation.estimate_in_site(simulation.time, 1.0)
    turn = quat_to_rotation_vector(quat_multiply(believed.attitude, quat_conjugate(true.attitude)))
    sigma = np.sqrt(np.diag(believed.covariance)[3:])
    return np.concatenate((believed.velocity - true.velocity, turn)) / sigma


@pytest.mark.parametrize("unit", ["silent", "slow"])
def test_a_silent_unit_costs_certainty_and_no_trust(unit):
    held = []

    def change(given: Measurements) -> Measurements:
        if not 2.05 < given.time < 3.55:
            return given
        held.append(given.time)
        some = [
            (name, replace(m, angle=m.angle[6:], velocity=m.velocity[6:]))
            if isinstance(m, InertialSamples) else (name, m)
            for name, m in given.items
            if unit == "slow" or not isinstance(m, InertialSamples)
        ]  # fmt: skip
        return replace(given, items=tuple(some))

    simulation = flown(change, 5.0)
    told = [details for _, name, details in simulation.computer.telemetry
            if name == "samples-missing"]  # fmt: skip
    assert [one["count"] for one in told] == [10 if unit == "silent" else 6] * len(held)
    assert not simulation.computer.estimate.lost
    assert np.abs(error(simulation)).max() < 5.0
    watches = simulation.computer.navigation.monitors.values()
    assert sum(watch.rejected_count for watch in watches) == 0


def test_a_unit_that_starts_late_costs_certainty_and_no_trust():
    def change(given: Measurements) -> Measurements:
        if given.time > 0.35:
            return given
        items = tuple(item for item in given.items if not isinstance(item[1], InertialSamples))
        return replace(given, items=items)

    simulation = flown(change, 3.0)
    told = [details for _, name, details in simulation.computer.telemetry
            if name == "samples-missing"]  # fmt: skip
    assert told == [{"sensor": "imu", "count": 10}] * 3
    assert not simulation.computer.estimate.lost
    assert np.abs(error(simulation)).max() < 5.0
    watches = simulation.computer.navigation.monitors.values()
    assert sum(watch.rejected_count for watch in watches) == 0


def test_the_order_of_measurements_within_a_cycle_makes_no_difference_to_samples():
    """Inertial samples come first, whatever the order; others as they come."""

    def last(given: Measurements) -> Measurements:
        unit = [item for item in given.items if isinstance(item[1], InertialSamples)]
        rest = [item for item in given.items if not isinstance(item[1], InertialSamples)]
        return replace(given, items=(*rest, *unit))

    plain, other = flown(lambda given: given, 3.0), flown(last, 3.0)
    one, two = (s.computer.navigation for s in (plain, other))
    assert np.array_equal(one.covariance, two.covariance)
    assert np.array_equal(one.inertial.position, two.inertial.position)
