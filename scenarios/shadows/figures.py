"""Plot the figures of the shadow studies: descents, maps, detection rates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from lunarsim.evaluation.classification import RELIABILITY_EDGES
from lunarsim.evaluation.reliability import bin_frequencies
from lunarsim.onboard.hazards.shadows import cover_probability
from lunarsim.studies import unpack_array
from lunarsim.viz.style import COLOURS, map_axes, new_figure, save

PATHS = ("nominal", "modified")
CLEAR, UNKNOWN, OCCUPIED = "#4daf4a", "#ffd92f", "#c1272d"


def draw_all(results: list[dict[str, Any]], out: Path) -> None:
    """Plot all figures of the nominal and modified descents into a folder.

    `results` are the rows of `nominal_vs_modified.py`.
    """
    first = {p: _unpacked(next(r for r in results if r["path"] == p)) for p in PATHS}
    draw_paths(first, out / "paths.png")
    draw_classes(first, out / "classes.png")
    draw_contours(first, out / "contours.png")
    draw_slice(first, out / "slice.png")
    draw_reliability(results, out / "reliability.png")
    draw_cover_models(out / "forms.png")


def _unpacked(row: dict[str, Any]) -> dict[str, Any]:
    """Return the first flight of a path with arrays, and levels by altitude in m."""
    arrays = ("map", "occupied", "extent")
    levels = {
        float(altitude): level | {name: unpack_array(level[name]) for name in arrays}
        for altitude, level in row["levels"].items()
    }
    return {"levels": levels, "track": unpack_array(row["track"])}


def draw_paths(first_flights: dict[str, dict[str, Any]], path: Path) -> None:
    """Plot the nominal and the modified descent, from the side and from above.

    The figure is Figure 4 of the shadow EKF paper. `first_flights` holds the first flight by name
    of the path, "nominal" or "modified".
    """
    figure = new_figure(9.0, 3.8)
    side, top = figure.subplots(1, 2)
    for name, colour in zip(PATHS, COLOURS, strict=False):
        track = first_flights[name]["track"]
        along = track[:, :2] @ np.array([1.0, 1.0]) / np.sqrt(2.0)
        side.plot(along, track[:, 2], color=colour, label=name)
        top.plot(track[:, 0], track[:, 1], color=colour, label=name)
    side.set_xlabel("Distance along the approach from the site (m)")
    side.set_ylabel("Height above the site (m)")
    side.legend()
    side.grid(alpha=0.3)
    top.plot(0.0, 0.0, "k+", markersize=10, label="site")
    map_axes(top, "")
    top.set_aspect("equal")
    top.legend()
    top.grid(alpha=0.3)
    save(figure, path)


def draw_classes(first_flights: dict[str, dict[str, Any]], path: Path) -> None:
    """Plot clear, unknown and occupied cells by altitude (shadow EKF paper, Figure 7).

    `first_flights` holds the first flight by name of the path.
    """
    altitudes = list(first_flights["nominal"]["levels"])
    figure = new_figure(3.0 * len(altitudes), 7.0)
    figure.suptitle("Three map classes by altitude, first field")
    axes = figure.subplots(2, len(altitudes), sharex=True, sharey=True)
    colours = ListedColormap([CLEAR, UNKNOWN, OCCUPIED])
    norm = BoundaryNorm([0.0, 0.0025, 0.8, 1.0], 3)
    for row, name in enumerate(PATHS):
        for column, altitude in enumerate(altitudes):
            level = first_flights[name]["levels"][altitude]
            ax = axes[row, column]
            extent = _extent_about_center(level)
            ax.imshow(level["map"], origin="lower", extent=extent, cmap=colours, norm=norm,
                      interpolation="nearest")  # fmt: skip
            ax.set_title(f"{name}, {altitude:.0f} m")
            if row == 1:
                ax.set_xlabel("East of the site (m)")
            if column == 0:
                ax.set_ylabel("North of the site (m)")
    figure.legend(
        handles=[
            Patch(color=CLEAR, label="clear (below 0.25 %)"),
            Patch(color=UNKNOWN, label="unknown"),
            Patch(color=OCCUPIED, label="occupied (above 80 %)"),
        ],
        loc="outside lower center", ncols=3,
    )  # fmt: skip
    save(figure, path)


def _extent_about_center(view: dict[str, Any]) -> tuple[float, float, float, float]:
    """Return the extent of a map relative to its center: west, east, south, north, m.

    `view` holds the map at one altitude.
    """
    west, east, south, north = view["extent"]
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    return west - x, east - x, south - y, north - y


def draw_contours(
    first_flights: dict[str, dict[str, Any]], path: Path, half_side: float = 20.0
) -> None:
    """Plot the maps at 50 m and the true rocks around the site (shadow EKF paper, Figure 6).

    `first_flights` holds the first flight on each descent, "nominal" and "modified"; `path` is the
    image file; `half_side` is half the side of the view, m.
    """
    figure = new_figure(9.6, 4.9)
    figure.suptitle("Hazard probability around the site, first field")
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    levels = [0.0025, 0.01, 0.05, 0.2, 0.4, 0.6, 0.8, 1.0]
    for ax, name in zip(axes, PATHS, strict=True):
        level = first_flights[name]["levels"][50.0]
        west, east, south, north = _extent_about_center(level)
        rows, cols = level["map"].shape
        x = west + (np.arange(cols) + 0.5) * (east - west) / cols
        y = south + (np.arange(rows) + 0.5) * (north - south) / rows
        i, j = np.flatnonzero(abs(y) <= half_side), np.flatnonzero(abs(x) <= half_side)
        p = level["map"][np.ix_(i, j)]
        shown = ax.contourf(x[j], y[i], np.maximum(p, 1e-5), [0.0, *levels], cmap="magma_r",
                            norm=BoundaryNorm([0.0, *levels], 256))  # fmt: skip
        ax.contour(x[j], y[i], level["occupied"][np.ix_(i, j)], [0.5], colors="#0072B2",
                   linewidths=1.2)  # fmt: skip
        map_axes(ax, f"{name}, at 50 m")
        ax.set_aspect("equal")
    bar = figure.colorbar(shown, ax=axes, shrink=0.9)
    bar.set_ticks([0.0, *levels])
    bar.ax.set_yticklabels(["0", *(f"{v:g}" for v in levels)])
    bar.set_label("Hazard probability")
    figure.legend(handles=[Patch(facecolor="none", edgecolor="#0072B2", label="true hazards")],
                  loc="outside lower center")  # fmt: skip
    save(figure, path)


def draw_slice(first_flights: dict[str, dict[str, Any]], path: Path) -> None:
    """Plot hazard probability along a line by altitude (shadow EKF paper, Figure 5).

    `first_flights` holds the first flight by name of the path.
    """
    figure = new_figure(9.6, 4.4)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    # The line with the maximum number of hazards near the site.
    occupied = first_flights["modified"]["levels"][50.0]["occupied"]
    rows, cols = occupied.shape
    near = slice(cols // 2 - 60, cols // 2 + 60)
    middle = slice(rows // 2 - 60, rows // 2 + 60)
    line = rows // 2 - 60 + int(np.argmax(occupied[middle, near].sum(1)))
    for ax, name in zip(axes, PATHS, strict=True):
        for colour, (altitude, level) in zip(
            COLOURS, first_flights[name]["levels"].items(), strict=False
        ):
            west, east, *_ = _extent_about_center(level)
            x = west + (np.arange(cols) + 0.5) * (east - west) / cols
            ax.plot(x[near], np.maximum(level["map"][line, near], 1e-5), color=colour,
                    label=f"from {altitude:.0f} m")  # fmt: skip
        truth = first_flights[name]["levels"][50.0]["occupied"][line, near]
        ax.fill_between(
            x[near], 1e-5, 1.0, where=truth, step="mid", color="#bbbbbb", label="hazard"
        )
        ax.axhline(0.0025, color="k", linewidth=0.8, linestyle=":")
        ax.set_yscale("log")
        ax.set_ylim(1e-5, 1.2)
        ax.set_title(name)
        ax.set_xlabel("East of the site (m)")
    axes[0].set_ylabel("Hazard probability")
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    save(figure, path)


def draw_reliability(results: list[dict[str, Any]], path: Path) -> None:
    """Plot predicted against observed hazard probability at 50 m over all fields."""
    figure = new_figure(5.4, 4.6)
    ax = figure.subplots()
    for name, colour in zip(PATHS, COLOURS, strict=False):
        own = [r["levels"]["50.0"]["reliability"] for r in results if r["path"] == name]
        table = np.sum(own, axis=0)
        many = table[:, 0] >= 100
        stated, found = bin_frequencies(table[many])
        ax.plot(np.maximum(stated, 3e-5), np.maximum(found, 3e-5), "o-", color=colour, label=name,
                markersize=4)  # fmt: skip
    ax.plot([3e-5, 1.0], [3e-5, 1.0], "k--", linewidth=0.8, label="ideal")
    ax.axvline(0.0025, color="#888888", linewidth=0.8, linestyle=":")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("Predicted hazard probability (mean of the bin)")
    ax.set_ylabel("Observed fraction of hazard cells")
    ax.set_title(f"Maps at 50 m, {len(RELIABILITY_EDGES) - 1} bins")
    ax.legend()
    ax.grid(alpha=0.3)
    save(figure, path)


def draw_rates(data: dict[str, Any], shape: str, path: Path) -> None:
    """Plot the measured error rates of the shadow detector and the fitted lines.

    `data` are the rates by shadow size of `detection_rates.py`; `shape` is the rock shape.
    """
    figure = new_figure(8.4, 3.6)
    missed, false = figure.subplots(1, 2)
    edges = np.array(data["edges"])
    middle = 0.5 * (edges[1:] + edges[:-1])
    q = np.linspace(0.0, edges[-1], 400)
    for ax, name, count in ((missed, "missed", "rocks"), (false, "false", "detections")):
        many = np.array(data[count]) >= 30
        start, slope, floor = data["lines"][name]
        ax.plot(middle[many], np.array(data[name])[many], "o", color=COLOURS[0], label="measured")
        ax.plot(q, np.clip(start + slope * q, floor, 1.0), color=COLOURS[1], label="line")
        ax.set_xlabel("q, square root of the number of dark pixels")
        ax.grid(alpha=0.3)
        ax.legend()
    missed.plot(middle, np.array(data["missed"]) + np.array(data["merged"]), "x", color="#888888",
                label="missed or merged")  # fmt: skip
    missed.legend()
    missed.set_ylabel("False-negative rate FN(q)")
    false.set_ylabel("False-detection rate FP(q)")
    false.set_ylim(0.0, 0.1)
    figure.suptitle(f"Shadow detector on rendered rocks ({shape})")
    save(figure, path)


def draw_cover_models(path: Path) -> None:
    """Plot the probability that a rock of uncertain position covers a point.

    The exact value is compared with the approximation of the shadow EKF paper.
    """
    figure = new_figure(8.4, 3.4)
    axes = figure.subplots(1, 2, sharey=True)
    d = np.linspace(0.0, 2.0, 401)
    for ax, (sigma, radius, spread) in zip(
        axes, ((0.05, 0.5, 0.05), (0.25, 0.5, 0.1)), strict=True
    ):
        for form, colour, label in (
            ("rice", COLOURS[0], "Rice, exact"), ("gaussian", COLOURS[1], "Gaussian fit (paper)"),
        ):  # fmt: skip
            p = cover_probability(d[None], [sigma], [radius], [spread], form)[0]
            ax.plot(d, p, color=colour, label=label)
        ax.set_title(f"center ± {sigma:g} m per axis, radius {radius:g} ± {spread:g} m")
        ax.set_xlabel("Distance from the estimated center (m)")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("Probability of coverage by the rock")
    axes[0].legend()
    save(figure, path)
