"""Apollo 11's descent as data: the load of targets, the record, and a flight read off beside it.

The guidance frame of the load is x up, y cross, z downrange; here downrange is west, so a value
along z is one along -x of ENU.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_rotate
from lunarsim.models.gravity import CentralGravity
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight

Array = NDArray[np.float64]

HERE = Path(__file__).resolve().parent
DATA = HERE.parent / "data"
FEET = 0.3048
# Seconds after ignition (102:33:05 of mission time, 20:05:05 UTC) by the mission report's list of
# events: the record's first row, 102:37:53; approach phase entered, 102:41:32; rate of descent
# taken in hand, 102:43:22; landing, 102:45:40.
LOCK_ON, P64, P66, LANDING = 288.0, 507.0, 617.0, 755.0
# Propellant of the whole descent stage, kg, descent orbit insertion included, and what that took:
# 268 lb by the mission report's table of masses.
REPORTED, INSERTION = 7_899.0, 121.6
# The digitised chart beside the record: burnt by lock-on, and in all; it does not say from when on.
CHART_LOCK_ON, CHART = 4_260.0, 7_570.0


def targets() -> dict[str, tuple[float, float, float]]:
    """Return the load by name: ENU here, NaN where the load has no value."""
    out = {}
    with (DATA / "lm_targets.csv").open() as file:
        for row in csv.DictReader(file):
            up, cross, down = (
                float(row[k]) if row[k] else np.nan for k in ("x_up", "y_cross", "z_downrange")
            )
            out[row["name"]] = (-down, cross, up)
    return out


def loaded(scenario: Scenario) -> Scenario:
    """Return a scenario with the targets of the load in `[braking]` and `[approach]`."""
    t = targets()
    high = scenario.vehicle.com_height_m

    def only(name: str) -> float:
        # What is no vector stands in any of the columns.
        return next(abs(v) for v in t[name] if np.isfinite(v))

    braking = {
        "end_position_m": t["RBRFG"],
        "end_velocity_m_s": t["VBRFG"],
        "end_acceleration_m_s2": t["ABRFG"],
        "jerk_m_s3": -t["JBRFG*"][0] / 8.0,
        "ends_at_s": only("TENDBRAK"),
        "trim_s": only("ZOOMTIME"),
    }
    approach = {
        "vertical_altitude_m": t["RAPFG"][2] - high,
        "vertical_speed_m_s": -t["VAPFG"][2],
        "arrival_offset_m": t["RAPFG"][:2],
        "arrival_velocity_m_s": t["VAPFG"][:2],
        "arrival_acceleration_m_s2": t["AAPFG"],
        "jerk_m_s3": -t["JAPFG*"][0] / 8.0,
        "ends_at_s": only("TENDAPPR"),
    }
    return scenario.changed(braking=braking, approach=approach)


def own_uprange(scenario: Scenario) -> float:
    """Return the way over the sphere from the load's own point of ignition to the site, m."""
    t, radius = targets(), scenario.moon.radius_m
    return float(radius * np.arctan2(abs(t["RIGNZ"][0]), t["RIGNX"][2] + radius))


def started(scenario: Scenario, uprange: float) -> Scenario:
    """Return a scenario that begins at a way over the sphere from the site, m.

    At the height and the speed, level there, of the load's point of ignition.
    """
    t, radius = targets(), scenario.moon.radius_m
    x, z = abs(t["RIGNZ"][0]), t["RIGNX"][2] + radius
    distance, speed = np.hypot(x, z), abs(t["VIGN"][0])
    a = uprange / radius
    place = [distance * np.sin(a), 0.0, distance * np.cos(a) - radius]
    return scenario.changed(
        start={"position_m": place, "velocity_m_s": [-speed * np.cos(a), 0.0, speed * np.sin(a)]}
    )


@dataclass(frozen=True)
class Track:
    """A descent by time since ignition.

    Attributes
    ----------
    time
        (n,), s.
    altitude
        Over the site's level, m; NaN where there is none.
    pitch
        Of the thrust axis from the site's vertical, back along the way flown, rad.
    """

    time: Array
    altitude: Array
    pitch: Array


