"""Draw the first figure of the README: `hero_figure.py docs/images/hero.png`.

Left: rendered terrain with the path of one flight and its divert. Right: the hazard map of the
flight and the exact safety of the same terrain.
"""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray

import lunarsim
from lunarsim.simulation.image_rendering import camera_pointing_state, first_camera

Array = NDArray[np.float64]

_SCENARIO, _SEED = "mare", 4
_CHANGES = {"rocks": {"cover": 0.02}}
# View of the rendered image: altitude of the camera (m), angles of its boresight (deg).
_ALTITUDE, _OFF_NADIR_DEG, _HEADING_DEG = 45.0, 58.0, 0.0
_SUN = {"sun_elevation_deg": 20.0, "sun_azimuth_deg": 300.0}
_SIDE = 35.0  # half side of the map panels, m
_PURPLE, _ORANGE = "#d16ba5", "#ff7f0e"


def main() -> None:
    """Write the figure to the path in the first argument."""
    scenario = lunarsim.load_scenario(_SCENARIO).changed(**_CHANGES)
    simulation = lunarsim.Simulation(scenario, lunarsim.flight_seed(_SEED, 0), "safest")
    flight = simulation.run()
    figure = plt.figure(figsize=(12.0, 4.0), layout="constrained")
    grid = figure.add_gridspec(1, 3, width_ratios=(1.55, 1.0, 1.0))
    _draw_descent(figure.add_subplot(grid[0]), scenario, simulation, flight)
    _draw_maps(figure.add_subplot(grid[1]), figure.add_subplot(grid[2]), simulation, flight)
    figure.savefig(sys.argv[1], dpi=110)


def _draw_descent(
    ax: Axes, scenario: lunarsim.Scenario, simulation: lunarsim.Simulation, flight: lunarsim.Flight
) -> None:
    """Draw the rendered terrain and the true path, target, divert and touchdown on it."""
    aim = np.round(0.5 * (flight.sites[0] + flight.sites[-1])[:2] - flight.map_error[:2], 1)
    scenario = scenario.changed(target={"position_m": aim.tolist()})  # the centre of the image
    image = lunarsim.render(
        scenario, altitude=_ALTITUDE, off_nadir_deg=_OFF_NADIR_DEG, heading_deg=_HEADING_DEG,
        seed=_SEED, ideal=True, **_SUN,
    )  # fmt: skip
    rows, cols = image.counts.shape
    ax.imshow(image.counts, cmap="gray", vmax=np.percentile(image.counts, 99.7))
    terrain = simulation.world.terrain
    camera = first_camera(scenario)
    pose = camera_pointing_state(
        camera, simulation.world, scenario.target.position_m, _ALTITUDE,
        np.deg2rad(_OFF_NADIR_DEG), np.deg2rad(_HEADING_DEG),
    )  # fmt: skip
    view = camera.view(pose)

    def on_image(points: Array) -> Array:
        """Project points (n, 3) into the image, pixels (n, 2); NaN outside of it."""
        away = (points - view.position) @ view.enu_to_sensor.T
        pixels = view.pinhole.project(away)
        inside = (away[:, 2] > 0) & (pixels > 0).all(1) & (pixels < (cols - 1, rows - 1)).all(1)
        return np.where(inside[:, None], pixels, np.nan)

    path = flight.positions
    shadow = path.copy()
    shadow[:, 2] = [float(terrain.elevation((x, y))) for x, y in path[:, :2]]
    ax.plot(*on_image(path).T, color=_ORANGE, lw=2.2, label="path")
    ax.plot(*on_image(shadow).T, color=_ORANGE, lw=1.0, ls=":", label="ground track")
    first, last = (site - flight.map_error for site in (flight.sites[0], flight.sites[-1]))
    ax.plot(*on_image(np.array([first, last])).T, color=_PURPLE, lw=1.8, label="divert")
    ax.plot(*on_image(first[None]).T, "x", color="white", ms=10, mew=2.5, label="target")
    touchdown = flight.outcome.touchdown
    assert touchdown is not None
    ax.plot(*on_image(touchdown.position[None]).T, "o", mfc="none", mec=_ORANGE, ms=13, mew=2.5,
            label="touchdown")  # fmt: skip
    ax.legend(loc="upper right", fontsize=8, framealpha=0.85)
    ax.set(xticks=[], yticks=[], title="Rendered descent and divert")


def _draw_maps(
    left: Axes, right: Axes, simulation: lunarsim.Simulation, flight: lunarsim.Flight
) -> None:
    """Draw the hazard map, its calibrated domain, and the exact safety of the terrain."""
    hazard_map, truth = flight.hazard_map, simulation.truth
    assert hazard_map is not None
    dx, dy = flight.map_error[:2]
    west, east, south, north = hazard_map.grid.extent
    extent = (west - dx, east - dx, south - dy, north - dy)
    shown = np.where(hazard_map.observed, hazard_map.p_safe, np.nan)
    drawn = left.imshow(shown, origin="lower", extent=extent, vmin=0.0, vmax=1.0, cmap="viridis")
    left.figure.colorbar(drawn, ax=left, label="p_safe", fraction=0.046)
    outside = np.where(hazard_map.observed & ~hazard_map.in_domain, 1.0, np.nan)
    left.contourf(outside, levels=[0.5, 1.5], colors="none", hatches=["////"], extent=extent)
    exact = truth.within(extent)
    right.imshow(exact.safe, origin="lower", extent=exact.grid.extent, interpolation="nearest",
                 cmap=ListedColormap(["#e08030", "#8cc4e8"]))  # fmt: skip
    aim, touchdown = flight.sites[0] - flight.map_error, flight.outcome.touchdown
    assert touchdown is not None
    x, y = 0.5 * (aim + touchdown.position)[:2]
    for ax in (left, right):
        ax.plot([aim[0], touchdown.position[0]], [aim[1], touchdown.position[1]], color=_PURPLE)
        ax.plot(*aim[:2], "x", color="white", ms=10, mew=2.5)
        ax.plot(*touchdown.position[:2], "o", mfc="none", mec=_ORANGE, ms=13, mew=2.5)
        ax.set(xlim=(x - _SIDE, x + _SIDE), ylim=(y - _SIDE, y + _SIDE), xlabel="East (m)")
    left.set(ylabel="North (m)", title="Hazard map (hatched: outside its domain)")
    right.set(title="Exact safety (blue: safe)")


if __name__ == "__main__":
    main()
