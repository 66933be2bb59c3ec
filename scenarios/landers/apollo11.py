"""Read Apollo 11 target loads and the descent record; compare both with flights.

A load is the set of guidance targets in the computer. The guidance frame of a load is x up, y
cross, z downrange. Downrange is west here, so a value along z is a value along -x of ENU.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from lunarsim import Flight, Scenario
from lunarsim.api import quat_rotate
from lunarsim.models.gravity import CentralGravity
from lunarsim.onboard.guidance.apollo import jerk_time_to_go

Array = NDArray[np.float64]

HERE = Path(__file__).resolve().parent
DATA = HERE.parent / "data"
FEET = 0.3048
# Seconds after ignition (102:33:05 mission time, 20:05:05 UTC), by the event list of the mission
# report: first row of the record, 102:37:53; start of the approach phase, 102:41:32; manual
# rate-of-descent control, 102:43:22; landing, 102:45:40.
LOCK_ON, P64, P66, LANDING = 288.0, 507.0, 617.0, 755.0
# Propellant of the descent stage including descent orbit insertion, kg, and of that insertion: 268
# lb in the mass table of the mission report.
REPORTED, INSERTION = 7_899.0, 121.6
# The digitised chart of the record: propellant used until lock-on and in total, kg. The chart does
# not state whether insertion is included.
CHART_LOCK_ON, CHART = 4_260.0, 7_570.0


Targets = dict[str, tuple[float, float, float]]
# Loads of the guidance computer: the one flown on Apollo 11, and sample values listed for Apollo
# 10.
FLOWN, SAMPLE = "lm_targets_apollo11.csv", "lm_targets.csv"
# Acceleration of the trim phase at minimum thrust in the computer, m/s^2 (TRIMACCL of Luminary
# 099).
TRIM_ACCELERATION = 0.350132708


def read_targets(targets_file: str = FLOWN) -> Targets:
    """Read the guidance targets of an Apollo computer: east, north, up by name.

    `targets_file` is a file name in `scenarios/data`. Components without a value are NaN.
    """
    out = {}
    with (DATA / targets_file).open() as file:
        for row in csv.DictReader(file):
            up, cross, down = (
                float(row[k]) if row[k] else np.nan for k in ("x_up", "y_cross", "z_downrange")
            )
            out[row["name"]] = (-down, cross, up)
    return out


def scalar_target(targets: Targets, name: str) -> float:
    """Return the magnitude of the target `name`, which has one component.

    The sign is dropped.
    """
    return next(abs(v) for v in targets[name] if np.isfinite(v))


def _final_jerk(targets: Targets, phase: str) -> float:
    """Return the target jerk along the velocity at the end of a phase, m/s^3.

    `phase` is "BRFG" (braking) or "APFG" (approach). The value in `targets` is eight times the
    jerk. The result is positive along the final velocity, which points backwards at the end of
    Apollo 11's braking.
    """
    return targets[f"J{phase}*"][0] / 8.0 * float(np.sign(targets[f"V{phase}"][0]))


def with_targets(scenario: Scenario, targets_file: str = FLOWN) -> Scenario:
    """Return a scenario with the guidance targets of a file in all descent phases."""
    targets = read_targets(targets_file)
    high = scenario.vehicle.com_height_m
    braking = {
        "end_position_m": targets["RBRFG"],
        "end_velocity_m_s": targets["VBRFG"],
        "end_acceleration_m_s2": targets["ABRFG"],
        "jerk_m_s3": _final_jerk(targets, "BRFG"),
        "end_time_to_go_s": scalar_target(targets, "TENDBRAK"),
        "min_thrust_time_s": scalar_target(targets, "ZOOMTIME"),
    }
    approach: dict[str, Any] = {
        "vertical_altitude_m": targets["RAPFG"][2] - high,
        "vertical_speed_m_s": -targets["VAPFG"][2],
        "arrival_offset_m": targets["RAPFG"][:2],
        "arrival_velocity_m_s": targets["VAPFG"][:2],
        "arrival_acceleration_m_s2": targets["AAPFG"],
        "jerk_m_s3": _final_jerk(targets, "APFG"),
        "end_time_to_go_s": scalar_target(targets, "TENDAPPR"),
        "time_to_go_s": None,
        "descent_speed_m_s": None,
    }
    if (
        targets_file == SAMPLE
    ):  # the sample load has no first guess of the P64 time and no P65 values
        return scenario.changed(braking=braking, approach=approach)
    approach["time_to_go_s"] = scalar_target(targets, "TENDBRAK") + scalar_target(
        targets, "DELTTFAP"
    )
    approach["descent_speed_m_s"] = -targets["V2FG"][2]
    descent = {"kind": "velocity-null", "time_constant_s": scalar_target(targets, "TAUVERT")}
    return scenario.changed(braking=braking, approach=approach, terminal_descent=descent)


def with_ignition_start(scenario: Scenario, targets_file: str = FLOWN) -> Scenario:
    """Return a scenario that starts at the ignition point of a guidance target file.

    The file gives position (RIGN) and horizontal speed (VIGN) at throttle-up. The speed is
    corrected for the trim at minimum thrust, as in the Apollo software Luminary 099 (IGNALG and
    DDUMCALC). The start is a coast of ZOOMTIME earlier. The coast is assumed to be horizontal at
    RIGN because powered descent began at pericynthion. The time-to-go of the braking phase is set
    to match the start.
    """
    t, moon = read_targets(targets_file), scenario.moon.make().gravity(scenario.gravity_m_s2)
    along, up = abs(t["RIGNZ"][0]), t["RIGNX"][2]
    out = np.array([along, 0.0, up + moon.radius])
    level = np.array([-out[2], 0.0, out[0]]) / np.hypot(out[0], out[2])
    zoom = scalar_target(t, "ZOOMTIME")
    speed = scalar_target(t, "VIGN") + TRIM_ACCELERATION * zoom
    place, velocity = coast(moon, np.array([along, 0.0, up]), speed * level, -zoom)
    way = float(np.sign(t["VBRFG"][0]))
    end = (way * t["RBRFG"][0], way * t["VBRFG"][0], way * t["ABRFG"][0])
    here, guess = (way * place[0], way * velocity[0]), scenario.braking.time_to_go_s
    left = jerk_time_to_go(*here, end, _final_jerk(t, "BRFG"), guess=guess)
    return scenario.changed(
        start={"position_m": place.tolist(), "velocity_m_s": velocity.tolist()},
        braking={"time_to_go_s": left},
    )


def coast(
    moon: CentralGravity, position: Array, velocity: Array, time: float
) -> tuple[Array, Array]:
    """Return position and velocity (3,) after an unpowered coast, m and m/s.

    `time` (s) is the duration of the coast and may be negative.
    """

    def rate(_: float, state: Array) -> Array:
        return np.concatenate((state[3:], moon.free_fall_acceleration(state[:3], state[3:])))

    start = np.concatenate((position, velocity))
    state = solve_ivp(rate, (0.0, time), start, rtol=1e-11, atol=1e-9).y[:, -1]
    return state[:3], state[3:]


def uprange(scenario: Scenario) -> float:
    """Return the great-circle distance from the start to the landing site, m."""
    radius, (x, y, z) = scenario.moon.radius_m, scenario.start.position_m
    return float(radius * np.arctan2(np.hypot(x, y), z + radius))


@dataclass(frozen=True)
class DescentTrack:
    """A descent as a function of time since ignition.

    Attributes
    ----------
    time
        Time since ignition (n,), s.
    altitude
        Altitude above the horizontal plane of the site (n,), m; NaN where unknown.
    pitch
        Angle of the thrust axis from the vertical of the site, backwards along the path (n,), rad.
    """

    time: Array
    altitude: Array
    pitch: Array


def read_flight_record() -> DescentTrack:
    """Read altitude and pitch of the Apollo 11 flight record from its file.

    The inertial platform was aligned with the vertical of the site at landing. The inner gimbal
    angle is therefore the pitch from that vertical. No correction for the arc between vehicle and
    site is needed, and the rotation of the Moon during the descent (0.07 deg) is neglected. Roll
    and the yaw to the face-up attitude (middle and outer gimbal angles) are not used: the
    simulation does not include them.
    """
    with (DATA / "apollo11_descent.csv").open() as file:
        rows = list(csv.DictReader(file))
    time = np.array([float(r["time_s"]) for r in rows]) + LOCK_ON
    height = np.array([float(r["range_m"]) if r["range_m"] else np.nan for r in rows])
    pitch = np.array([float(r["inner_deg"]) if r["inner_deg"] else np.nan for r in rows])
    return DescentTrack(time, height, np.deg2rad((pitch + 180.0) % 360.0 - 180.0))


def track_of(flight: Flight, moon: CentralGravity, com_height: float) -> DescentTrack:
    """Return altitude and pitch of a simulated flight over time.

    The altitude is that of the landing pads above the site; `com_height` is the height of the
    center of mass above the pads, m.
    """
    t = flight.trajectory
    axis = quat_rotate(
        np.column_stack([t[f"attitude_{a}"] for a in "xyzw"]), np.array([0.0, 0.0, 1.0])
    )
    height = moon.height(flight.positions) - flight.target[2] - com_height
    return DescentTrack(t["time"], height, np.arctan2(axis[:, 0], axis[:, 2]))


@dataclass(frozen=True)
class RecordDifference:
    """RMS differences of a simulated flight from the record over a time interval.

    Attributes
    ----------
    altitude, pitch
        Root-mean-square difference, m and rad; NaN without data.
    samples
        Number of samples of the record with an altitude.
    """

    altitude: float
    pitch: float
    samples: int


def record_difference(
    flight: DescentTrack, recorded: DescentTrack, start_time: float, end_time: float
) -> RecordDifference:
    """Return RMS differences of altitude and pitch between a flight and the record.

    `start_time` and `end_time` are in s since ignition.
    """
    part = (recorded.time >= start_time) & (recorded.time < min(end_time, float(flight.time[-1])))
    off = {
        name: np.interp(recorded.time, flight.time, getattr(flight, name)) - getattr(recorded, name)
        for name in ("altitude", "pitch")
    }

    def rms(values: Array) -> float:
        good = values[np.isfinite(values)]
        return float(np.sqrt(np.mean(good**2))) if len(good) else float("nan")

    known = int(np.isfinite(off["altitude"][part]).sum())
    return RecordDifference(rms(off["altitude"][part]), rms(off["pitch"][part]), known)


def event_time(flight: Flight, name: str) -> float:
    """Return the time of a flight's first event of a name, s; NaN if there is none."""
    return next((float(e["time"]) for e in flight.events if e["name"] == name), float("nan"))


