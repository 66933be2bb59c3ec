"""Commands that take effect late: which one acts at each integration step."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from lunarsim.messages.commands import Command
from lunarsim.scenario.mission import CommandDelay
from lunarsim.simulation import Simulation
from lunarsim.simulation.command_delay import CommandQueue
from tests.external.software import small

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


def test_measurement_tasks_of_a_command_are_done_once():
    queue = CommandQueue(
        CommandDelay(latency=0.15), np.random.default_rng(0), 0.01, Command(0.0, UPRIGHT)
    )
    seen = []
    for n in range(10):
        active, changes = queue.add(Command(1.0, UPRIGHT, tasks=(n,)), 0.0, 10)  # type: ignore[arg-type]
        last = changes[-1][1] if changes else active
        seen += last.tasks
    assert seen == sorted(set(seen))
    assert len(seen) >= 7


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
