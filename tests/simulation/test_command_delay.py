"""Commands that take effect late: which one acts at each integration step."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from lunarsim.messages.commands import Command, SensorTask
from lunarsim.scenario.mission import CommandDelay
from lunarsim.simulation import Simulation
from lunarsim.simulation.command_delay import CommandQueue
from tests.interface.software import small

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def active_commands(
    settings: CommandDelay, cycles: int, steps: int, step: float, times: list[float] | None = None
) -> list[float]:
    """Return the thrust that is active in each integration step; cycle n commands n + 1."""
    queue = CommandQueue(settings, np.random.default_rng(5), step, Command(0.0, UPRIGHT))
    found = []
    for n in range(cycles):
        spent = 0.0 if times is None else times[n]
        active, changes = queue.add(Command(float(n + 1), UPRIGHT), spent, steps)
        thrusts = [active.thrust] * steps
        for start, command in changes:
            thrusts[start:] = [command.thrust] * (steps - start)
        found += thrusts
    return found


def expected(delays: list[Fraction], steps: int, step: Fraction) -> list[float]:
    """Return the same by the definition: the newest command whose time of effect has come."""
    out = []
    for k in range(len(delays) * steps):
        due = [
            n
            for n, delay in enumerate(delays)
            if n * steps <= k and n * steps * step + delay <= k * step
        ]
        out.append(float(due[-1] + 1) if due else 0.0)
    return out


@pytest.mark.parametrize("latency", ["0", "1/100", "3/100", "1/10", "13/100", "1/4", "7/10"])
def test_constant_latency_delays_each_command(latency):
    delay = Fraction(latency)
    found = active_commands(CommandDelay(latency=float(delay)), 20, 10, 0.01)
    assert found == expected([delay] * 20, 10, Fraction(1, 100))


def test_jitter_delays_each_command_by_its_own_time():
    drawn = np.random.default_rng(5).random(200)
    delays = [Fraction(0.02 + 0.25 * one) for one in drawn]
    found = active_commands(CommandDelay(latency=0.02, jitter=0.25), 200, 10, 0.01)
    assert found == expected(delays, 10, Fraction(1, 100))
    assert len(set(found)) < 200  # some commands were overtaken by newer ones


def test_measured_time_is_added_only_on_request():
    times = [0.05, 0.0, 0.31, 0.02, 0.0, 0.0, 0.0, 0.0]
    found = active_commands(CommandDelay(measured=True), 8, 10, 0.01, times)
    assert found == expected([Fraction(str(one)) for one in times], 10, Fraction(1, 100))
    assert active_commands(CommandDelay(), 8, 10, 0.01, times) == expected(
        [Fraction(0)] * 8, 10, Fraction(1, 100)
    )


@pytest.mark.parametrize("jitter", [0.0, 0.35])
def test_measurement_tasks_are_done_once_and_not_lost(jitter):
    queue = CommandQueue(
        CommandDelay(latency=0.05, jitter=jitter), np.random.default_rng(0), 0.01,
        Command(0.0, UPRIGHT),
    )  # fmt: skip
    seen = []
    for n in range(40):
        # Sensors of their own: a newer task of a sensor would replace an older one.
        tasks = (SensorTask(f"sensor {n}", np.eye(3)),) if n < 30 else ()
        active, changes = queue.add(Command(1.0, UPRIGHT, tasks), 0.0, 10)
        last = changes[-1][1] if changes else active
        seen += [task.sensor for task in last.tasks]
    assert sorted(seen) == sorted(f"sensor {n}" for n in range(30))


def test_newer_task_of_a_sensor_replaces_an_overtaken_one():
    queue = CommandQueue(
        CommandDelay(measured=True), np.random.default_rng(0), 0.01, Command(0.0, UPRIGHT)
    )
    old, new = (SensorTask("flash", k * np.eye(3)) for k in (1.0, 2.0))
    queue.add(Command(1.0, UPRIGHT, (old,)), 0.25, 10)
    active, changes = queue.add(Command(2.0, UPRIGHT, (new,)), 0.05, 10)
    assert [task.mount[0, 0] for task in (changes[-1][1] if changes else active).tasks] == [2.0]


def thrust_at(simulation: Simulation) -> np.ndarray:
    return np.array(simulation.flight().trajectory["thrust"])


def test_delayed_flight_is_the_flight_without_delay_until_the_first_command_differs():
    """The true thrust follows the commands one cycle late, and the flight repeats."""
    plain = Simulation(small(), 4, "no-divert")
    late = Simulation(small(command_delay={"latency_s": 0.2}), 4, "no-divert")
    again = Simulation(small(command_delay={"latency_s": 0.2}), 4, "no-divert")
    for simulation in (plain, late, again):
        for _ in range(30):
            simulation.step()
    a, b, c = (thrust_at(one) for one in (plain, late, again))
    assert np.array_equal(b, c)
    assert not np.array_equal(a, b)
    # In the first cycle, the delayed lander keeps the thrust of the start.
    assert b[1] == pytest.approx(b[0], rel=1e-6)


def test_delay_of_nothing_changes_no_bit():
    flights = [
        Simulation(small(**more), 4, "safest").run()
        for more in ({}, {"command_delay": {"latency_s": 0.0}})
    ]
    for name, column in flights[0].trajectory.items():
        assert np.array_equal(column, flights[1].trajectory[name], equal_nan=True), name


def test_change_of_the_command_leaves_the_noise_of_the_gyroscopes():
    """A cycle that is split by an identical command is the same cycle."""
    from lunarsim.simulation.cycle import fly_cycle

    ends = []
    for split in ([], [3, 7]):
        simulation = Simulation(small(), 4, "no-divert")
        for _ in range(10):
            command = simulation.computer.command()
            changes = [(step, command) for step in split]
            cycle = fly_cycle(simulation.plant, simulation.computer.attitude_loop, command, changes)
            simulation.computer.update(cycle.measurements)
        ends.append(simulation.state.as_vector())
    assert np.allclose(*ends, rtol=0.0, atol=1e-9)


def test_lander_with_thrusters_flies_with_a_delay():
    from lunarsim.scenario import Scenario
    from tests.conftest import SCENARIOS

    scenario = Scenario.load(SCENARIOS / "landers" / "nova_c.toml").changed(
        command_delay={"latency_s": 0.03, "jitter_s": 0.04}, simulation={"max_time_s": 5.0}
    )
    flights = [Simulation(scenario, 2, "no-divert").run() for _ in range(2)]
    for name, column in flights[0].trajectory.items():
        assert np.array_equal(column, flights[1].trajectory[name], equal_nan=True), name
    assert np.isfinite(flights[0].trajectory["thrust"]).all()
