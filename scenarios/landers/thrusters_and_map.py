"""Compare hazard maps with thruster and with ideal attitude control.

The shadow EKF paper turns its vehicle along the great circle to the commanded attitude at a limited
rate (section IV.A.3). Here the same descents, over the same terrain and with the same noise, are
flown with that ideal attitude and with on-off thrusters. The vehicle navigates with its own
instruments and maps by LiDAR. The report compares the map quality and the landing position.

python scenarios/landers/thrusters_and_map.py --flights 20
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim import Flight, Scenario, Simulation, flight_seed, map_quality
from lunarsim.api import Estimate, LidarScan, State
from lunarsim.evaluation.map_quality import true_elevation_in_map_frame
from lunarsim.frames import quat_angle
from lunarsim.simulation.recorder import MessageRecorder
from lunarsim.studies import Case, Metric, Study, run_script

WORLD = {
    "terrain": {"kind": "fractal", "size_m": 300.0, "posting_m": 1.0, "rms_slope_deg": 4.0},
    "rocks": {"cover": 0.08, "min_diameter_m": 0.4},
    "expected_rocks": {"cover": 0.08},
    "sensors": {
        "imu": {"kind": "imu"},
        "altimeter": {"kind": "radar-altimeter"},
        "velocimeter": {"kind": "velocimeter"},
        "stars": {"kind": "star-tracker"},
        "flash": {"kind": "flash-lidar"},
    },
    "navigation": {"kind": "inertial"},
}
# The first entry is the reference of the comparison.
CONTROLS: dict[str, dict[str, object]] = {
    "ideal": {"control": {"kind": "ideal"}},
    "phase-plane": {"control": {"kind": "phase-plane"}, "vehicle": {"kind": "jet-lander"}},
    "quaternion-feedback": {
        "control": {"kind": "quaternion-feedback"}, "vehicle": {"kind": "jet-lander"}
    },
}  # fmt: skip


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight; compute errors at the LiDAR scans, map quality and landing."""
    scenario = Scenario.from_dict({**WORLD, **CONTROLS[case["control"]]})
    tap = MessageRecorder()
    simulation = Simulation(scenario, flight_seed(case.seed, case.number), "safest", tap=tap)
    seen: list[tuple[State, Estimate]] = []
    while not simulation.done:
        now = simulation.state, simulation.estimate
        simulation.step()
        if any(isinstance(item, LidarScan) for _, item in tap.exchanges.pop()[0].items):
            seen.append(now)
    flight = simulation.flight()
    place = np.array([e.position - s.position for s, e in seen])
    found = {
        "safe": flight.outcome.safe,
        "failed": ", ".join(flight.outcome.failure_causes),
        "position_m": _rms(np.linalg.norm(place - place.mean(axis=0), axis=1)),
        "attitude_mrad": 1e3
        * _rms(np.array([quat_angle(e.attitude, s.attitude) for s, e in seen])),
        "rate_deg_s": float(np.rad2deg(_rms(np.array([np.linalg.norm(s.rate) for s, _ in seen])))),
    } | _map_metrics(simulation, flight)
    touchdown, last = flight.outcome.touchdown, flight.events[-1]
    if touchdown is not None:
        site = flight.sites[-1] - flight.map_error
        found["miss_m"] = float(np.linalg.norm((touchdown.position - site)[:2]))
        found["tilt_deg"] = float(np.rad2deg(touchdown.tilt))
    found["thruster_kg"] = float(last.get("thruster_propellant_kg", 0.0))
    found["engine_kg"] = flight.propellant_used
    return dict.fromkeys(METRICS, np.nan) | found


def _rms(values: np.ndarray) -> float:
    """Return the root mean square of the values."""
    return float(np.sqrt(np.mean(values**2)))


def _map_metrics(simulation: Simulation, flight: Flight) -> dict[str, float]:
    """Return height errors (m), precision and recall of the last hazard map.

    The result is empty without a map of elevations.
    """
    found, error = flight.hazard_map, flight.map_error
    if found is None or found.elevation is None:
        return {}
    true_height = true_elevation_in_map_frame(simulation.world.terrain, found.grid, error)
    known = found.observed & np.isfinite(found.elevation) & np.isfinite(true_height)
    off = (found.elevation - true_height)[known].astype(np.float64)
    quality = map_quality(found, simulation.truth, error)
    return {
        "height_m": _rms(off), "mean_m": float(off.mean()), "precision": quality.precision,
        "recall": quality.recall,
    }  # fmt: skip


METRICS = {
    "safe": Metric("safe landings", "share"),
    "position_m": Metric("position error at scans without mean, RMS (m)"),
    "attitude_mrad": Metric("attitude error at scans, RMS (mrad)"),
    "rate_deg_s": Metric("body rate at scans, RMS (deg/s)"),
    "height_m": Metric("map height error, RMS (m)"),
    "mean_m": Metric("map height error, mean (m)"),
    "precision": Metric("precision"),
    "recall": Metric("recall"),
    "miss_m": Metric("touchdown distance from the site (m)"),
    "tilt_deg": Metric("tilt at touchdown (deg)"),
    "thruster_kg": Metric("thruster propellant (kg)"),
    "engine_kg": Metric("total propellant (kg)"),
}
study = Study(
    fly,
    repeats="flights",
    count=20,
    minimum=2,
    factors={"control": list(CONTROLS)},
    factor_help={"control": "Kind of attitude control."},
    metrics=METRICS,
    reference=True,
)

if __name__ == "__main__":
    run_script(study)
