"""Plot the reachable landing area and its propellant at several heights.

The default approach is flown to its site with one guidance law. At each height the terrain around
the site is evaluated under the limits of the approach.

python scenarios/guidance/reach.py --out out/reach
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click
import numpy as np

from lunarsim import Grid, Scenario, Simulation
from lunarsim.parts.registry import kinds
from lunarsim.studies import (
    Case,
    Metric,
    Report,
    Study,
    metric_table,
    pack_array,
    run_script,
    unpack_array,
)
from lunarsim.viz.style import map_axes, new_figure, save, show

BASE_SCENARIO: dict[str, Any] = {
    "name": "reach",
    "terrain": {"kind": "fractal", "size_m": 100.0, "rms_slope_deg": 0.0},
    "rocks": {"cover": 0.0},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix"}},
    "navigation": {"kind": "fixes"},
    "mappers": {},
    "tasking": {},
}
_SIDE, _CELLS = 6.5, 260  # side of the grid divided by the height; cells per side


def fly(case: Case) -> list[dict[str, Any]]:
    """Simulate one approach; return the reachable area at each height, from the highest."""
    scenario = Scenario.from_dict({**BASE_SCENARIO, "guidance": {"kind": case["law"]}})
    simulation = Simulation(scenario, case.seed + case.number, "no-divert")
    rows = []
    for height in sorted(case["height"], reverse=True):
        while simulation.computer.altitude > height:
            simulation.step()
        rows.append({"height_m": height, **reachable_area(simulation)})
    return rows


def reachable_area(simulation: Simulation) -> dict[str, Any]:
    """Compute the sites reachable from the current state, and the propellant to each.

    The row has altitude (m), speed (m/s), lander and site (m), area (km^2), side of the grid around
    the site (m), and the propellant to each cell (kg; NaN: out of reach) as compressed text.
    """
    computer = simulation.computer
    side = _SIDE * max(computer.altitude, 40.0)
    centres = Grid.centred(computer.site, side, side / _CELLS).centres()
    sites = np.concatenate((centres, np.full((*centres.shape[:2], 1), computer.site[2])), axis=2)
    cost = computer.cost_of(sites.reshape(-1, 3), computer.estimate)
    propellant = np.where(cost.feasible, cost.propellant, np.nan).reshape(centres.shape[:2])
    return {
        "altitude_m": computer.altitude,
        "speed_m_s": float(np.linalg.norm(computer.estimate.velocity)),
        "lander_m": computer.estimate.position, "site_m": computer.site, "side_m": side,
        "area_km2": float(cost.feasible.sum() * (side / _CELLS) ** 2 / 1e6),
        "propellant": pack_array(propellant),
    }  # fmt: skip


def print_areas(report: Report) -> None:
    """Print the reachable area by height and plot the propellant of the first flight."""
    title = f"Reachable landing area with the guidance law {report.options['law']}"
    by_height = replace(report, factors=("height_m",))
    report.print(metric_table(by_height, title))
    if report.out is None:
        return
    first = [row for row in report.rows if row["number"] == 0]
    figure = new_figure(3.6 * len(first), 4.3)
    panels = np.atleast_1d(figure.subplots(1, len(first)))
    for panel, row in zip(panels, first, strict=True):
        grid = Grid.centred(row["site_m"], row["side_m"], row["side_m"] / _CELLS)
        drawn = show(panel, unpack_array(row["propellant"]), grid)
        figure.colorbar(drawn, ax=panel, label="Propellant (kg)", location="bottom")
        panel.plot(*row["lander_m"][:2], "^", color="#D55E00", label="lander")
        panel.plot(*row["site_m"][:2], "x", color="black", mew=2, label="site")
        map_axes(panel, f"{row['altitude_m']:.0f} m high at {row['speed_m_s']:.0f} m/s")
    panels[0].legend(loc="upper left")
    save(figure, report.out / "reach.png")


study = Study(
    fly,
    repeats="flights",
    count=1,
    options=(
        click.Option(
            ["--law"], type=click.Choice(list(kinds("guidance", with_files=False))),
            default="apollo", show_default=True,
            help="Guidance law whose reachable landing area is plotted.",
        ),
        click.Option(
            ["--height"], type=click.FloatRange(20.0, 1000.0), multiple=True,
            default=(400.0, 200.0, 100.0, 50.0), show_default=True,
            help="Height above the site at which the area is computed (m); repeat the option for "
            "several heights.",
        ),
    ),
    metrics={
        "altitude_m": Metric("altitude (m)", "median", 0),
        "area_km2": Metric("reachable area, median (km^2)", "median", 4),
    },
    report=print_areas,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
