"""Compare attitude control with and without propellant slosh.

Four tanks around the center of the default lander with thrusters. The table reports the attitude
error, body rates, thruster firings and thruster propellant over the descent, and the touchdown.

python scenarios/landers/slosh.py --flights 10
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim import Scenario, Simulation
from lunarsim.frames import quat_angle
from lunarsim.simulation.recorder import MessageRecorder
from lunarsim.studies import Case, Metric, Study, run_script

BASE_SCENARIO = {
    "terrain": {"kind": "fractal", "size_m": 120.0, "posting_m": 1.0, "rms_slope_deg": 3.0},
    "rocks": {"cover": 0.02},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "mappers": {},
    "tasking": {},
}
# Tanks of 100 kg each when full, 0.3 m deep, with the liquid at the height of the center of mass.
SMALL_TANKS = [[0.5, 0.0, -0.15], [0.0, 0.5, -0.15], [-0.5, 0.0, -0.15], [0.0, -0.5, -0.15]]
# End of the initial turn; length of the final interval that is reported separately, s.
BEGIN, END = 5.0, 4.0
CONTROLS = ("phase-plane", "quaternion-feedback")
TANKS: dict[str, dict[str, object]] = {
    "none": {},
    "baffled, 0.05": {"tanks_m": SMALL_TANKS, "damping": 0.05},
    "smooth, 0.005": {"tanks_m": SMALL_TANKS, "damping": 0.005},
    "undamped": {"tanks_m": SMALL_TANKS, "damping": 0.0},
    "one wide tank, 0.005": {
        "tanks_m": [[0.0, 0.0, -0.15]], "radius_m": 0.6, "damping": 0.005
    },
}  # fmt: skip


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight; evaluate attitude, thrusters, slosh and touchdown.

    Attitude error and body rate are RMS values, after the first 5 s and in the last 4 s. Thruster
    propellant, number of firings and maximum slosh angle are those of the complete flight.
    """
    vehicle = {"kind": "jet-lander", "slosh": TANKS[case["tanks"]]}
    scenario = Scenario.from_dict(
        {**BASE_SCENARIO, "vehicle": vehicle, "control": {"kind": case["control"]}}
    )
    tap = MessageRecorder()
    flight = Simulation(scenario, case.seed + case.number, "no-divert", tap=tap).run()
    t = flight.trajectory
    n = min(len(t["time"]), len(tap.exchanges))
    rate = np.stack([t[f"rate_{axis}"] for axis in "xyz"], axis=1)[-n:]
    actual = np.stack([t[f"attitude_{axis}"] for axis in "xyzw"], axis=1)[-n:]
    wanted = np.array([command.attitude for _, command, _ in tap.exchanges])[-n:]
    time = np.asarray(t["time"])[-n:]
    error = np.rad2deg(quat_angle(actual, wanted))
    speed = np.rad2deg(np.linalg.norm(rate, axis=1))
    spans = (time > BEGIN, time > time[-1] - END)
    (all_error, all_rate), (end_error, end_rate) = (
        [float(np.sqrt(np.mean(x[span] ** 2))) for x in (error, speed)] for span in spans
    )
    last, touchdown = flight.events[-1], flight.outcome.touchdown
    return {
        "safe": flight.outcome.safe, "error_deg": all_error, "rate_deg_s": all_rate,
        "end_error_deg": end_error, "end_rate_deg_s": end_rate,
        "thruster_kg": last["thruster_propellant_kg"],
        "firings": int(np.sum(last["thruster_firings"])),
        "slosh_deg": float(np.max(last.get("slosh_most_deg", 0.0))),
        "lateral_m_s": np.nan if touchdown is None else touchdown.horizontal_speed,
    }  # fmt: skip


study = Study(
    fly,
    repeats="flights",
    count=10,
    factors={"control": CONTROLS, "tanks": list(TANKS)},
    factor_help={"control": "Kind of attitude control.", "tanks": "Name of a set of tanks."},
    metrics={
        "safe": Metric("safe landings", "share"),
        "error_deg": Metric("attitude error,\nRMS (deg)", "median", 2),
        "rate_deg_s": Metric("body rate,\nRMS (deg/s)", "median", 2),
        "end_error_deg": Metric("attitude error,\nlast 4 s (deg)", "median", 2),
        "end_rate_deg_s": Metric("body rate,\nlast 4 s (deg/s)", "median", 2),
        "thruster_kg": Metric("thruster\npropellant (kg)", "median", 2),
        "firings": Metric("firings", "median", 0),
        "slosh_deg": Metric("slosh angle,\nmaximum (deg)", "max", 1),
        "lateral_m_s": Metric("lateral speed at\ntouchdown (m/s)", "median", 2),
    },
)

if __name__ == "__main__":
    run_script(study)
