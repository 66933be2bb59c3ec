"""Draw the figure of a flight's decision map and the truth."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from lunarsim.evaluation.flight_metrics import initial_aim_point
from lunarsim.evaluation.reach import decision_rows, reach_at_row
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.map_record import map_remarks_by_mapper
from lunarsim.viz.map_bounds import divert_segments, map_figure_bounds
from lunarsim.viz.style import COLOURS, flight_title, hillshade, map_axes, new_figure, save, show
from lunarsim.world import World
from lunarsim.world.truth import TerrainTruth, TruthMap

# White with a black edge, visible on dark and bright terrain.
_CANDIDATE: dict[str, Any] = {
    "marker": "o",
    "ls": "",
    "mfc": "white",
    "mec": "black",
    "ms": 5,
    "mew": 0.8,
}
_DIVERT_COLOUR = COLOURS[3]
# Characters per line that fit a panel, for tall and for other terrain.
_LINE_LENGTH = {True: 34, False: 60}
# Maximum number of sites along a side of the maps of terrain and true safety.
_MAX_CELLS = 400
# Number of cells along the longer side of the grid for the area in reach.
_REACH_CELLS = 100
# White under the black line, visible on dark and bright terrain.
_REACH_LINES = (("first", "-"), ("last", ":"))


def _draw_path_and_diverts(axes: Any, flight: Flight, radius: float) -> None:
    """Draw ground track, initial aim point, diverts and touchdown in the true frame.

    `radius` is the radius of the circle at the touchdown, m.
    """
    t = flight.trajectory
    axes.plot(t["position_x"], t["position_y"], color=COLOURS[1], lw=1.5)
    # Two colours, visible on dark and bright terrain.
    axes.plot(*initial_aim_point(flight), "x", color="white", ms=10, mew=4)
    axes.plot(*initial_aim_point(flight), "x", color="black", ms=8, mew=2)
    for start, goal in divert_segments(flight):
        axes.annotate(
            "", goal, start, zorder=6,
            arrowprops={"arrowstyle": "-|>", "color": _DIVERT_COLOUR, "lw": 1.6, "shrinkA": 0,
                        "shrinkB": 0, "mutation_scale": 11},
        )  # fmt: skip
    end = flight.positions[-1]
    axes.add_patch(Circle(end[:2], radius, fill=False, ec="black", lw=2.2))
    axes.add_patch(Circle(end[:2], radius, fill=False, ec=COLOURS[1], lw=1.2))


def draw_maps(
    flight: Flight, world: World, truth: TerrainTruth, path: Path | None = None
) -> Figure:
    """Draw true terrain, exact safety, hazard map, and LiDAR returns or tracked rocks.

    All panels are in the true frame: the map is shifted by the navigation error at the time of the
    map. They show the part of the world that `lunarsim.viz.map_bounds.map_figure_bounds` returns.

    Parameters
    ----------
    flight, world
        Record and world of the flight.
    truth
        Exact landing safety of the terrain.
    path
        PNG file to write.
    """
    bounds = west, east, south, north = map_figure_bounds(flight, world)
    tall = (north - south) > 1.25 * (east - west)
    figure = new_figure(12.5 if tall else 10.5, 7.4 if tall else 11.4)
    panels = figure.subplots(1, 4, sharey=True) if tall else figure.subplots(2, 2).ravel()
    drawn = truth.within(bounds, _MAX_CELLS)
    grid = drawn.grid
    shade = hillshade(drawn.elevation, grid.posting)
    for panel in panels:
        show(panel, shade, grid, cmap="gray", vmin=0.2, vmax=1.0)
    _draw_truth(figure, panels[0], panels[1], drawn)
    _draw_map(figure, panels[2], flight, _LINE_LENGTH[tall])
    _draw_measurements(figure, panels[3], flight)
    outlines = draw_reach(panels[2], flight, bounds)
    for panel in panels:
        _draw_path_and_diverts(panel, flight, truth.lander.leg_radius)
        panel.set_xlim(west, east)
        panel.set_ylim(south, north)
        # Align panels with and without a colour bar at the top.
        panel.set_anchor("N")
        panel.set_title(fill(panel.get_title(), _LINE_LENGTH[tall]))
    if tall:
        for panel in panels[1:]:
            panel.set_ylabel("")
    figure.legend(handles=_legend() + outlines, loc="outside lower center", ncols=5)
    figure.suptitle(flight_title(flight))
    if path is not None:
        save(figure, path)
    return figure


def _draw_truth(figure: Any, left: Any, right: Any, truth: TruthMap) -> None:
    grid = truth.grid
    tint = show(left, truth.elevation, grid, cmap="cividis", alpha=0.45)
    _add_colour_bar(figure, tint, left, "Elevation (m)")
    map_axes(left, "True terrain")
    classes = np.where(truth.observed, np.where(truth.safe, 2.0, 1.0), 0.0)
    palette = ListedColormap(["#bbbbbb", "#D55E00", "#56B4E9"])
    drawn = show(right, classes, grid, cmap=palette, vmin=-0.5, vmax=2.5, alpha=0.6)
    bar = _add_colour_bar(figure, drawn, right, "Safety at every heading")
    bar.set_ticks([0.0, 1.0, 2.0], labels=["edge", "unsafe", "safe"])
    map_axes(right, "Exact safety (truth)")


def _draw_map(figure: Any, panel: Any, flight: Flight, line_length: int) -> None:
    """Draw the hazard map used for the decision, and the candidate sites.

    Remarks on the mapper, if there are any, are added as text; `line_length` is the maximum number
    of characters per line. Without a hazard map the panel is empty.
    """
    if flight.hazard_map is not None:
        shown = np.where(flight.hazard_map.observed, flight.hazard_map.p_safe, np.nan)
        grid = flight.hazard_map.grid.moved(-flight.map_error)
        image = show(panel, shown, grid, cmap="viridis", vmin=0.0, vmax=1.0)
        label = "p_safe: slope, roughness and belly in limits at any heading"
        _add_colour_bar(figure, image, panel, label)
        _hatch_outside_domain(panel, flight.hazard_map, grid)
        sites = flight.candidates[:, :2] - flight.map_error[:2]
        panel.plot(*sites.T, **_CANDIDATE)
    map_axes(panel, "Hazard map and candidate sites")
    words = map_remarks_by_mapper(flight.maps, flight.decision_mapper).get(flight.decision_mapper)
    if words is not None:
        text = panel.text(
            0.5, 0.97, fill(f"this map {words}", line_length), transform=panel.transAxes,
            ha="center", va="top", fontsize=8, zorder=9,
            bbox={"fc": "white", "ec": COLOURS[1], "lw": 1.2},
        )  # fmt: skip
        text.set_in_layout(False)


def _add_colour_bar(figure: Any, drawn: Any, panel: Any, label: str) -> Any:
    """Draw a colour bar below its panel, clear of the next panel's axis; return it.

    `drawn` is the image whose colours the bar explains.
    """
    return figure.colorbar(drawn, ax=panel, label=label, location="bottom", shrink=0.8, aspect=30)


def _hatch_outside_domain(panel: Any, hazard_map: HazardMap, grid: Grid) -> None:
    """Hatch the cells outside the calibrated domain, where p_safe is heuristic.

    `grid` is the grid of the map in the true frame. Nothing is drawn if the map has no domain.
    """
    if hazard_map.in_domain is None:
        return
    outside = hazard_map.observed & ~hazard_map.in_domain
    if outside.any():
        hatched = panel.contourf(
            grid.x, grid.y, outside.astype(float), levels=[0.5, 1.5], colors="none", hatches=["///"]
        )
        hatched.set(edgecolor="0.8", linewidth=0.0)


def _draw_measurements(figure: Any, panel: Any, flight: Flight) -> None:
    """Draw LiDAR returns, and the rocks that the mappers track, in the true frame."""
    titles = []
    dx, dy, dz = flight.map_error
    points = flight.scans
    if len(points):
        titles.append("LiDAR returns (thinned)")
        dots = panel.scatter(
            points[:, 0] - dx, points[:, 1] - dy, c=points[:, 2] - dz, s=1.2, cmap="plasma", lw=0
        )
        _add_colour_bar(figure, dots, panel, "Measured elevation (m)")
    for record in flight.maps.values():
        rocks = record.tables.get("rocks")
        if rocks is None:
            continue
        some = "Rocks tracked by their shadows", "No rock tracked by its shadow"
        titles.append(some[0] if len(rocks["x"]) else some[1])
        east, north, _ = record.error
        circles = [
            Circle((x - east, y - north), r)
            for x, y, r in zip(rocks["x"], rocks["y"], rocks["radius"], strict=True)
        ]
        panel.add_collection(
            PatchCollection(circles, facecolor="none", edgecolor=COLOURS[1], lw=0.8)
        )
    map_axes(panel, ", ".join(titles) or "No measurements")


def _legend() -> list[Any]:
    """Return the legend entries of the map figure."""
    return [
        Line2D([], [], color=COLOURS[1], label="ground track"),
        Line2D([], [], ls="", marker="x", color="black", mew=2, label="initial aim point"),
        Line2D([], [], ls="", marker="o", mfc="none", mec=COLOURS[1], ms=9, label="touchdown"),
        Line2D([], [], color=_DIVERT_COLOUR, marker=">", label="divert"),
        Line2D([], [], label="candidate site", **_CANDIDATE),
        Patch(fc="#440154", ec="0.8", hatch="///", lw=0.0, label="outside calibrated domain"),
        Patch(color="#56B4E9", label="truly safe at every heading"),
        Patch(color="#D55E00", label="truly unsafe"),
        Patch(color="#bbbbbb", label="edge of the terrain"),
    ]


def draw_reach(panel: Any, flight: Flight, extent: tuple[float, float, float, float]) -> list[Any]:
    """Draw outlines of the area in reach at the first and the last possible decision.

    The function returns the legend entries; they are empty if no decision was possible. An outline
    is omitted if none or all of the panel is in reach.

    Parameters
    ----------
    panel
        Axes of a map in the true frame.
    flight
        Record of the flight.
    extent
        West, east, south and north edges of the panel, m.
    """
    rows = decision_rows(flight)
    if rows is None:
        return []
    west, east, south, north = extent
    width, height = east - west, north - south
    middle = (0.5 * (west + east), 0.5 * (south + north))
    grid = Grid.centred(middle, width, max(width, height) / _REACH_CELLS, height)
    handles = []
    for row, (when, style) in zip(rows, _REACH_LINES, strict=True):
        within = reach_at_row(flight, row, grid.moved(flight.map_error)).reachable
        # Rounded down, so that 100 % means the entire map.
        share = f"{np.floor(1000.0 * within.mean()) / 10.0:g} % of this map"
        label = f"reachable at the {when} decision: {share}"
        handles.append(Line2D([], [], color="black", ls=style, lw=1.6, label=label))
        if within.any() and not within.all():
            for colour, wide in (("white", 3.0), ("black", 1.4)):
                panel.contour(
                    grid.x, grid.y, within.astype(np.float64), levels=[0.5], colors=colour,
                    linewidths=wide, linestyles="-" if colour == "white" else style,
                )  # fmt: skip
    return handles
