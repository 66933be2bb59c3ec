"""Figures of one flight: the descent, and the maps it was decided on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from lunarsim.evaluation.outcome import first_aim
from lunarsim.frames import quat_to_matrix
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight
from lunarsim.viz.style import COLOURS, hillshade, map_axes, new_figure, save, show
from lunarsim.world import World
from lunarsim.world.truth import Truth

# More marks of one kind than this are a run: only the first is drawn.
_MOST_MARKS = 8
# What the squares on a descent stand for, by the name of the event.
_MARKED = {"scan": "LiDAR scan", "picture": "first picture", "lock": "lock onto the map"}


def draw_flight(flight: Flight, world: World, truth: Truth, folder: str | Path) -> None:
    """Write ``descent.png`` and ``maps.png`` of a finished flight into `folder`.

    Parameters
    ----------
    flight
        As flown or as loaded.
    world, truth
        That it was flown in: see `lunarsim.evaluation.worlds.world_of`.
    folder
        Where pictures go.
    """
    draw_descent(flight, Path(folder) / "descent.png")
    draw_maps(flight, world, truth, Path(folder) / "maps.png")


def _title(flight: Flight) -> str:
    name = Scenario.from_toml(flight.scenario).name
    end = "landed safe" if flight.verdict.safe else "failed: " + ", ".join(flight.verdict.failed)
    return f"{name}, {flight.policy}: {end}"


def draw_descent(flight: Flight, path: Path) -> None:
    """Draw the profile, speeds, tilt and thrust of a descent."""
    figure = new_figure(11, 6.4)
    axes: dict[str, Any] = figure.subplot_mosaic(
        [["profile", "speed"], ["profile", "tilt"], ["profile", "thrust"]]
    )
    lander = Scenario.from_toml(flight.scenario).vehicle.make()
    _draw_profile(axes["profile"], flight, lander)
    t = flight.trajectory
    time = t["time"]
    axes["speed"].plot(time, -t["velocity_z"], color=COLOURS[0], label="down")
    axes["speed"].plot(
        time, np.hypot(t["velocity_x"], t["velocity_y"]), color=COLOURS[1], label="horizontal"
    )
    axes["speed"].set_ylabel("speed (m/s)")
    axes["speed"].legend(loc="upper right")
    q = np.column_stack([t[f"attitude_{a}"] for a in "xyzw"])
    tilt = np.rad2deg(np.arccos(np.clip(quat_to_matrix(q)[:, 2, 2], -1.0, 1.0)))
    axes["tilt"].plot(time, tilt, color=COLOURS[2])
    axes["tilt"].set_ylabel("tilt (deg)")
    axes["thrust"].plot(time, t["thrust"] / 1e3, color=COLOURS[3], label="thrust")
    for limit in (lander.thrust_min, lander.thrust_max):
        axes["thrust"].axhline(limit / 1e3, color="0.5", lw=0.8, ls="--")
    axes["thrust"].plot([], [], color="0.5", lw=0.8, ls="--", label="throttle limits")
    axes["thrust"].set_ylabel("thrust (kN)")
    axes["thrust"].set_xlabel("time (s)")
    axes["thrust"].legend(loc="upper right")
    vertical = np.flatnonzero(t["phase"] == 1)
    for name in ("speed", "tilt", "thrust"):
        axes[name].set_xlim(0.0, time[-1])
        axes[name].grid(alpha=0.3)
        if vertical.size:
            axes[name].axvline(time[vertical[0]], color="0.6", lw=0.8)
        if name != "thrust":
            axes[name].tick_params(labelbottom=False)
    save(figure, path)


def _draw_profile(profile: Any, flight: Flight, lander: Lander) -> None:
    """Draw altitude over distance, and what happened on the way."""
    t = flight.trajectory
    end = flight.positions[-1]
    altitude = t["position_z"] - end[2]
    away = np.hypot(t["position_x"] - end[0], t["position_y"] - end[1])
    profile.plot(away, altitude, color=COLOURS[0], lw=1.8)
    handles = [Line2D([], [], color=COLOURS[0], label="path")]

    def mark(times: list[float], marker: str, colour: str, label: str, size: float) -> None:
        rows = [int(np.argmin(np.abs(t["time"] - time))) for time in times]
        profile.plot(away[rows], altitude[rows], marker, color=colour, ms=size)
        if rows:
            handles.append(Line2D([], [], ls="", marker=marker, color=colour, label=label))

    for number, (name, label) in enumerate(_MARKED.items()):
        times = [e["time"] for e in flight.events if e["name"] == name]
        if len(times) > _MOST_MARKS:
            times = times[:1]
        mark(times, "so^"[number], COLOURS[2 + number], label, 7)
    mark([d["time"] for d in flight.decisions], "D", COLOURS[1], "divert", 5)
    mark([t["time"][-1]], "v", "black", "touchdown", 7)
    profile.legend(handles=handles, loc="upper left")
    profile.set_xlabel("distance to touchdown over the ground (m)")
    profile.set_ylabel("altitude above touchdown (m)")
    profile.set_title(_title(flight))
    profile.grid(alpha=0.3)


def _path_and_sites(axes: Any, flight: Flight, radius: float) -> None:
    """Draw path, sites and touchdown in the true frame."""
    t = flight.trajectory
    axes.plot(t["position_x"], t["position_y"], color=COLOURS[1], lw=1.5)
    axes.plot(*first_aim(flight), "x", color="black", ms=8, mew=2)
    end = flight.positions[-1]
    axes.add_patch(Circle(end[:2], radius, fill=False, ec="black", lw=2.2))
    axes.add_patch(Circle(end[:2], radius, fill=False, ec=COLOURS[1], lw=1.2))


def draw_maps(flight: Flight, world: World, truth: Truth, path: Path) -> None:
    """Draw true terrain, exact safety, the map, and the LiDAR returns or tracked rocks.

    All panels are in the true frame: the map is moved by the navigation error when it was drawn.
    """
    west, east, south, north = world.terrain.bounds
    tall = (north - south) > 1.25 * (east - west)
    figure = new_figure(12.5 if tall else 11, 6.0 if tall else 9.6)
    panels = figure.subplots(1, 4, sharey=True) if tall else figure.subplots(2, 2).ravel()
    grid = truth.safety.grid
    shade = hillshade(truth.elevation, grid.posting)
    for panel in panels:
        show(panel, shade, grid, cmap="gray", vmin=0.2, vmax=1.0)
    _draw_truth(figure, panels[0], panels[1], truth)
    _draw_map(figure, panels[2], flight)
    _draw_measured(figure, panels[3], flight)
    if flight.hazard_map is not None:
        x0, x1, y0, y1 = flight.hazard_map.grid.moved(-flight.map_error).extent
        if max(x1 - x0, y1 - y0) < 0.5 * max(east - west, north - south):
            # The ground reaches far beyond what is mapped: show the map and some of the way to it.
            aside = 0.25 * (x1 - x0)
            west, east, south, north = x0 - aside, x1 + aside, y0 - aside, y1 + aside
    for panel in panels:
        _path_and_sites(panel, flight, truth.lander.leg_radius)
        panel.set_xlim(west, east)
        panel.set_ylim(south, north)
    if tall:
        for panel in panels[1:]:
            panel.set_ylabel("")
    figure.legend(handles=_legend(), loc="outside lower center", ncols=4)
    figure.suptitle(_title(flight))
    save(figure, path)


def _draw_truth(figure: Any, left: Any, right: Any, truth: Truth) -> None:
    grid = truth.safety.grid
    tint = show(left, truth.elevation, grid, cmap="cividis", alpha=0.45)
    figure.colorbar(tint, ax=left, label="elevation (m)", shrink=0.6)
    map_axes(left, "true terrain")
    classes = np.where(truth.safety.observed, np.where(truth.safety.safe, 2.0, 1.0), 0.0)
    palette = ListedColormap(["#bbbbbb", "#D55E00", "#56B4E9"])
    show(right, classes, grid, cmap=palette, vmin=-0.5, vmax=2.5, alpha=0.6)
    map_axes(right, "exact safety (truth)")


def _draw_map(figure: Any, panel: Any, flight: Flight) -> None:
    """Draw the map that decided, and the sites that were chosen from."""
    if flight.hazard_map is not None:
        shown = np.where(flight.hazard_map.observed, flight.hazard_map.p_safe, np.nan)
        grid = flight.hazard_map.grid.moved(-flight.map_error)
        image = show(panel, shown, grid, cmap="viridis", vmin=0.0, vmax=1.0)
        figure.colorbar(image, ax=panel, label="probability of safety", shrink=0.6)
        _hatch_bounds(panel, flight.hazard_map, grid)
        sites = flight.candidates[:, :2] - flight.map_error[:2]
        panel.plot(*sites.T, "o", mfc="none", mec="white", ms=6)
    map_axes(panel, "hazard map and candidate sites")


def _hatch_bounds(panel: Any, hazard_map: HazardMap, grid: Grid) -> None:
    """Hatch where the probability is a bound and no frequency."""
    if hazard_map.in_domain is None:
        return
    bound = hazard_map.observed & ~hazard_map.in_domain
    if bound.any():
        hatched = panel.contourf(
            grid.x, grid.y, bound.astype(float), levels=[0.5, 1.5], colors="none", hatches=["///"]
        )
        hatched.set(edgecolor="0.8", linewidth=0.0)


def _draw_measured(figure: Any, panel: Any, flight: Flight) -> None:
    """Draw LiDAR returns, or the rocks that a mapper tracks."""
    titles = []
    dx, dy, dz = flight.map_error
    points = flight.scans
    if len(points):
        titles.append("LiDAR returns (thinned)")
        dots = panel.scatter(
            points[:, 0] - dx, points[:, 1] - dy, c=points[:, 2] - dz, s=1.2, cmap="plasma", lw=0
        )
        figure.colorbar(dots, ax=panel, label="measured elevation (m)", shrink=0.6)
    for record in flight.maps.values():
        rocks = record.tables.get("rocks")
        if rocks is None:
            continue
        titles.append("rocks tracked by their shadows")
        east, north, _ = record.error
        circles = [
            Circle((x - east, y - north), r)
            for x, y, r in zip(rocks["x"], rocks["y"], rocks["radius"], strict=True)
        ]
        panel.add_collection(
            PatchCollection(circles, facecolor="none", edgecolor=COLOURS[1], lw=0.8)
        )
    map_axes(panel, ", ".join(titles) or "nothing measured")


def _legend() -> list[Any]:
    return [
        Line2D([], [], color=COLOURS[1], label="path over the ground"),
        Line2D([], [], ls="", marker="x", color="black", mew=2, label="first aim"),
        Line2D([], [], ls="", marker="o", mfc="none", mec=COLOURS[1], ms=9, label="touchdown"),
        Line2D([], [], ls="", marker="o", mfc="#440154", mec="white", ms=7, label="candidate site"),
        Patch(fc="#440154", ec="0.8", hatch="///", lw=0.0, label="no frequency, cautious"),
        Patch(color="#56B4E9", label="truly safe at every heading"),
        Patch(color="#D55E00", label="true hazard"),
        Patch(color="#bbbbbb", label="edge of the terrain"),
    ]
