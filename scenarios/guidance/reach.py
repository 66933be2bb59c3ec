"""Plot the reachable landing area and its propellant at several heights.

The default approach is flown to its site with one guidance law. At each height the terrain around
the site is evaluated under the limits of the approach.

python scenarios/guidance/reach.py --out reach.png
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from lunarsim import Grid, Scenario, Simulation
from lunarsim.onboard.policies.reachability import ReachabilityMap
from lunarsim.parts.registry import kinds
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


def compute_reachable_area(simulation: Simulation) -> ReachabilityMap:
    """Compute the sites reachable from the current state, and the propellant to each."""
    computer = simulation.computer
    side = _SIDE * max(computer.altitude, 40.0)
    grid = Grid.centred(computer.site, side, side / _CELLS)
    here = computer.estimate
    level = np.full(grid.shape, float(computer.site[2]))
    return ReachabilityMap(grid, level, lambda sites: computer.cost_of(sites, here))


@click.command()
@click.option("--law", type=click.Choice(list(kinds("guidance"))), default="apollo",
              show_default=True,
              help="Guidance law whose reachable landing area is plotted.")  # fmt: skip
@click.option("--height", "heights", type=click.FloatRange(20.0, 1000.0), multiple=True,
              default=(400.0, 200.0, 100.0, 50.0), show_default=True,
              help="Height above the site at which the area is computed (m); repeat the option for "
              "several heights.")  # fmt: skip
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), default="reach.png",
              show_default=True, help="Image file for the figure.")  # fmt: skip
def main(law: str, heights: tuple[float, ...], out: Path) -> None:
    """Plot the reachable landing area of one guidance law at several heights."""
    simulation = Simulation(
        Scenario.from_dict({**BASE_SCENARIO, "guidance": {"kind": law}}), 1, "no-divert"
    )
    figure = new_figure(3.6 * len(heights), 4.3)
    panels = np.atleast_1d(figure.subplots(1, len(heights)))
    for panel, height in zip(panels, sorted(heights, reverse=True), strict=True):
        while simulation.computer.altitude > height:
            simulation.step()
        reach = compute_reachable_area(simulation)
        drawn = show(panel, np.where(reach.reachable, reach.propellant, np.nan), reach.grid)
        figure.colorbar(drawn, ax=panel, label="Propellant (kg)", location="bottom")
        panel.plot(*simulation.computer.estimate.position[:2], "^", color="#D55E00", label="lander")
        panel.plot(*simulation.computer.site[:2], "x", color="black", mew=2, label="site")
        speed = np.linalg.norm(simulation.computer.estimate.velocity)
        map_axes(panel, f"{simulation.computer.altitude:.0f} m high at {speed:.0f} m/s")
        within = reach.reachable.sum() * reach.grid.posting**2 / 1e6
        click.echo(
            f"{law}: height {simulation.computer.altitude:.0f} m: {within:.4f} km^2 reachable"
        )
    panels[0].legend(loc="upper left")
    save(figure, out)
    click.echo(f"Figure: {out}")


if __name__ == "__main__":
    main()