def record() -> Track:
    """Return the record of Apollo 11.

    The platform was aligned with the site's vertical at landing, so its inner gimbal angle is the
    pitch from that: no arc to the site comes in. The Moon turns by 0.07 deg meanwhile. Roll and
    the yaw to face the sky (middle and outer angles) are left alone: nothing here flies them.
    """
    with (DATA / "apollo11_descent.csv").open() as file:
        rows = list(csv.DictReader(file))
    time = np.array([float(r["time_s"]) for r in rows]) + LOCK_ON
    height = np.array([float(r["range_m"]) if r["range_m"] else np.nan for r in rows])
    pitch = np.array([float(r["inner_deg"]) if r["inner_deg"] else np.nan for r in rows])
    return Track(time, height, np.deg2rad((pitch + 180.0) % 360.0 - 180.0))


def flown(flight: Flight, moon: CentralGravity, com_height: float) -> Track:
    """Return the track of a flight, its altitude that of the pads over the site's level."""
    t = flight.trajectory
    axis = quat_rotate(
        np.column_stack([t[f"attitude_{a}"] for a in "xyzw"]), np.array([0.0, 0.0, 1.0])
    )
    height = moon.height(flight.positions) - flight.target[2] - com_height
    return Track(t["time"], height, np.arctan2(axis[:, 0], axis[:, 2]))


@dataclass(frozen=True)
class Beside:
    """Differences of a flight from the record over a stretch of time.

    Attributes
    ----------
    altitude, pitch
        Root mean square, m and rad; NaN where there is nothing to compare.
    rows
        Of the record with an altitude.
    """

    altitude: float
    pitch: float
    rows: int


def beside(flight: Track, told: Track, since: float, until: float) -> Beside:
    """Compare a flight with the record from one time to another, both since ignition, s."""
    part = (told.time >= since) & (told.time < min(until, float(flight.time[-1])))
    off = {
        name: np.interp(told.time, flight.time, getattr(flight, name)) - getattr(told, name)
        for name in ("altitude", "pitch")
    }

    def rms(values: Array) -> float:
        good = values[np.isfinite(values)]
        return float(np.sqrt(np.mean(good**2))) if len(good) else float("nan")

    known = int(np.isfinite(off["altitude"][part]).sum())
    return Beside(rms(off["altitude"][part]), rms(off["pitch"][part]), known)


def event(flight: Flight, name: str) -> float:
    """Return when something of a name first happened, s; NaN if it did not."""
    return next((float(e["time"]) for e in flight.events if e["name"] == name), float("nan"))


def at(flight: Flight, values: Array, time: float) -> float:
    """Return values (n,) of a flight at a time, s; NaN at NaN."""
    inside = np.isfinite(time)
    return float(np.interp(time, flight.trajectory["time"], values)) if inside else float("nan")


def told_of(flight: Flight, moon: CentralGravity, com_height: float, full: float) -> dict[str, Any]:
    """Return what a flight is told by: times, heights, masses; `full` is the fixed throttle, N."""
    track, t = flown(flight, moon, com_height), flight.trajectory
    after = (t["time"] > 60.0) & (t["thrust"] < 0.99 * full)
    recovery = float(t["time"][np.argmax(after)]) if after.any() else float("nan")
    spent = t["mass"][0] - t["mass"]
    jets = float(flight.events[-1].get("thruster_propellant_kg", 0.0))
    approach, last = event(flight, "approach"), event(flight, "vertical-descent")
    out: dict[str, Any] = {
        "safe": flight.verdict.safe,
        "failed": list(flight.verdict.failed),
        "duration_s": flight.duration,
        "propellant_kg": flight.propellant_used - jets,
        "thruster_propellant_kg": jets,
        "miss_m": float(np.hypot(*(flight.positions[-1, :2] - flight.target[:2]))),
        "burnt_at_lock_on_kg": at(flight, spent, LOCK_ON),
    }
    for name, time in (("recovery", recovery), ("approach", approach), ("last", last)):
        out |= {f"{name}_s": time, f"{name}_altitude_m": at(flight, track.altitude, time)}
    marks = [0.0, approach, last, flight.duration]
    burnt = np.diff([at(flight, spent, time) for time in marks])
    out |= dict(zip(("braking_kg", "approach_kg", "last_kg"), map(float, burnt), strict=True))
    return out
