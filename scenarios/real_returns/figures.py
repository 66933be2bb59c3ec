"""Plot the figure of the airborne LiDAR study (`airborne.py`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from held_out_comparison import height_metrics
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from returns import STRATA
from scipy.stats import norm

from lunarsim import Grid
from lunarsim.evaluation.reliability import calibration_error
from lunarsim.studies import Report, unpack_array
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, map_axes, new_figure, save, show

MAPPED_CELLS = "planes, field of Table 6"  # method whose sites are plotted on a map
LEVELS = np.linspace(0.0, 6.0, 121)  # multiples of the predicted sigma
_SHOWN = (MAPPED_CELLS, "planes, fitted", "Eqs. 15-17, field of Table 6", "quadtree")


def draw(report: Report, path: Path) -> None:
    """Plot the errors on a map and by predicted sigma, and the reliability of p_safe.

    The rows of the report are those of `airborne.py`. A split divides the returns at random into
    mapped and held-out ones; the map shows the first split.
    """
    heights = [row for row in report.rows if row.get("returns") == "terrain returns"]
    safety = replace(report, rows=[row for row in report.rows if row["test"] == "safety"])
    figure = new_figure(13.5, 8.2)
    axes = figure.subplots(2, 3)
    first = next(row for row in heights if "xy" in row)
    dots = axes[0, 0].scatter(
        *unpack_array(first["xy"]).T, c=unpack_array(first["ratio"]), s=0.6, vmin=0.0, vmax=4.0,
        cmap="viridis", lw=0,
    )  # fmt: skip
    figure.colorbar(
        dots, ax=axes[0, 0], label="|error| / predicted sigma", shrink=0.8, extend="max"
    )
    map_axes(axes[0, 0], "held-out returns, Gaussian DEM as in flight")
    _errors(axes[0, 1], replace(report, rows=heights))
    _squares(axes[0, 2], replace(report, rows=heights))
    for ax, ((share,), rows) in zip(axes[1, :2], safety.groups("mapped").items(), strict=True):
        plot_ideal(ax)
        for name, colour in zip(_SHOWN, COLOURS, strict=False):
            every = [row for row in rows if row["map"] == name and row["slope"] == "all"]
            table = np.sum([row["table"] for row in every], axis=0)
            label = f"{name}, ECE {calibration_error(table):.2f}"
            plot_reliability(ax, table, color=colour, label=label)
        ax.set_xlabel("p_safe")
        ax.set_ylabel("Safe fraction on the held-out returns")
        ax.set_title(f"fraction {share:.2f} mapped, lander scale {rows[0]['scale']:.2f}")
        ax.set_ylim(-0.4, 1.05)  # space for the legend
        ax.set_yticks(np.linspace(0.0, 1.0, 6))
        ax.legend(loc="lower right", fontsize=7)
        ax.grid(alpha=0.3)
    row = next(row for row in safety.rows if "classes" in row)
    classes, grid = unpack_array(row["classes"]), Grid(*row["grid"])
    palette = ListedColormap(["#8c8c8c", "#e31a1c", "#fdbf6f", "#a6cee3"])
    image = show(axes[1, 2], classes, grid, cmap=palette, vmin=-0.5, vmax=3.5)
    bar = figure.colorbar(image, ax=axes[1, 2], shrink=0.8, ticks=range(4))
    bar.ax.set_yticklabels(["unsafe", "unsafe, called safe", "safe, called unsafe", "safe"])
    map_axes(axes[1, 2], f"p > 0.5, {MAPPED_CELLS},\nfraction {row['mapped']:.2f} mapped")
    save(figure, path)


def _errors(ax: Axes, heights: Report) -> None:
    """Plot the fraction of height errors beyond a multiple of the predicted sigma."""
    ax.plot(LEVELS, 2.0 * norm.sf(LEVELS), "k--", lw=1, label="normal")
    groups = {key: rows for key, rows in heights.groups("map", "slope").items() if key[1] == "all"}
    for ((name, _), rows), colour in zip(groups.items(), COLOURS, strict=False):
        beyond = np.average([r["beyond"] for r in rows], axis=0, weights=[r["n"] for r in rows])
        ax.plot(LEVELS, beyond, color=colour, label=name)
    ax.set_yscale("log")
    ax.set_ylim(1e-3, 1.0)
    ax.set_xlabel("Multiple of the predicted sigma")
    ax.set_ylabel("Fraction of errors beyond")
    ax.set_title("distribution of the errors, all slopes")
    ax.legend(fontsize=7)
    ax.grid(alpha=0.3)


def _squares(ax: Axes, heights: Report) -> None:
    """Plot the mean squared ratio of height error to predicted sigma by slope class."""
    place = np.arange(len(STRATA))
    groups = heights.groups("map", "slope")
    names = list(dict.fromkeys(name for name, _ in groups))
    for n, (name, colour) in enumerate(zip(names, COLOURS, strict=False)):
        values = [height_metrics(groups[name, slope])["nees"] for slope in STRATA]
        ax.bar(place + 0.13 * (n - 2.5), values, 0.13, color=colour, label=name)
    ax.axhline(1.0, color="black", lw=1)
    ax.set_yscale("log")
    ax.set_xticks(place, STRATA, fontsize=7)
    ax.set_xlabel("Slope")
    ax.set_ylabel("Mean square of error / predicted sigma")
    ax.set_title("calibration of the predicted variance")
    ax.legend(fontsize=7)