def interpolate_at(flight: Flight, values: Array, time: float) -> float:
    """Interpolate values (n,) at the trajectory times of a flight; NaN at time NaN.

    `time` is in s.
    """
    inside = np.isfinite(time)
    return float(np.interp(time, flight.trajectory["time"], values)) if inside else float("nan")


def flight_summary(
    flight: Flight, moon: CentralGravity, com_height: float, max_throttle_thrust: float
) -> dict[str, Any]:
    """Return times, altitudes and propellant of the phases of an Apollo descent.

    `com_height` is the height of the center of mass above the pads, m. `max_throttle_thrust` is the
    thrust of the fixed maximum throttle setting, N.
    """
    track, t = track_of(flight, moon, com_height), flight.trajectory
    after = (t["time"] > 60.0) & (t["thrust"] < 0.99 * max_throttle_thrust)
    recovery = float(t["time"][np.argmax(after)]) if after.any() else float("nan")
    spent = t["mass"][0] - t["mass"]
    jets = float(flight.events[-1].get("thruster_propellant_kg", 0.0))
    approach, last = event_time(flight, "approach"), event_time(flight, "vertical-descent")
    out: dict[str, Any] = {
        "safe": flight.outcome.safe,
        "failure_causes": list(flight.outcome.failure_causes),
        "duration_s": flight.duration,
        "propellant_kg": flight.propellant_used - jets,
        "thruster_propellant_kg": jets,
        "miss_m": float(np.hypot(*(flight.positions[-1, :2] - flight.target[:2]))),
        "burnt_at_lock_on_kg": interpolate_at(flight, spent, LOCK_ON),
    }
    for name, time in (("recovery", recovery), ("approach", approach), ("last", last)):
        out |= {
            f"{name}_s": time,
            f"{name}_altitude_m": interpolate_at(flight, track.altitude, time),
        }
    marks = [0.0, approach, last, flight.duration]
    burnt = np.diff([interpolate_at(flight, spent, time) for time in marks])
    out |= dict(zip(("braking_kg", "approach_kg", "last_kg"), map(float, burnt), strict=True))
    return out
