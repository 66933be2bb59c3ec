"""Compare the Gaussian DEM, quadtree, shadow and fused maps on the same descents.

Two cameras and a flash LiDAR observe the same terrain from an altitude of 1000 m downwards. Each
field has its own terrain, rocks and noise, and the maps are compared field by field.

python scenarios/sensor_fusion.py --fields 3 --out out/all_sensors
"""

from __future__ import annotations

from typing import Any

import click
from sensor_fusion_figures import draw, show
from sensor_fusion_flights import DEAD_BELOW, ROWS, fly

from lunarsim import flight_seed
from lunarsim.studies import Case, Report, Study, run_script


def fly_condition(case: Case) -> dict[str, Any]:
    """Simulate one flight in a study condition; return the site counts by map and altitude."""
    seed = flight_seed(case.seed, case.number)
    return fly(ROWS[case["row"]], tuple(case["altitude"]), seed)


def print_maps(report: Report) -> None:
    """Print and plot the quality of each hazard map by study condition."""
    show(report.rows, DEAD_BELOW, report.console)
    if report.out is not None:
        draw(report.rows, report.out / "all_sensors.png")


study = Study(
    fly_condition,
    repeats="fields",
    count=10,
    factors={"row": list(ROWS)},
    factor_help={"row": "Study condition (row of the results table) to fly."},
    options=(
        click.Option(
            ["--altitude"], type=click.FloatRange(50.0, 1500.0), multiple=True,
            default=(1000.0, 500.0, 200.0, 100.0), show_default=True,
            help="Altitude at which the maps are evaluated (m); repeat the option for several "
            "altitudes.",
        ),
    ),
    report=print_maps,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
