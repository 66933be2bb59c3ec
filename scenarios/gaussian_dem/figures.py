"""Plot the figures of the reproduction of the Gaussian DEM paper (`tables.py`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap

from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.evaluation.reliability import calibration_error
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import hillshade, map_axes, new_figure, save, show

_VIEW = 10.0  # side of the map segment in the paper, m


def draw_conservativeness(maps: list[Any], path: Path) -> None:
    """Plot terrain and the safe cells by three safety tests against complexity.

    The figure extends Figure 12 of the Gaussian DEM paper by one row. Each entry of `maps` holds
    the complexity c (factor on the measured relief), elevations, the safe cells by the exact,
    conservative and support-plane tests, and the grid. `path` is the output file.
    """
    figure = new_figure(2.4 * len(maps), 12.5)
    axes = figure.subplots(4, len(maps), sharex=True, sharey=True)
    palette = ListedColormap(["#303030", "#ffffff"])
    for n, (c, z, exact, ours, through, grid) in enumerate(maps):
        show(axes[0, n], hillshade(z, grid.posting), grid, cmap="gray", vmin=0, vmax=1)
        map_axes(axes[0, n], f"c = {c}: relief")
        layers = ((exact, "exact test"), (ours, "conservative"), (through, "support planes"))
        for row, (layer, title) in enumerate(layers, start=1):
            show(axes[row, n], layer, grid, cmap=palette, vmin=0, vmax=1)
            map_axes(axes[row, n], f"{title}: {100 * layer.mean():.1f} %")
    for ax in axes[:, 1:].ravel():
        ax.set_ylabel("")
    for ax in axes[:3].ravel():
        ax.set_xlabel("")
    figure.suptitle(
        "White: safe cells (percentage of the map). Terrain of Eq. 20 on the HiRISE "
        "crop, 0.1 m posting"
    )
    save(figure, path)


def draw_panels(
    maps: list[Any],
    configurations: list[tuple[float, float]],
    label: str,
    path: Path,
    *,
    diverging: bool = False,
) -> None:
    """Plot a map layer for the nine scans: range by row, off-nadir angle by column.

    Each entry of `maps` holds the layer, its grid and the LiDAR returns (n, 3). `configurations`
    are range (m) and angle (deg) of each scan; `label` is the text of the color bar; `diverging`
    selects a color scale from -1 to 1. `path` is the output file.
    """
    figure = new_figure(9.0, 8.6)
    axes = figure.subplots(3, 3, sharex=True, sharey=True)
    half = 0.5 * _VIEW
    spans = []
    for layer, grid, _ in maps:
        inside = np.ix_(np.abs(grid.y) < half, np.abs(grid.x) < half)
        spans.append(layer[inside][np.isfinite(layer[inside])])
    values = np.concatenate(spans)
    low, high = (-1.0, 1.0) if diverging else (float(values.min()), float(values.max()))
    image = None
    for ax, (layer, grid, points), (distance, angle) in zip(
        axes.ravel(), maps, configurations, strict=True
    ):
        ax.set_facecolor("0.7")
        image = show(
            ax, layer, grid, cmap="RdBu_r" if diverging else "viridis", vmin=low, vmax=high
        )
        near = np.abs(points[:, :2]).max(axis=1) < half
        ax.plot(points[near, 0], points[near, 1], "k.", ms=0.8)
        map_axes(ax, f"{distance:.0f} m, {angle:.0f} deg")
        ax.set_xlim(-half, half)
        ax.set_ylim(-half, half)
    for ax in axes[:, 1:].ravel():
        ax.set_ylabel("")
    for ax in axes[:2].ravel():
        ax.set_xlabel("")
    figure.colorbar(image, ax=axes, label=label, shrink=0.8)
    save(figure, path)


def draw_reliability(
    bins: np.ndarray, configurations: list[tuple[float, float]], path: Path
) -> None:
    """Plot the fraction of truly safe cells against p_safe for the nine scans.

    `bins` holds one calibration table per configuration (range in m, angle in deg); bars show the
    fraction of cells in each bin. `path` is the output file.
    """
    figure = new_figure(9.0, 8.6)
    axes = figure.subplots(3, 3, sharex=True, sharey=True)
    for ax, counts, (distance, angle) in zip(axes.ravel(), bins, configurations, strict=True):
        plot_ideal(ax, label="perfect calibration")
        plot_reliability(ax, counts, color="#0072B2", label="map")
        share = counts[:, 0] / counts[:, 0].sum()
        ax.bar((np.arange(20) + 0.5) / 20, share, width=0.045, color="#E69F00", alpha=0.6,
               label="fraction of cells")  # fmt: skip
        ax.set_title(
            f"{distance:.0f} m, {angle:.0f} deg: calibration error {calibration_error(counts):.3f}"
        )
        ax.set_aspect("equal")
    for ax in axes[2]:
        ax.set_xlabel("Probability of safety")
    for ax in axes[:, 0]:
        ax.set_ylabel("Fraction truly safe")
    axes[0, 0].legend(loc="lower right", fontsize=7)
    save(figure, path)


def central_rocks(rocks: Any) -> list[tuple[str, float, float]]:
    """Return label (A, B), x and y (m) of the two rocks nearest to the center."""
    nearest = np.argsort(np.hypot(rocks.x, rocks.y))[:2]
    return [(name, rocks.x[n], rocks.y[n]) for name, n in zip("AB", nearest, strict=True)]


def draw_testbed(field: Any, configurations: list[tuple[float, float]], path: Path) -> None:
    """Plot the testbed terrain and the geometry of the nine scans (Figure 13).

    `field` is the simulated testbed; `configurations` are range (m) and angle off nadir (deg).
    """
    figure = new_figure(10.0, 4.8)
    left, right = figure.subplots(1, 2)
    half = 0.5 * _VIEW
    inside = np.ix_(np.abs(field.grid.y) < half, np.abs(field.grid.x) < half)
    image = show(
        left, field.elevation, field.grid, cmap="viridis", vmin=0.0,
        vmax=float(field.elevation[inside].max()),
    )  # fmt: skip
    figure.colorbar(image, ax=left, label="Elevation (m)", shrink=0.8)
    map_axes(left, "testbed")
    left.set_xlim(-half, half)
    left.set_ylim(-half, half)
    for name, x, y in central_rocks(field.terrain.rocks):
        if max(abs(x), abs(y)) < half:
            left.annotate(name, (x, y), (6, 6), textcoords="offset points", color="white")
    opening = np.arctan(0.1)
    for distance, angle in configurations:
        tilt = np.deg2rad(angle)
        x, z = -distance * np.sin(tilt), distance * np.cos(tilt)
        edges = [x + z * np.tan(tilt + side) for side in (-opening, opening)]
        right.fill([x, *edges], [z, 0.0, 0.0], alpha=0.25)
        right.plot(x, z, "k.")
        right.annotate(
            f"{distance:.0f} m, {angle:.0f} deg", (x, z), (5, 2) if angle == 0.0 else (-4, 4),
            textcoords="offset points", fontsize=7, ha="left" if angle == 0.0 else "right",
        )  # fmt: skip
    right.set_xlim(-1250.0, 450.0)
    right.set_ylim(0.0, 1100.0)
    right.set_aspect("equal")
    right.set_xlabel("East (m)")
    right.set_ylabel("Height (m)")
    right.set_title("Field of view of the scans")
    right.grid(alpha=0.3)
    save(figure, path)


def draw_profiles(maps: dict[str, list[Any]], field: Any,
                  configurations: list[tuple[float, float]], path: Path) -> None:  # fmt: skip
    """Plot east-west profiles of truth and DEMs through two rocks (Figure 17).

    `maps` holds the maps "baseline", "mean" and "sigma" of each scan; `field` is the simulated
    testbed; `configurations` are range (m) and angle off nadir (deg).
    """
    figure = new_figure(9.0, 16.0)
    axes = figure.subplots(len(configurations), 2, sharey=True, sharex="col")
    rocks = central_rocks(field.terrain.rocks)
    for n, (distance, angle) in enumerate(configurations):
        base, grid, _ = maps["baseline"][n]
        mean, sigma = maps["mean"][n][0], maps["sigma"][n][0]
        for ax, (name, x, y) in zip(axes[n], rocks, strict=True):
            row = int(grid.cell((x, y))[0])
            near = np.abs(grid.x - x) < 1.5
            true_row = int(field.grid.cell((x, y))[0])
            true_near = np.abs(field.grid.x - x) < 1.5
            east, m, s = grid.x[near], mean[row, near], sigma[row, near]
            ax.fill_between(east, m - 3 * s, m + 3 * s, color="#0072B2", alpha=0.2, lw=0,
                            label="proposed, 3 sigma")  # fmt: skip
            ax.plot(east, m, color="#0072B2", label="proposed, mean")
            ax.step(east, base[row, near], where="mid", color="#D55E00", label="baseline")
            ax.plot(field.grid.x[true_near], field.elevation[true_row, true_near], "k--", lw=1,
                    label="truth")  # fmt: skip
            ax.set_title(f"rock {name}: {distance:.0f} m, {angle:.0f} deg", fontsize=9)
            ax.grid(alpha=0.3)
        axes[n, 0].set_ylabel("Height (m)")
    for ax in axes[-1]:
        ax.set_xlabel("East (m)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    save(figure, path)


def draw_truth(field: Any, layer: np.ndarray, limit: float, label: str, path: Path) -> None:
    """Plot a true terrain quantity and the cells below its limit: Figures 18 and 21.

    `layer` holds slope or roughness on the grid of the testbed `field`, `limit` its safety limit in
    the same unit, and `label` its name with unit. `path` is the output file.
    """
    figure = new_figure(9.0, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    half = 0.5 * _VIEW
    image = show(left, layer, field.grid, cmap="viridis", vmin=0.0, vmax=2.0 * limit)
    bar = figure.colorbar(image, ax=left, label=f"{label}(white: limit)", shrink=0.8, extend="max")
    bar.ax.axhline(limit, color="white")
    map_axes(left, f"true {label.split(' (', maxsplit=1)[0]}")
    safe = np.where(np.isfinite(layer), layer < limit, np.nan)
    show(right, safe, field.grid, cmap=ListedColormap(["#303030", "#ffffff"]), vmin=0, vmax=1)
    map_axes(right, "white: below the limit")
    right.set_ylabel("")
    for ax in (left, right):
        ax.set_xlim(-half, half)
        ax.set_ylim(-half, half)
    save(figure, path)


def draw_precision_recall(
    curves: list[dict[str, PrecisionRecall]], configurations: list[tuple[float, float]],
    paper: list[list[tuple[float, float]]], title: str, min_precision: float, path: Path,
) -> None:  # fmt: skip
    """Plot precision against recall for all thresholds, with the values of the paper.

    `curves` holds the counts by method, one dictionary per scan; `configurations` are range (m) and
    angle off nadir (deg) of the scans; `paper` holds precision and recall of the baseline and the
    proposed method in the paper; `min_precision` is the lower end of the axis.
    """
    figure = new_figure(9.6, 9.6)
    axes = figure.subplots(3, 3, sharex=True, sharey=True)
    colours = ("#D55E00", "#0072B2", "#009E73")
    for ax, own, (distance, angle), points in zip(
        axes.ravel(), curves, configurations, paper, strict=True
    ):
        for (name, curve), colour in zip(own.items(), colours, strict=True):
            p, r = curve.curve()
            half = curve.at_half()
            ax.plot(r, p, color=colour, label=name)
            ax.plot(half.recall, half.precision, "o", color=colour, ms=4)
        names = ("baseline, paper", "proposed, paper")
        for (precision, recall), colour, name in zip(points, colours, names, strict=False):
            ax.plot(recall, precision, "*", color=colour, mec="black", ms=9, label=name)
        ax.set_title(f"{distance:.0f} m, {angle:.0f} deg")
        ax.set_xlim(0.6, 1.003)
        ax.set_ylim(min_precision, 1.0 + 0.02 * (1.0 - min_precision))
        ax.grid(alpha=0.3)
    for ax in axes[2]:
        ax.set_xlabel("Recall of safe cells")
    for ax in axes[:, 0]:
        ax.set_ylabel("Precision")
    axes[0, 0].legend(loc="lower left", fontsize=7)
    figure.suptitle(f"{title}; dots: threshold p > 0.5; stars: paper")
    save(figure, path)
