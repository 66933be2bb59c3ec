"""Fly failures of past missions as they were, without the fault, and with a remedy.

The scenarios `MISSIONS` beside this script have the reports as sources in their comments. Remedies:
for hakuto_r_m1 the opposite, sensors that are excluded for the rest of the flight after the rim;
for im1 and im2 a working Doppler LiDAR; for slim one of four engines lost, not one of two.

python scenarios/flown_failures/flown_failures.py --flights 5 --out out/flown_failures
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lunarsim import Scenario, Simulation
from lunarsim.studies import Case, Metric, Study, run_script

FOLDER = Path(__file__).parent
MISSIONS = ("hakuto_r_m1", "im1", "im2", "slim")
_EXCLUDED = {
    sensor: {"kind": "dropout", "sensor": sensor, "start_s": 10.0}
    for sensor in ("altimeter", "velocimeter")
}
# Changes of the scenario in the arm "changed".
CHANGES: dict[str, dict[str, Any]] = {
    "hakuto_r_m1": {"sensor_faults": _EXCLUDED},
    "im1": {"sensor_faults": {"doppler": None}},
    "im2": {"sensor_faults": {"doppler": None}},
    "slim": {"faults": {"engine_loss": 0.25}},
}


def scenario_of(mission: str, arm: str) -> Scenario:
    """Return the scenario of a mission in an arm: failure, no fault or changed."""
    scenario = Scenario.load(FOLDER / f"{mission}.toml")
    if arm == "no fault":
        scenario = scenario.changed(sensor_faults=dict.fromkeys(scenario.sensor_faults))
        return scenario if scenario.faults is None else scenario.changed(faults=None)
    return scenario.changed(**CHANGES[mission]) if arm == "changed" else scenario


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight; report touchdown, height error and lost navigation."""
    scenario = scenario_of(case["mission"], case["arm"])
    flight = Simulation(scenario, case.seed + case.number, "no-divert").run()
    touchdown, path = flight.outcome.touchdown, flight.trajectory
    # Estimated height above the site at touchdown, of the centre of mass.
    height = float(path["estimated_z"][-1] - path["site_z"][-1])
    row = {
        "safe": flight.outcome.safe,
        "causes": list(flight.outcome.failure_causes),
        "height_error_m": np.nan
        if touchdown is None
        else abs(height - scenario.vehicle.com_height_m),
        "lost": bool(path["lost"].any()),
        "lost_at_end": bool(path["lost"][-1]),
    }
    for name in ("vertical_speed", "horizontal_speed"):
        row[name] = np.nan if touchdown is None else float(getattr(touchdown, name))
    return row


study = Study(
    fly,
    repeats="flights",
    count=5,
    factors={"mission": MISSIONS, "arm": ("failure", "no fault", "changed")},
    factor_help={"mission": "Scenario file of a failure.", "arm": "Fault, none, or a change."},
    metrics={
        "safe": Metric("safe landings", "share"),
        "vertical_speed": Metric("vertical touchdown speed,\nmedian / max (m/s)", "median-max", 2),
        "horizontal_speed": Metric(
            "horizontal touchdown speed,\nmedian / max (m/s)", "median-max", 2
        ),
        "height_error_m": Metric("height error at touchdown,\nmedian / max (m)", "median-max", 1),
        "lost": Metric("navigation\nlost", "count"),
        "lost_at_end": Metric("lost at\nthe end", "count"),
    },
)

if __name__ == "__main__":
    run_script(study)
