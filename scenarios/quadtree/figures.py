"""Plot the figures of the hazard field experiment (Figures 10 to 23)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch, Rectangle

from lunarsim.viz.style import COLOURS, map_axes, new_figure, save, show

GREY = "#bdbdbd"


def draw_all(result: dict[str, Any], out: Path) -> None:
    """Plot all figures of the quadtree experiment for one field into a folder.

    `result` is the result of one sweep by `hazard_field.fly_field` with its maps.
    """
    last = result["evaluations"][-1]
    draw_mapping(last, out / "mapping.png")
    draw_slopes(last, out / "slopes.png")
    draw_hazards(last, out / "hazards.png")
    draw_quadtrees(result["evaluations"], out / "quadtree.png")
    draw_sites(result["evaluations"], out / "sites.png")
    draw_choice(last, out / "choice.png")
    draw_navigation(result, out / "navigation.png")


def _plot_cells(axes: Any, xy: Any, size: Any, value: Any, **options: Any) -> Any:
    """Plot square cells (n,) colored by a value; cells without a value stay grey.

    `xy` (n, 2) are centers and `size` (n,) sides, m; `options` go to the matplotlib collection.
    """
    known = np.isfinite(value)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    boxes = xy[known][:, None] + size[known][:, None, None] * corners
    limits = {k: options.pop(k) for k in ("vmin", "vmax") if k in options}
    patches = PolyCollection(boxes, linewidth=0.0, antialiased=False, **options)
    patches.set_array(value[known])
    if limits:
        patches.set_clim(limits["vmin"], limits["vmax"])
    axes.add_collection(patches)
    axes.set_facecolor(GREY)
    return patches


def _set_frame(axes: Any, maps: dict[str, Any], title: str) -> None:
    """Set the title of a map panel, and its limits to the area of the maps."""
    map_axes(axes, title)
    west, east, south, north = maps["fine"].extent
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)


def _plot_terrain(axes: Any, maps: dict[str, Any]) -> Any:
    """Plot the true elevation on a map panel; return the image."""
    low, high = np.nanpercentile(maps["elevation"], [0.2, 99.9])
    return show(axes, maps["elevation"], maps["fine"], cmap="cividis", vmin=low, vmax=high)


def draw_mapping(view: dict[str, Any], path: Path) -> None:
    """Plot true and mapped elevation and the error (Figures 10 to 12).

    `view` holds the metrics and maps at one time. Figure numbers are those of the quadtree paper.
    """
    maps = view["maps"]
    xy, size, error, true = maps["height"]
    figure = new_figure(13.0, 4.4)
    truth, mapped, wrong = figure.subplots(1, 3, sharex=True, sharey=True)
    image = _plot_terrain(truth, maps)
    figure.colorbar(image, ax=truth, label="Elevation (m)", shrink=0.8)
    _set_frame(truth, maps, "truth")
    low, high = image.get_clim()
    cells = _plot_cells(mapped, xy, size, true + error, cmap="cividis", vmin=low, vmax=high)
    figure.colorbar(cells, ax=mapped, label="Elevation (m)", shrink=0.8)
    _set_frame(mapped, maps, f"map at {view['time']:.0f} s")
    cells = _plot_cells(wrong, xy, size, error, cmap="RdBu_r", vmin=-0.15, vmax=0.15)
    figure.colorbar(cells, ax=wrong, label="Map minus truth (m)", shrink=0.8, extend="both")
    _set_frame(wrong, maps, f"error, RMS {view['map_error_rms']:.3f} m")
    save(figure, path)


def draw_slopes(view: dict[str, Any], path: Path) -> None:
    """Plot slope estimates and errors at the sites (Figures 13, 14).

    `view` holds the metrics and maps at one time. Figure numbers are those of the quadtree paper.
    """
    maps = view["maps"]
    selection, size = maps["selection"], maps["sizes"]
    figure = new_figure(9.4, 4.4)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    xy = selection.position[:, :2]
    cells = _plot_cells(
        left, xy, size, np.rad2deg(selection.slope), cmap="viridis", vmin=0.0, vmax=5.0
    )
    figure.colorbar(cells, ax=left, label="Slope (deg)", shrink=0.8, extend="max")
    _set_frame(left, maps, f"slope of the fitted planes at {view['time']:.0f} s")
    cells = _plot_cells(right, xy, size, maps["slope"], cmap="magma_r", vmin=0.0, vmax=2.0)
    figure.colorbar(
        cells, ax=right, label="Angle to the true normal (deg)", shrink=0.8, extend="max"
    )
    _set_frame(right, maps, f"slope error, maximum {view['slope_error_max']:.1f} deg")
    save(figure, path)


def draw_hazards(view: dict[str, Any], path: Path) -> None:
    """Plot the outlier ratio, hazards and their correctness (Figures 15 to 17).

    The outlier ratio is the fraction of points too far from the fitted surface. `view` holds the
    metrics and maps at one time. Figure numbers are those of the quadtree paper.
    """
    maps = view["maps"]
    figure = new_figure(13.0, 4.9)
    ratio, over, right = figure.subplots(1, 3, sharex=True, sharey=True)
    raster, half = maps["ratios"], 0.5 * maps["side"]
    cx, cy = maps["centre"][:2]
    extent = (cx - half, cx + half, cy - half, cy + half)
    ratio.set_facecolor(GREY)
    image = ratio.imshow(
        raster, origin="lower", extent=extent, interpolation="nearest", cmap="YlOrRd",
        vmin=0.0, vmax=0.1,
    )  # fmt: skip
    figure.colorbar(image, ax=ratio, label="Exceptions / points", shrink=0.8, extend="max")
    _plot_outline(ratio, raster > maps["limit"], extent)
    _set_frame(ratio, maps, "exception ratio; hazards outlined")
    image = _plot_terrain(over, maps)
    figure.colorbar(image, ax=over, label="True elevation (m)", shrink=0.8)
    _plot_outline(over, raster > maps["limit"], extent, color="white")
    _set_frame(over, maps, "hazards on the true terrain")
    estimated, hazard = maps["estimated"], maps["hazard"]
    evaluated = np.isfinite(estimated) & np.isfinite(hazard)
    classes = np.where(
        evaluated, np.where(estimated == hazard, 0.0, np.where(estimated == 1.0, 1.0, 2.0)), np.nan
    )
    right.set_facecolor(GREY)
    show(
        right, classes, maps["fine"], cmap=ListedColormap(["#a6cee3", "#33a02c", "#e31a1c"]),
        vmin=-0.5, vmax=2.5,
    )  # fmt: skip
    _set_frame(right, maps, "compared with the truth")
    right.legend(
        handles=[
            Patch(color="#a6cee3", label="correct"),
            Patch(color="#33a02c", label=f"false hazard: {view['false_m2']:.0f} m²"),
            Patch(color="#e31a1c", label=f"missed hazard: {view['missed_m2']:.1f} m²"),
            Patch(color=GREY, label="too few points"),
        ],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.16),
        ncols=2,
    )
    save(figure, path)


def _plot_outline(axes: Any, hazard: Any, extent: Any, color: str = "black") -> None:
    """Plot the edges of hazardous squares; `hazard` is a boolean map (rows, cols).

    `extent` is its west, east, south and north limit, m.
    """
    west, east, south, north = extent
    rows, cols = hazard.shape
    dx, dy = (east - west) / cols, (north - south) / rows
    padded = np.pad(hazard, 1)
    lines = []
    for row, col in zip(*np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1]), strict=True):
        x = west + col * dx
        lines.append([(x, south + row * dy), (x, south + (row + 1) * dy)])
    for row, col in zip(*np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1]), strict=True):
        y = south + row * dy
        lines.append([(west + col * dx, y), (west + (col + 1) * dx, y)])
    axes.add_collection(LineCollection(lines, colors=color, linewidths=0.7))


def draw_quadtrees(views: list[dict[str, Any]], path: Path) -> None:
    """Plot the cells of the quadtree at each time (Figures 19 and 20).

    `views` has metrics and maps at each time. Figure numbers are those of the quadtree paper.
    """
    figure = new_figure(9.6, 5.0)
    for axes, look in zip(figure.subplots(1, 2, sharex=True, sharey=True), views, strict=True):
        xy, size = look["maps"]["cells"]
        half = 0.5 * size[:, None, None]
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
        axes.add_collection(
            LineCollection(xy[:, None, :] + half * corners, colors="black", linewidths=0.15)
        )
        _set_frame(
            axes, look["maps"], f"quadtree at {look['time']:.0f} s, down to the 8th division"
        )
    save(figure, path)


def _plot_sites(axes: Any, view: dict[str, Any], *, legend: bool) -> None:
    """Plot the ranked landing sites and their landing zones on a map panel."""
    zone = view["maps"]["zone"]
    for rank, site in enumerate(view["sites"]):
        x, y = site["position"][:2]
        colour = COLOURS[(rank + 1) % len(COLOURS)]
        label = (
            f"{rank + 1}: score {site['score']:.2f}, {site['propellant']:.0f} kg"
            if legend
            else None
        )
        axes.plot(x, y, "o", color=colour, ms=4, mec="white", mew=0.5, label=label)
        box = Rectangle((x - zone, y - zone), 2 * zone, 2 * zone, fill=False, ec=colour, lw=1.6)
        axes.add_patch(box)
    if legend and view["sites"]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, title="site")


def draw_sites(views: list[dict[str, Any]], path: Path) -> None:
    """Plot the ranked sites during and after the sweep (Figures 21, 22).

    `views` has metrics and maps at each time. Figure numbers are those of the quadtree paper.
    """
    figure = new_figure(10.4, 5.8)
    for axes, look in zip(figure.subplots(1, 2, sharex=True, sharey=True), views, strict=True):
        maps = look["maps"]
        image = _plot_terrain(axes, maps)
        half = 0.5 * maps["side"]
        cx, cy = maps["centre"][:2]
        extent = (cx - half, cx + half, cy - half, cy + half)
        _plot_outline(axes, maps["ratios"] > maps["limit"], extent, color="white")
        grey = np.where(np.isnan(maps["ratios"]), 1.0, np.nan)
        axes.imshow(grey, origin="lower", extent=extent, cmap=ListedColormap([GREY]), alpha=0.75)
        _plot_sites(axes, look, legend=True)
        figure.colorbar(image, ax=axes, label="True elevation (m)", shrink=0.8)
        _set_frame(axes, maps, f"sites at {look['time']:.0f} s (grey: not observed)")
    save(figure, path)


def draw_choice(view: dict[str, Any], path: Path) -> None:
    """Plot the sites on true hazards and on the interest map (Figures 18, 23).

    The interest map holds the mission's interest in each place. `view` holds the metrics and
    maps at one time. Figure numbers are those of the quadtree paper.
    """
    maps = view["maps"]
    figure = new_figure(10.0, 4.9)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    left.set_facecolor(GREY)
    show(
        left, maps["hazard"], maps["fine"], cmap=ListedColormap(["#a6cee3", "#e31a1c"]),
        vmin=-0.5, vmax=1.5,
    )  # fmt: skip
    _plot_sites(left, view, legend=False)
    _set_frame(left, maps, "sites and true hazards")
    left.legend(
        handles=[Patch(color="#a6cee3", label="safe"), Patch(color="#e31a1c", label="hazard"),
                 Patch(color=GREY, label="no true surface mesh")],
        loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3,
    )  # fmt: skip
    interest = maps["interest"]
    image = show(right, interest.value, interest.grid, cmap="RdYlBu", vmin=0.0, vmax=1.0)
    figure.colorbar(image, ax=right, label="Interest", shrink=0.8)
    _plot_sites(right, view, legend=False)
    _set_frame(right, maps, "sites and interest")
    save(figure, path)


def draw_navigation(result: dict[str, Any], path: Path) -> None:
    """Plot the navigation errors of a sweep and the standard deviations of the filter."""
    track = result["track"]
    figure = new_figure(9.6, 5.4)
    panels = figure.subplots(2, 1, sharex=True)
    for axes, first, names, scale, unit in (
        (panels[0], 1, ("east", "north", "up"), 1.0, "Position error (m)"),
        (panels[1], 4, ("body x", "body y", "body z"), np.rad2deg(1.0), "Attitude error (deg)"),
    ):
        for k, name in enumerate(names):
            axes.semilogy(
                track[:, 0], np.abs(track[:, first + k]) * scale, color=COLOURS[k], lw=1.0,
                label=name,
            )  # fmt: skip
            axes.semilogy(
                track[:, 0], track[:, first + 6 + k] * scale, color=COLOURS[k], ls="--", lw=1.0
            )
        for time, name in result["events"]:
            if time <= track[-1, 0]:
                axes.axvline(time, color="black", lw=0.8)
                axes.annotate(
                    name, (time, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -10),
                    textcoords="offset points",
                )  # fmt: skip
        axes.set_ylabel(unit)
        axes.grid(alpha=0.3)
        axes.legend(ncols=3, loc="upper right")
    panels[0].set_title("absolute error (solid) and 1 sigma of the filter (dashed)")
    panels[1].set_xlabel("Time (s)")
    save(figure, path)
