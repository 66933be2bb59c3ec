"""Figures of one flight: the descent, and the maps it was decided on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.loop import Simulation
from lunarsim.viz.style import COLOURS, hillshade, map_axes, new_figure, save, show

# What the squares on a descent stand for.
_MARKED = {"gaussian-dem": "LiDAR scan", "shadow": "first picture", "quadtree": "lock onto the map"}


def draw_flight(simulation: Simulation, flight: Flight, folder: Path) -> None:
    """Write ``descent.png`` and ``maps.png`` of a finished flight into `folder`."""
    draw_descent(simulation, flight, folder / "descent.png")
    draw_maps(simulation, flight, folder / "maps.png")


def _outcome(flight: Flight) -> str:
    if flight.verdict.safe:
        return "landed safe"
    return "failed: " + ", ".join(flight.verdict.failed)


def draw_descent(simulation: Simulation, flight: Flight, path: Path) -> None:
    """Draw the profile, speeds, tilt and thrust of a descent."""
    t = flight.trajectory
    time = t["time"]
    pads = simulation.lander.com_height
    ground = flight.positions[-1, 2] - pads
    altitude = t["position_z"] - pads - ground
    end = flight.positions[-1, :2]
    away = np.hypot(t["position_x"] - end[0], t["position_y"] - end[1])
    figure = new_figure(11, 6.4)
    axes: dict[str, Any] = figure.subplot_mosaic(
        [["profile", "speed"], ["profile", "tilt"], ["profile", "thrust"]]
    )

    profile = axes["profile"]
    profile.plot(away, altitude, color=COLOURS[0], lw=1.8)
    last = np.argmax(t["phase"] > 0) if (t["phase"] > 0).any() else None
    for event in flight.events:
        if event["name"] in {"scan", "picture", "lock", "relock"}:
            i = int(np.argmin(np.abs(time - event["time"])))
            profile.plot(away[i], altitude[i], "s", color=COLOURS[2], ms=7)
    for decision in flight.decisions:
        i = int(np.argmin(np.abs(time - decision["time"])))
        profile.plot(away[i], altitude[i], "D", color=COLOURS[1], ms=5)
    profile.plot(away[-1], altitude[-1], "v", color="black", ms=7)
    handles = [
        Line2D([], [], color=COLOURS[0], label="path"),
        Line2D(
            [],
            [],
            ls="",
            marker="s",
            color=COLOURS[2],
            label=_MARKED[simulation.scenario.mapper.kind],
        ),
        Line2D([], [], ls="", marker="D", color=COLOURS[1], label="divert"),
        Line2D([], [], ls="", marker="v", color="black", label="touchdown"),
    ]
    profile.legend(handles=handles, loc="upper left")
    profile.set_xlabel("distance to touchdown over the ground (m)")
    profile.set_ylabel("altitude of the pads above touchdown (m)")
    profile.set_title(f"{simulation.scenario.name}, {flight.policy}: {_outcome(flight)}")
    profile.grid(alpha=0.3)

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
    for limit in (simulation.lander.thrust_min, simulation.lander.thrust_max):
        axes["thrust"].axhline(limit / 1e3, color="0.5", lw=0.8, ls="--")
    axes["thrust"].plot([], [], color="0.5", lw=0.8, ls="--", label="throttle limits")
    axes["thrust"].set_ylabel("thrust (kN)")
    axes["thrust"].set_xlabel("time (s)")
    axes["thrust"].legend(loc="upper right")
    for name in ("speed", "tilt", "thrust"):
        axes[name].set_xlim(0.0, time[-1])
        axes[name].grid(alpha=0.3)
        if last is not None:
            axes[name].axvline(time[last], color="0.6", lw=0.8)
        if name != "thrust":
            axes[name].tick_params(labelbottom=False)
    save(figure, path)


def _path_and_sites(axes: Any, simulation: Simulation, flight: Flight, error: Any) -> None:
    """Draw path, sites and touchdown in the true frame."""
    t = flight.trajectory
    axes.plot(t["position_x"], t["position_y"], color=COLOURS[1], lw=1.5)
    first = np.array([t["site_x"][0], t["site_y"][0]]) - error[:2]
    axes.plot(*first, "x", color="black", ms=8, mew=2)
    end = flight.positions[-1]
    axes.add_patch(Circle(end[:2], simulation.lander.leg_radius, fill=False, ec="black", lw=2.2))
    axes.add_patch(Circle(end[:2], simulation.lander.leg_radius, fill=False, ec=COLOURS[1], lw=1.2))


def _tracked_rocks(axes: Any, rocks: RockFilter, error: Any) -> None:
    """Draw the rocks that the filter holds, in the true frame."""
    circles = [
        Circle((x - error[0], y - error[1]), r)
        for (x, y), r in zip(rocks.xy, rocks.radius, strict=True)
    ]
    axes.add_collection(PatchCollection(circles, facecolor="none", edgecolor=COLOURS[1], lw=0.8))


def draw_maps(simulation: Simulation, flight: Flight, path: Path) -> None:
    """Draw true terrain, exact safety, the map, and the LiDAR returns or tracked rocks.

    All panels are in the true frame: the map is moved by the navigation error when it was drawn.
    """
    truth = simulation.truth
    grid = truth.safety.grid
    error = flight.map_error
    shade = hillshade(truth.elevation, grid.posting)
    west, east, south, north = simulation.world.terrain.bounds
    tall = (north - south) > 1.25 * (east - west)
    figure = new_figure(12.5 if tall else 11, 6.0 if tall else 9.6)
    panels = figure.subplots(1, 4, sharey=True) if tall else figure.subplots(2, 2).ravel()

    show(panels[0], shade, grid, cmap="gray", vmin=0.2, vmax=1.0)
    tint = show(panels[0], truth.elevation, grid, cmap="cividis", alpha=0.45)
    figure.colorbar(tint, ax=panels[0], label="elevation (m)", shrink=0.6)
    map_axes(panels[0], "true terrain")

    show(panels[1], shade, grid, cmap="gray", vmin=0.2, vmax=1.0)
    classes = np.where(truth.safety.observed, np.where(truth.safety.safe, 2.0, 1.0), 0.0)
    palette = ListedColormap(["#bbbbbb", "#D55E00", "#56B4E9"])
    show(panels[1], classes, grid, cmap=palette, vmin=-0.5, vmax=2.5, alpha=0.6)
    map_axes(panels[1], "exact safety (truth)")

    show(panels[2], shade, grid, cmap="gray", vmin=0.2, vmax=1.0)
    if flight.hazard_map is not None:
        own = flight.hazard_map.grid
        shown = np.where(flight.hazard_map.observed, flight.hazard_map.p_safe, np.nan)
        x0, x1, y0, y1 = own.extent
        image = panels[2].imshow(
            shown,
            origin="lower",
            extent=(x0 - error[0], x1 - error[0], y0 - error[1], y1 - error[1]),
            interpolation="nearest",
            cmap="viridis",
            vmin=0.0,
            vmax=1.0,
        )
        figure.colorbar(image, ax=panels[2], label="probability of safety", shrink=0.6)
        sites = flight.candidates
        panels[2].plot(
            sites[:, 0] - error[0], sites[:, 1] - error[1], "o", mfc="none", mec="white", ms=6
        )
    map_axes(panels[2], "hazard map and candidate sites")

    show(panels[3], shade, grid, cmap="gray", vmin=0.2, vmax=1.0)
    points = flight.scans
    rocks = simulation.computer.navigation
    if isinstance(rocks, RockFilter):
        _tracked_rocks(panels[3], rocks, error)
    if len(points):
        dots = panels[3].scatter(
            points[:, 0] - error[0],
            points[:, 1] - error[1],
            c=points[:, 2] - error[2],
            s=1.2,
            cmap="plasma",
            lw=0,
        )
        figure.colorbar(dots, ax=panels[3], label="measured elevation (m)", shrink=0.6)
    map_axes(
        panels[3],
        "LiDAR returns (thinned)"
        if not isinstance(rocks, RockFilter)
        else "rocks tracked by their shadows",
    )

    if flight.hazard_map is not None:
        x0, x1, y0, y1 = flight.hazard_map.grid.extent
        if max(x1 - x0, y1 - y0) < 0.5 * max(east - west, north - south):
            # The ground reaches far beyond what is mapped: show the map and some of the way to it.
            aside = 0.25 * (x1 - x0)
            west, east, south, north = x0 - aside, x1 + aside, y0 - aside, y1 + aside
    for panel in panels:
        _path_and_sites(panel, simulation, flight, error)
        panel.set_xlim(west, east)
        panel.set_ylim(south, north)
    if tall:
        for panel in panels[1:]:
            panel.set_ylabel("")
    figure.legend(
        handles=[
            Line2D([], [], color=COLOURS[1], label="path over the ground"),
            Line2D([], [], ls="", marker="x", color="black", mew=2, label="first target"),
            Line2D([], [], ls="", marker="o", mfc="none", mec=COLOURS[1], ms=9, label="touchdown"),
            Line2D(
                [], [], ls="", marker="o", mfc="#440154", mec="white", ms=7, label="candidate site"
            ),
            Patch(color="#56B4E9", label="truly safe at every heading"),
            Patch(color="#D55E00", label="true hazard"),
            Patch(color="#bbbbbb", label="edge of the terrain"),
        ],
        loc="outside lower center",
        ncols=7,
    )
    figure.suptitle(f"{simulation.scenario.name}, {flight.policy}: {_outcome(flight)}")
    save(figure, path)
