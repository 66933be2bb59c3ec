"""Plot the figure of the airborne LiDAR study (`airborne.py`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from held_out_comparison import HeightErrors, SafetyComparison
from matplotlib.colors import ListedColormap
from returns import STRATA
from scipy.stats import norm

from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, map_axes, new_figure, save, show

_SHOWN = ("planes, field of Table 6", "planes, fitted", "Eqs. 15-17, field of Table 6", "quadtree")


def draw(
    first: dict[str, HeightErrors],
    heights: dict[str, HeightErrors],
    safety: dict[float, SafetyComparison],
    path: Path,
) -> None:
    """Plot the errors on a map and by predicted sigma, and the reliability of p_safe.

    A split divides the returns at random into mapped and held-out ones. `first` and `heights` are
    the height errors of the first split and of all splits, by map; `safety` is the safety
    comparison by mapped fraction of the returns.
    """
    figure = new_figure(13.5, 8.2)
    axes = figure.subplots(2, 3)
    one = first["as flights do"]
    dots = axes[0, 0].scatter(
        one.xy[:, 0], one.xy[:, 1], c=np.abs(one.error) / one.sigma, s=0.6, vmin=0.0, vmax=4.0,
        cmap="viridis", lw=0,
    )  # fmt: skip
    figure.colorbar(
        dots, ax=axes[0, 0], label="|error| / predicted sigma", shrink=0.8, extend="max"
    )
    map_axes(axes[0, 0], "held-out returns, Gaussian DEM as in flight")
    _errors(axes[0, 1], heights)
    _squares(axes[0, 2], heights)
    for ax, (share, verdicts) in zip(axes[1, :2], safety.items(), strict=True):
        plot_ideal(ax)
        for name, colour in zip(_SHOWN, COLOURS, strict=False):
            known = np.isfinite(verdicts.p[name])
            table = reliability(verdicts.p[name][known], verdicts.safe[known])
            label = f"{name}, ECE {calibration_error(table):.2f}"
            plot_reliability(ax, table, color=colour, label=label)
        ax.set_xlabel("p_safe")
        ax.set_ylabel("Safe fraction on the held-out returns")
        ax.set_title(f"fraction {share:.2f} mapped, lander scale {verdicts.scale:.2f}")
        ax.set_ylim(-0.4, 1.05)  # space for the legend
        ax.set_yticks(np.linspace(0.0, 1.0, 6))
        ax.legend(loc="lower right", fontsize=7)
        ax.grid(alpha=0.3)
    share, verdicts = next(iter(safety.items()))
    truth, rasters, _, grid = verdicts.maps
    called = rasters[_SHOWN[0]] > 0.5
    classes = np.where(np.isnan(truth), np.nan, 2.0 * (truth == 1.0) + called)
    palette = ListedColormap(["#8c8c8c", "#e31a1c", "#fdbf6f", "#a6cee3"])
    image = show(axes[1, 2], classes, grid, cmap=palette, vmin=-0.5, vmax=3.5)
    bar = figure.colorbar(image, ax=axes[1, 2], shrink=0.8, ticks=range(4))
    bar.ax.set_yticklabels(["unsafe", "unsafe, called safe", "safe, called unsafe", "safe"])
    map_axes(axes[1, 2], f"p > 0.5, {_SHOWN[0]},\nfraction {share:.2f} mapped")
    save(figure, path)


def _errors(ax, heights: dict[str, HeightErrors]) -> None:
    """Plot the fraction of height errors beyond a multiple of the predicted sigma."""
    level = np.linspace(0.0, 6.0, 121)
    ax.plot(level, 2.0 * norm.sf(level), "k--", lw=1, label="normal")
    for (name, own), colour in zip(heights.items(), COLOURS, strict=False):
        ratio = np.sort(np.abs(own.error) / own.sigma)
        beyond = 1.0 - np.searchsorted(ratio, level) / ratio.size
        ax.plot(level, beyond, color=colour, label=name)
    ax.set_yscale("log")
    ax.set_ylim(1e-3, 1.0)
    ax.set_xlabel("Multiple of the predicted sigma")
    ax.set_ylabel("Fraction of errors beyond")
    ax.set_title("distribution of the errors, all slopes")
    ax.legend(fontsize=7)
    ax.grid(alpha=0.3)


def _squares(ax, heights: dict[str, HeightErrors]) -> None:
    """Plot the mean squared ratio of height error to predicted sigma by slope class."""
    place = np.arange(len(STRATA))
    for n, ((name, own), colour) in enumerate(zip(heights.items(), COLOURS, strict=False)):
        values = [own.statistics(k)["nees"] for k in place]
        ax.bar(place + 0.13 * (n - 2.5), values, 0.13, color=colour, label=name)
    ax.axhline(1.0, color="black", lw=1)
    ax.set_yscale("log")
    ax.set_xticks(place, STRATA, fontsize=7)
    ax.set_xlabel("Slope")
    ax.set_ylabel("Mean square of error / predicted sigma")
    ax.set_title("calibration of the predicted variance")
    ax.legend(fontsize=7)
