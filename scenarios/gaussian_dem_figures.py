"""Figures of `gaussian_dem_tables.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap

from lunarsim.hazards.reliability import calibration_error, frequencies
from lunarsim.viz.style import hillshade, map_axes, new_figure, save, show

_VIEW = 10.0  # side of the segment that the paper shows, m


def draw_conservativeness(pictures: list[Any], path: Path) -> None:
    """Terrain and safety by three tests, by complexity: the paper's Figure 12 and one row more."""
    figure = new_figure(2.4 * len(pictures), 12.5)
    axes = figure.subplots(4, len(pictures), sharex=True, sharey=True)
    palette = ListedColormap(["#303030", "#ffffff"])
    for n, (c, z, exact, ours, through, grid) in enumerate(pictures):
        show(axes[0, n], hillshade(z, grid.posting), grid, cmap="gray", vmin=0, vmax=1)
        map_axes(axes[0, n], f"c = {c}: relief")
        layers = ((exact, "exactly safe"), (ours, "conservative"), (through, "support planes"))
        for row, (layer, title) in enumerate(layers, start=1):
            show(axes[row, n], layer, grid, cmap=palette, vmin=0, vmax=1)
            map_axes(axes[row, n], f"{title}: {100 * layer.mean():.1f} %")
    for ax in axes[:, 1:].ravel():
        ax.set_ylabel("")
    for ax in axes[:3].ravel():
        ax.set_xlabel("")
    figure.suptitle("White: safe. Terrain of Eq. 20 on the HiRISE crop, 0.1 m posting")
    save(figure, path)


def draw_panels(
    pictures: list[Any],
    configurations: list[tuple[float, float]],
    label: str,
    path: Path,
    *,
    diverging: bool = False,
) -> None:
    """Nine configurations over the same segment, range by row, angle by column."""
    figure = new_figure(9.0, 8.6)
    axes = figure.subplots(3, 3, sharex=True, sharey=True)
    half = 0.5 * _VIEW
    spans = []
    for layer, grid, _ in pictures:
        inside = np.ix_(np.abs(grid.y) < half, np.abs(grid.x) < half)
        spans.append(layer[inside][np.isfinite(layer[inside])])
    values = np.concatenate(spans)
    low, high = (-1.0, 1.0) if diverging else (float(values.min()), float(values.max()))
    image = None
    for ax, (layer, grid, points), (distance, angle) in zip(
        axes.ravel(), pictures, configurations, strict=True
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
    """Share of truly safe cells against the probability of safety, with its share of the map."""
    figure = new_figure(9.0, 8.6)
    axes = figure.subplots(3, 3, sharex=True, sharey=True)
    for ax, counts, (distance, angle) in zip(axes.ravel(), bins, configurations, strict=True):
        ax.plot([0, 1], [0, 1], color="0.6", lw=1, label="true probability")
        ax.plot(*frequencies(counts[counts[:, 0] > 50]), "o-", color="#0072B2", ms=4, label="map")
        share = counts[:, 0] / counts[:, 0].sum()
        ax.bar((np.arange(20) + 0.5) / 20, share, width=0.045, color="#E69F00", alpha=0.6,
               label="share of cells")  # fmt: skip
        ax.set_title(f"{distance:.0f} m, {angle:.0f} deg: error {calibration_error(counts):.3f}")
        ax.set_aspect("equal")
    for ax in axes[2]:
        ax.set_xlabel("probability of safety")
    for ax in axes[:, 0]:
        ax.set_ylabel("share truly safe")
    axes[0, 0].legend(loc="lower right", fontsize=7)
    save(figure, path)
