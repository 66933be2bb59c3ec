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
from pathlib import Path
from typing import Any

import click
import numpy as np
from consistency import SCENARIOS, error_of
from study import declared_table, json_option, seed_and_jobs, write_flights

from lunarsim.campaign.pool import gathered
from lunarsim.console import plain_console
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    DopplerReading,
    InertialSamples,
)
from lunarsim.models.instruments import InertialInstrument
from lunarsim.onboard.navigation.sample_guard import SampleLimits
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

RELIEFS = (0.1, 4.0, 8.0)  # rms slope, deg
BEGINS = 10.0  # s
FAR = 5.0  # standard deviations
STEP = 0.01  # between inertial samples, s


@dataclass(frozen=True)
class Failing:
    """What a fault may depend on.

    Attributes
    ----------
    since
        It fails, s.
    limits
        By which inertial samples are judged.
    rng
        Of the fault.
    """

    since: float
    limits: SampleLimits
    rng: np.random.Generator


Tamper = Callable[[Any, Failing], Any]


def on(kind: type, change: Tamper) -> Tamper:
    """Return a fault of the measurements of one kind."""
    return lambda m, now: change(m, now) if isinstance(m, kind) else m


def lost_samples(m: InertialSamples, now: Failing) -> InertialSamples:
    """Drop a fifth of the samples."""
    gone = now.rng.random(len(m.angle)) < 0.2
    angle, velocity = m.angle.copy(), m.velocity.copy()
    angle[gone], velocity[gone] = np.nan, np.nan
    return replace(m, angle=angle, velocity=velocity)


def spiked(m: InertialSamples, now: Failing) -> InertialSamples:
    """Turn one sample of a cycle by nearly as much as would be refused."""
    angle = m.angle.copy()
    angle[len(angle) // 2, 0] += 0.95 * STEP * (now.limits.step[0] + 0.8 * now.limits.noise[0])
    return replace(m, angle=angle)


def speeds_off(*off: float) -> Tamper:
    """Return beams that are off by so much each, m/s."""
    return on(DopplerReading, lambda m, now: replace(m, speed=m.speed + np.array(off)))


def speeds_drift(*rate: float) -> Tamper:
    """Return beams that drift by so much a second each, m/s^2."""
    return on(DopplerReading, lambda m, now: replace(m, speed=m.speed + now.since * np.array(rate)))


def stars_turned(angle: float, rate: float = 0.0) -> Tamper:
    """Return stars that are turned by an angle and turn on, deg and deg/s."""

    def change(m: AttitudeReading, now: Failing) -> AttitudeReading:
        off = quat_from_rotation_vector(np.deg2rad([angle + rate * now.since, 0.0, 0.0]))
        return replace(m, attitude=quat_multiply(m.attitude, off))

    return on(AttitudeReading, change)


def pushes_off(bias: float, rate: float = 0.0) -> Tamper:
    """Return an accelerometer that is off by so much and drifts, m/s^2 and m/s^3."""
    return on(
        InertialSamples,
        lambda m, now: replace(
            m, velocity=m.velocity + STEP * np.array([bias + rate * now.since, 0.0, 0.0])
        ),
    )


FAULTS: dict[str, Tamper] = {
    "none": lambda m, now: m,
    "altimeter 10 % long": on(AltimeterReading, lambda m, now: replace(m, range=1.1 * m.range)),
    "altimeter 30 m short": on(AltimeterReading, lambda m, now: replace(m, range=m.range - 30.0)),
    "altimeter dead": on(AltimeterReading, lambda m, now: replace(m, range=np.nan)),
    "one beam off by 0.5 m/s": speeds_off(0.5, 0.0, 0.0),
    "one beam off by 0.1 m/s": speeds_off(0.1, 0.0, 0.0),
    "two beams off by 0.1 m/s": speeds_off(0.1, 0.1, 0.0),
    "all beams off by 0.1 m/s": speeds_off(0.1, 0.1, 0.1),
    "all beams off by 0.03 m/s": speeds_off(0.03, 0.03, 0.03),
    "one beam drifts by 0.01 m/s2": speeds_drift(0.01, 0.0, 0.0),
    "all beams drift by 0.01 m/s2": speeds_drift(0.01, 0.01, 0.01),
    "all beams drift by 0.003 m/s2": speeds_drift(0.003, 0.003, 0.003),
    "all beams 5 % slow": on(DopplerReading, lambda m, now: replace(m, speed=0.95 * m.speed)),
    "velocimeter dead": on(
        DopplerReading, lambda m, now: replace(m, speed=np.full_like(m.speed, np.nan))
    ),
    "tracker turned by 0.5 deg": stars_turned(0.5),
    "stars drift by 0.002 deg/s": stars_turned(0.0, 0.002),
    "stars drift by 0.005 deg/s": stars_turned(0.0, 0.005),
    "stars drift by 0.02 deg/s": stars_turned(0.0, 0.02),
    "accelerometer off by 0.05 m/s2": pushes_off(0.05),
    "accelerometer drifts by 0.1 m/s3": pushes_off(0.0, 0.1),
    "gyroscope off by 0.05 deg/s": on(
        InertialSamples,
        lambda m, now: replace(m, angle=m.angle + STEP * np.deg2rad([0.05, 0.0, 0.0])),
    ),
    "gyroscope spikes each cycle": on(InertialSamples, spiked),
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


def limits_of(briefing: Briefing) -> SampleLimits:
    """Return the limits by which a lander's inertial samples are judged."""
    control = briefing.software.control
    unit = next(i for i in briefing.instruments.values() if isinstance(i, InertialInstrument))
    return SampleLimits.of(
        briefing.lander, briefing.step, unit.gyroscopes, unit.accelerometers,
        slew=0.0 if control.torques else control.slew_limit,
    )  # fmt: skip


def fly(task: Task) -> Flown:
    """Fly once with a fault."""
    scenario = Scenario.load(SCENARIOS / "instruments.toml").changed(
        terrain={"rms_slope_deg": task.relief}
    )
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), "safest")
    navigation = simulation.computer.navigation
    rng = np.random.default_rng([task.seed, task.flight])
    honest = navigation.take

    limits = limits_of(simulation.briefing)

    def tampered(sensor: str, measurement: Any, time: float) -> None:
        if time >= BEGINS:
            measurement = FAULTS[task.fault](measurement, Failing(time - BEGINS, limits, rng))
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
@json_option
@seed_and_jobs
def main(flights: int, only: tuple[str, ...], out: Path | None, seed: int, jobs: int) -> None:
    """Let instruments fail, and see whether navigation says so."""
    console = plain_console(120)
    faults = list(only or FAULTS)
    tasks = [
        Task(fault, relief, n, seed)
        for fault in faults for relief in RELIEFS for n in range(flights)
    ]  # fmt: skip
    flown = gathered(fly, tasks, jobs, console, "flights")
    rows = [(fault, [f for f in flown if f.fault == fault]) for fault in faults]
    title = "Flights with a failing instrument; relief of 0.1, 4 and 8 deg together"
    console.print(declared_table(title, "fault", rows))
    write_flights(out, rows)


if __name__ == "__main__":
    main()
