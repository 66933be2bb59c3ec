"""Compare flights with a failed thruster with and without fault detection.

One thruster is stuck shut from 5 s; each flight is repeated with every thruster of a set. The fault
detection was tuned on thrusters 0, 1, 4 and 5 and flights 1 to 3; the set `held-out` has the other
thrusters. Flights without a failure count false alarms.

python scenarios/landers/thruster_failure.py --failure tuned
python scenarios/landers/thruster_failure.py --failure held-out --seed 101 --flights 2
python scenarios/landers/thruster_failure.py --failure none --detection on --seed 101 --flights 50
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim import Scenario, Simulation
from lunarsim.onboard.control.jets import JetLoop
from lunarsim.studies import Case, Metric, Study, run_script

BASE_SCENARIO = {
    "terrain": {"kind": "fractal", "size_m": 120.0, "posting_m": 1.0, "rms_slope_deg": 3.0},
    "rocks": {"cover": 0.02},
    "vehicle": {"kind": "jet-lander"},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "mappers": {},
    "tasking": {},
}
FAILURE_TIME_S = 5.0  # time of the failure, s
FAILURES: dict[str, tuple[int | None, ...]] = {
    "none": (None,),
    "tuned": (0, 1, 4, 5),
    "held-out": (2, 3, *range(6, 16)),
}


def fly(case: Case) -> list[dict[str, Any]]:
    """Simulate one flight repeatedly, with each thruster of a set in turn stuck shut."""
    return [fly_once(case, thruster) for thruster in FAILURES[case["failure"]]]


def fly_once(case: Case, failed_thruster: int | None) -> dict[str, Any]:
    """Simulate one flight with one thruster stuck shut from 5 s, or none.

    The row has the tilt at touchdown, the time from failure to detection, and the number of working
    thrusters that were isolated.
    """
    faults = {
        "jets_stuck_shut": [] if failed_thruster is None else [failed_thruster],
        "jets_stuck_from_s": FAILURE_TIME_S,
    }
    control = {"kind": case["control"]}
    scenario = Scenario.from_dict({**BASE_SCENARIO, "control": control, "faults": faults})
    simulation = Simulation(scenario, case.seed + case.number, "no-divert")
    loop = simulation.computer.attitude_loop
    assert isinstance(loop, JetLoop)
    if case["detection"] == "off":
        loop.failure_detector.update = lambda *_: []  # type: ignore[method-assign]
    flight = simulation.run()
    detections = [e for e in flight.events if e["name"] == "thruster-failed"]
    times = [e["time"] for e in detections if e["thruster"] == failed_thruster]
    touchdown = flight.outcome.touchdown
    wrong = sum(e["thruster"] != failed_thruster for e in detections)
    return {
        "thruster": failed_thruster, "safe": flight.outcome.safe,
        "tilt_deg": np.nan if touchdown is None else float(np.rad2deg(touchdown.tilt)),
        "delay_s": times[0] - FAILURE_TIME_S if times else np.nan,
        "detected": bool(times), "isolated": wrong, "false_alarm": wrong > 0,
    }  # fmt: skip


study = Study(
    fly,
    repeats="flights",
    count=3,
    factors={
        "control": ("phase-plane", "quaternion-feedback"),
        "detection": ("off", "on"),
        "failure": tuple(FAILURES),
    },
    factor_help={
        "control": "Kind of attitude control.",
        "detection": "Whether fault detection is on.",
        "failure": "Set of thrusters that fail, one in each flight.",
    },
    metrics={
        "safe": Metric("safe landings", "share"),
        "tilt_deg": Metric("tilt at touchdown (deg)\nmedian / maximum", "median-max", 1),
        "detected": Metric("failures\ndetected", "count"),
        "delay_s": Metric("time to detection (s)\nmedian / maximum", "median-max", 1),
        "isolated": Metric("working thrusters\nisolated", "sum", 0),
        "false_alarm": Metric("flights with\nfalse alarms", "share"),
    },
)

if __name__ == "__main__":
    run_script(study)
