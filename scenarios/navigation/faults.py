"""Whether navigation says so when it is wrong: instruments that fail on the way down.

Flies `instruments.toml` over relief of 0 to 8 deg with one instrument at a time failing after 10 s.
An error is too large where velocity or attitude is off by more than five of its standard deviations
on an axis; a flight fails undeclared if it ends so and navigation does not say that it is lost. The
policy is not told: landings show what a fault does.

python scenarios/navigation/faults.py --flights 8 --jobs 2
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import click
import numpy as np
from consistency import SCENARIOS, error_of
from rich.console import Console
from study import declared_table, seed_and_jobs

from lunarsim.campaign.pool import gathered
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    DopplerReading,
    InertialSamples,
)
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

RELIEFS = (0.1, 4.0, 8.0)  # rms slope, deg
BEGINS = 10.0  # s
FAR = 5.0  # standard deviations

Tamper = Callable[[Any, np.random.Generator], Any]


def on(kind: type, change: Tamper) -> Tamper:
    """Return a fault of the measurements of one kind."""
    return lambda m, rng: change(m, rng) if isinstance(m, kind) else m


def lost_samples(m: InertialSamples, rng: np.random.Generator) -> InertialSamples:
    """Drop a fifth of the samples."""
    gone = rng.random(len(m.angle)) < 0.2
    angle, velocity = m.angle.copy(), m.velocity.copy()
    angle[gone], velocity[gone] = np.nan, np.nan
    return replace(m, angle=angle, velocity=velocity)


FAULTS: dict[str, Tamper] = {
    "none": lambda m, rng: m,
    "altimeter 10 % long": on(AltimeterReading, lambda m, rng: replace(m, range=1.1 * m.range)),
    "altimeter 30 m short": on(AltimeterReading, lambda m, rng: replace(m, range=m.range - 30.0)),
    "altimeter dead": on(AltimeterReading, lambda m, rng: replace(m, range=np.nan)),
    "one beam off by 0.5 m/s": on(
        DopplerReading, lambda m, rng: replace(m, speed=m.speed + np.array([0.5, 0.0, 0.0]))
    ),
    "all beams 5 % slow": on(DopplerReading, lambda m, rng: replace(m, speed=0.95 * m.speed)),
    "velocimeter dead": on(
        DopplerReading, lambda m, rng: replace(m, speed=np.full_like(m.speed, np.nan))
    ),
    "tracker turned by 0.5 deg": on(
        AttitudeReading,
        lambda m, rng: replace(
            m,
            attitude=quat_multiply(
                m.attitude, quat_from_rotation_vector(np.deg2rad([0.5, 0.0, 0.0]))
            ),
        ),
    ),
    "accelerometer off by 0.05 m/s2": on(
        InertialSamples,
        lambda m, rng: replace(m, velocity=m.velocity + 0.01 * np.array([0.05, 0.0, 0.0])),
    ),
    "gyroscope off by 0.05 deg/s": on(
        InertialSamples,
        lambda m, rng: replace(m, angle=m.angle + 0.01 * np.deg2rad([0.05, 0.0, 0.0])),
    ),
    "a fifth of the samples lost": on(InertialSamples, lost_samples),
}


@dataclass(frozen=True)
class Task:
    """One flight with one fault."""

    fault: str
    relief: float
    flight: int
    seed: int


@dataclass(frozen=True)
class Flown:
    """What came of it.

    Attributes
    ----------
    far
        Whether velocity or attitude were too far off at the end.
    lost, doubted
        Whether navigation said so, at the end, and how often it doubted a measurement.
    safe
        Whether the lander came down safely.
    """

    fault: str
    far: bool
    lost: bool
    doubted: int
    safe: bool


def fly(task: Task) -> Flown:
    """Fly once with a fault."""
    scenario = Scenario.load(SCENARIOS / "instruments.toml").changed(
        terrain={"rms_slope_deg": task.relief}
    )
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), "safest")
    navigation = simulation.computer.navigation
    rng = np.random.default_rng([task.seed, task.flight])
    honest = navigation.take

    def tampered(sensor: str, measurement: Any, time: float) -> None:
        if time >= BEGINS:
            measurement = FAULTS[task.fault](measurement, rng)
        honest(sensor, measurement, time)

    navigation.take = tampered  # type: ignore[method-assign]
    while not simulation.done:
        # As long as the lander flies: nothing is measured at rest.
        error = np.abs(error_of(simulation)[3:])
        sigma = np.sqrt(np.diag(simulation.estimate.covariance)[3:])
        far, lost = bool((error > FAR * sigma).any()), simulation.computer.estimate.lost
        simulation.step()
    names = [name for _, name, _ in simulation.computer.telemetry]
    return Flown(task.fault, far, lost, names.count("doubted"), simulation.verdict.safe)


@click.command()
@click.option(
    "--flights",
    type=click.IntRange(min=1),
    default=4,
    show_default=True,
    help="Over each relief with each fault.",
)
@click.option(
    "--only",
    type=click.Choice(list(FAULTS)),
    multiple=True,
    help="Fault; may be given again. Left out: every one.",
)
@seed_and_jobs
def main(flights: int, only: tuple[str, ...], seed: int, jobs: int) -> None:
    """Let instruments fail, and see whether navigation says so."""
    console = Console(width=120)
    faults = list(only or FAULTS)
    tasks = [
        Task(fault, relief, n, seed)
        for fault in faults for relief in RELIEFS for n in range(flights)
    ]  # fmt: skip
    flown = gathered(fly, tasks, jobs, console, "flights")
    rows = [(fault, [f for f in flown if f.fault == fault]) for fault in faults]
    title = "Flights with a failing instrument; relief of 0.1, 4 and 8 deg together"
    console.print(declared_table(title, "fault", rows))


if __name__ == "__main__":
    main()
