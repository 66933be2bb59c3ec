"""Test whether navigation declares itself lost when an instrument fails in flight.

The script flies `instruments.toml` over relief of 0 to 8 deg; one instrument at a time fails after
10 s. An error is too large if velocity or attitude exceeds five standard deviations on an axis. A
flight fails undeclared if it ends with such an error and navigation does not declare itself lost.
The policy is not informed: landing results show the effect of a fault.

python scenarios/navigation/faults.py --flights 8 --jobs 2
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from navigation_errors import SCENARIOS, error_of
from undeclared_failures import declared_table

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.api import AltimeterReading, InertialSamples
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import AttitudeReading, DopplerReading
from lunarsim.models.instruments import InertialInstrument
from lunarsim.onboard.navigation.imu_outlier_rejection import ImuSampleLimits
from lunarsim.studies import Case, Report, Study, run_script

RELIEFS = (0.1, 4.0, 8.0)  # RMS slope, deg
FAULT_START_S = 10.0  # start of the fault, s
MAX_ERROR_SIGMA = 5.0  # standard deviations
STEP = 0.01  # interval of inertial samples, s


@dataclass(frozen=True)
class FaultState:
    """Time, limits and random generator that an instrument fault depends on.

    Attributes
    ----------
    elapsed
        Time since the start of the fault, s.
    limits
        Limits beyond which navigation rejects inertial samples.
    rng
        Random generator of the fault.
    """

    elapsed: float
    limits: ImuSampleLimits
    rng: np.random.Generator


Tamper = Callable[[Any, FaultState], Any]


def fault_of_measurement(measurement_type: type, apply_fault: Tamper) -> Tamper:
    """Return a fault that is applied to the measurements of one class only.

    `apply_fault` maps a measurement and the fault state to the faulty measurement.
    """
    return lambda m, now: apply_fault(m, now) if isinstance(m, measurement_type) else m


def drop_samples(samples: InertialSamples, fault: FaultState) -> InertialSamples:
    """Replace a random fifth of the inertial samples of a cycle with NaN."""
    gone = fault.rng.random(len(samples.angle)) < 0.2
    angle, velocity = samples.angle.copy(), samples.velocity.copy()
    angle[gone], velocity[gone] = np.nan, np.nan
    return replace(samples, angle=angle, velocity=velocity)


def add_gyroscope_spike(samples: InertialSamples, fault: FaultState) -> InertialSamples:
    """Add a spike to one gyroscope sample per cycle, just below the rejection limit.

    The spike is a rotation about the x axis.
    """
    angle = samples.angle.copy()
    angle[len(angle) // 2, 0] += (
        0.95 * STEP * (fault.limits.max_change[0] + 0.8 * fault.limits.max_noise[0])
    )
    return replace(samples, angle=angle)


def beam_biases(*biases: float) -> Tamper:
    """Return a fault that adds a constant bias to each Doppler beam.

    `biases` are in m/s, one per beam.
    """
    return fault_of_measurement(
        DopplerReading, lambda m, now: replace(m, speed=m.speed + np.array(biases))
    )


def beam_drifts(*drifts: float) -> Tamper:
    """Return a fault that adds a linear drift to each Doppler beam.

    `drifts` are in m/s^2, one per beam.
    """
    return fault_of_measurement(
        DopplerReading, lambda m, now: replace(m, speed=m.speed + now.elapsed * np.array(drifts))
    )


def star_tracker_rotation(angle: float, rate: float = 0.0) -> Tamper:
    """Return a fault that rotates the attitude of the star tracker about its x axis.

    `angle` is the rotation at the start of the fault (deg), `rate` its rate (deg/s).
    """

    def change(m: AttitudeReading, now: FaultState) -> AttitudeReading:
        off = quat_from_rotation_vector(np.deg2rad([angle + rate * now.elapsed, 0.0, 0.0]))
        return replace(m, attitude=quat_multiply(m.attitude, off))

    return fault_of_measurement(AttitudeReading, change)


def accelerometer_bias(bias: float, rate: float = 0.0) -> Tamper:
    """Return a fault that adds a bias and a drift to the accelerometer x axis.

    `bias` is in m/s^2, `rate` in m/s^3.
    """
    return fault_of_measurement(
        InertialSamples,
        lambda m, now: replace(
            m, velocity=m.velocity + STEP * np.array([bias + rate * now.elapsed, 0.0, 0.0])
        ),
    )


FAULTS: dict[str, Tamper] = {
    "none": lambda m, now: m,
    "altimeter 10 % long": fault_of_measurement(
        AltimeterReading, lambda m, now: replace(m, range=1.1 * m.range)
    ),
    "altimeter 30 m short": fault_of_measurement(
        AltimeterReading, lambda m, now: replace(m, range=m.range - 30.0)
    ),
    "altimeter dead": fault_of_measurement(
        AltimeterReading, lambda m, now: replace(m, range=np.nan)
    ),
    "one beam off by 0.5 m/s": beam_biases(0.5, 0.0, 0.0),
    "one beam off by 0.1 m/s": beam_biases(0.1, 0.0, 0.0),
    "two beams off by 0.1 m/s": beam_biases(0.1, 0.1, 0.0),
    "all beams off by 0.1 m/s": beam_biases(0.1, 0.1, 0.1),
    "all beams off by 0.03 m/s": beam_biases(0.03, 0.03, 0.03),
    "one beam drifts by 0.01 m/s2": beam_drifts(0.01, 0.0, 0.0),
    "all beams drift by 0.01 m/s2": beam_drifts(0.01, 0.01, 0.01),
    "all beams drift by 0.003 m/s2": beam_drifts(0.003, 0.003, 0.003),
    "all beams 5 % slow": fault_of_measurement(
        DopplerReading, lambda m, now: replace(m, speed=0.95 * m.speed)
    ),
    "velocimeter dead": fault_of_measurement(
        DopplerReading, lambda m, now: replace(m, speed=np.full_like(m.speed, np.nan))
    ),
    "tracker turned by 0.5 deg": star_tracker_rotation(0.5),
    "stars drift by 0.002 deg/s": star_tracker_rotation(0.0, 0.002),
    "stars drift by 0.005 deg/s": star_tracker_rotation(0.0, 0.005),
    "stars drift by 0.02 deg/s": star_tracker_rotation(0.0, 0.02),
    "accelerometer off by 0.05 m/s2": accelerometer_bias(0.05),
    "accelerometer drifts by 0.1 m/s3": accelerometer_bias(0.0, 0.1),
    "gyroscope off by 0.05 deg/s": fault_of_measurement(
        InertialSamples,
        lambda m, now: replace(m, angle=m.angle + STEP * np.deg2rad([0.05, 0.0, 0.0])),
    ),
    "gyroscope spikes each cycle": fault_of_measurement(InertialSamples, add_gyroscope_spike),
    "a fifth of the samples lost": fault_of_measurement(InertialSamples, drop_samples),
}


def imu_limits_of(briefing: Briefing) -> ImuSampleLimits:
    """Return the limits beyond which inertial samples of a vehicle are rejected.

    `briefing` holds the data about the vehicle that are known before flight.
    """
    control = briefing.software.control
    unit = next(i for i in briefing.instruments.values() if isinstance(i, InertialInstrument))
    return ImuSampleLimits.of(
        briefing.lander, briefing.step, unit.gyroscopes, unit.accelerometers,
        slew=0.0 if control.torques else control.slew_limit,
    )  # fmt: skip


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight in which an instrument fails.

    The row has whether the velocity or attitude error exceeded five standard deviations at the end
    (`far`), whether navigation declared itself lost at the end, the number of
    `covariance-inflated` events, and whether the landing was safe.
    """
    scenario = Scenario.load(SCENARIOS / "instruments.toml").changed(
        terrain={"rms_slope_deg": case["relief"]}
    )
    simulation = Simulation(scenario, flight_seed(case.seed, case.number), "safest")
    navigation = simulation.computer.navigation
    rng = np.random.default_rng([case.seed, case.number])
    take_unchanged = navigation.take
    limits = imu_limits_of(simulation.briefing)

    def take_faulty(sensor: str, measurement: Any, time: float) -> None:
        if time >= FAULT_START_S:
            measurement = FAULTS[case["fault"]](
                measurement, FaultState(time - FAULT_START_S, limits, rng)
            )
        take_unchanged(sensor, measurement, time)

    navigation.take = take_faulty  # type: ignore[method-assign]
    while not simulation.done:
        # Only in flight: no measurements are taken at rest.
        error = np.abs(error_of(simulation)[3:])
        sigma = np.sqrt(np.diag(simulation.estimate.covariance)[3:])
        far, lost = bool((error > MAX_ERROR_SIGMA * sigma).any()), simulation.computer.estimate.lost
        simulation.step()
    names = [name for _, name, _ in simulation.computer.telemetry]
    return {
        "far": far, "lost": lost, "inflated": names.count("covariance-inflated"),
        "safe": simulation.outcome.safe,
    }  # fmt: skip


def print_declared(report: Report) -> None:
    """Print the number of large errors and of declared failures by fault."""
    groups = [(fault, rows) for (fault,), rows in report.groups("fault").items()]
    title = "Flights with an instrument fault; relief of 0.1, 4 and 8 deg pooled"
    report.print(declared_table(title, "fault", groups))


study = Study(
    fly,
    repeats="flights",
    count=4,
    factors={"fault": list(FAULTS), "relief": RELIEFS},
    factor_help={"fault": "Name of a fault.", "relief": "RMS slope of the terrain (deg)."},
    report=print_declared,
)

if __name__ == "__main__":
    run_script(study)
