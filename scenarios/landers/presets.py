"""Fly four landers with public figures over a mare, a highland and a polar ridge.

The landers are the scenario files `VEHICLES` beside this script. Sensors, navigation, map and
decisions are the same, and nothing on board depends on the terrain: only the world's tables change.

python scenarios/landers/presets.py --flights 10 --out out/presets
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from lunarsim import Scenario, Simulation
from lunarsim.studies import Case, Metric, Report, Study, metric_table, run_script

FOLDER = Path(__file__).parent
VEHICLES = ("lunar_module", "nova_c", "blue_ghost", "small_lander")
# Tables of the world. The mare is the one of the scenario files. Highland: scenarios/highland.toml,
# wider and with a coarser grid. Ridge: connecting ridge beside Shackleton crater, measured every
# 40 m, with the relief and craters of the preset "polar" in between and the highland's rocks.
TERRAINS: dict[str, dict[str, Any]] = {
    "mare": {},
    "highland": {
        "terrain": {
            "kind": "fractal", "preset": "highland", "size_m": 1000.0, "posting_m": 0.4,
            "rms_slope_deg": 4.0,
        },
        "rocks": {"shape": "mixed", "cover": 0.04},
    },
    "ridge": {
        "terrain": {
            "kind": "dtm", "path": "../data/moon_shackleton_ridge_lola_40m.tif",
            "dtm_posting_m": 40.0, "dtm_window": [143, 170, 34, 61], "posting_m": 0.4,
            "preset": "polar",
        },
        "rocks": {"shape": "mixed", "cover": 0.04},
        "sun": {"azimuth_deg": 120.0, "elevation_deg": 3.0},
    },
}  # fmt: skip


def scenario_of(vehicle: str, terrain: str) -> Scenario:
    """Return the scenario of a lander over a terrain."""
    tables = tomllib.loads((FOLDER / f"{vehicle}.toml").read_text(encoding="utf-8"))
    return Scenario.from_dict(tables | TERRAINS[terrain], FOLDER)


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight; report landing outcome, site, touchdown and remaining propellant.

    Speeds, tilt and slope are NaN without a touchdown. The position error is that of navigation at
    the end.
    """
    scenario = scenario_of(case["vehicle"], case["terrain"])
    simulation = Simulation(scenario, case.seed + case.number, "safest")
    flight = simulation.run()
    touchdown, end = flight.outcome.touchdown, flight.trajectory
    error = [end[f"estimated_{axis}"][-1] - end[f"position_{axis}"][-1] for axis in "xy"]
    row = {
        "safe": flight.outcome.safe,
        "causes": list(flight.outcome.failure_causes),
        "diverts": len(flight.decisions),
        "left_kg": float(end["mass"][-1]) - simulation.lander.dry_mass,
        "duration_s": float(end["time"][-1]),
        "error_m": float(np.hypot(*error)),
    }
    for name in ("vertical_speed", "horizontal_speed", "tilt", "slope", "roughness"):
        row[name] = np.nan if touchdown is None else float(getattr(touchdown, name))
    for name in ("tilt", "slope"):
        row[f"{name}_deg"] = float(np.rad2deg(row.pop(name)))
    return row


def print_landings(report: Report) -> None:
    """Print landings by lander and terrain, the causes of failures, and the landers."""
    report.print(metric_table(report, "Landings"))
    causes = Table("vehicle", "terrain", "failed", "causes (flights)", title="Failures")
    for (vehicle, terrain), rows in report.groups("vehicle", "terrain").items():
        failed = [row["causes"] for row in rows if not row["safe"]]
        names = sorted({name for one in failed for name in one})
        text = ", ".join(f"{name} ({sum(name in one for one in failed)})" for name in names)
        causes.add_row(vehicle, terrain, str(len(failed)), text)
    report.print(causes)
    report.print(vehicle_table([vehicle for (vehicle,) in report.groups("vehicle")]))


def vehicle_table(names: list[str]) -> Table:
    """Return masses, thrust over weight, gear and control authority of landers."""
    table = Table(
        "vehicle", "mass at the start (kg)", "propellant (kg)", "thrust / weight at the start",
        "minimum thrust / dry weight", "radius of the pads (m)", "height of the center of mass (m)",
        "angular acceleration (deg/s^2)", title="Landers",
    )  # fmt: skip
    for name in names:
        scenario = scenario_of(name, "mare")
        lander, gravity = scenario.vehicle.make(), scenario.gravity_m_s2
        table.add_row(
            name, f"{lander.wet_mass:.0f}", f"{lander.propellant_mass:.0f}",
            f"{lander.thrust_max / (lander.wet_mass * gravity):.2f}",
            f"{lander.thrust_min / (lander.dry_mass * gravity):.2f}",
            f"{lander.leg_radius:.2f}", f"{lander.com_height:.2f}",
            f"{np.rad2deg(lander.torque_max[0] / lander.inertia_dry[0]):.1f}",
        )  # fmt: skip
    return table


study = Study(
    fly,
    repeats="flights",
    count=20,
    factors={"vehicle": VEHICLES, "terrain": tuple(TERRAINS)},
    factor_help={"vehicle": "Scenario file of a lander.", "terrain": "World of the flights."},
    metrics={
        "safe": Metric("safe landings", "share"),
        "left_kg": Metric("propellant left,\nmedian (kg)", "median", 1),
        "vertical_speed": Metric("vertical touchdown speed,\nmedian / max (m/s)", "median-max", 2),
        "horizontal_speed": Metric(
            "horizontal touchdown speed,\nmedian / max (m/s)", "median-max", 2
        ),
        "tilt_deg": Metric("tilt at touchdown,\nmedian / max (deg)", "median-max", 2),
        "diverts": Metric("diverts,\nmean [95 %]", "mean", 2),
    },
    report=print_landings,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
