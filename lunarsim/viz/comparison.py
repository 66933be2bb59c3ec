"""The figure of a comparison of policies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.evaluation.statistics import summarise
from lunarsim.scenario import Scenario
from lunarsim.viz.style import new_figure, policy_colour, save


def draw_comparison(rows: list[dict[str, Any]], scenario: Scenario, path: Path) -> None:
    """Draw safety, propellant, divert distance and touchdown speed of every policy."""
    summary = summarise(rows)
    names = list(summary)
    colours = [policy_colour(name) for name in names]
    figure = new_figure(11, 4.4)
    axes = figure.subplots(1, 4)
    place = np.arange(len(names))

    share = np.array([summary[n]["safe"].value for n in names])
    low = share - [summary[n]["safe"].interval[0] for n in names]
    high = np.array([summary[n]["safe"].interval[1] for n in names]) - share
    axes[0].barh(place, share, color=colours)
    spread = np.maximum(np.stack((low, high)), 0.0)
    axes[0].errorbar(share, place, xerr=spread, fmt="none", ecolor="black", capsize=3)
    axes[0].set_xlim(0.0, 1.0)
    axes[0].set_xlabel("landed safe (95 % Wilson interval)")

    boxes = (
        ("propellant_kg", "propellant (kg)"),
        ("divert_m", "divert distance (m)"),
        ("horizontal_speed_m_s", "horizontal touchdown speed (m/s)"),
    )
    for ax, (column, label) in zip(axes[1:], boxes, strict=True):
        data = []
        for name in names:
            values = np.array([r[column] for r in rows if r["policy"] == name], dtype=np.float64)
            data.append(values[np.isfinite(values)])
        drawn = ax.boxplot(
            data, positions=place, orientation="horizontal", widths=0.6, patch_artist=True
        )
        for box, colour in zip(drawn["boxes"], colours, strict=True):
            box.set_facecolor(colour)
            box.set_alpha(0.75)
        for line in drawn["medians"]:
            line.set_color("black")
        ax.set_xlabel(label)
    for i, ax in enumerate(axes):
        ax.set_yticks(place, names if i == 0 else [""] * len(names))
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.grid(axis="x", alpha=0.3)
    flights = summary[names[0]]["flights"]
    figure.suptitle(f"{scenario.name}: {flights} flights a policy over the same worlds")
    save(figure, path)
