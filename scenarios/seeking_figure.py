"""Plot the known and reachable safe sites against altitude for each path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from seeking_flights import ALTITUDES, PATHS

from lunarsim.viz.style import new_figure, save

LABELS = {"nominal": "direct", "modified": "manually modified", "seeking": "information-seeking"}
COLOURS = {"nominal": "tab:gray", "modified": "tab:orange", "seeking": "tab:blue"}


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Plot the known and the reachable fraction of safe sites against altitude.

    `rows` holds the flights by path, one dictionary per field; `path` is the output file.
    """
    figure = new_figure(10.0, 4.2)
    left, right = figure.subplots(1, 2)
    for name in PATHS:
        flights = [row[name] for row in rows]
        colour, label = COLOURS[name], LABELS[name]
        known = _mean_fractions(flights, "known_m2")
        left.plot(known, ALTITUDES, "--", color=colour, lw=1.2)
        within = _mean_fractions(flights, "known_in_reach_m2")
        left.plot(within, ALTITUDES, "o-", color=colour, label=label)
        away = [
            np.mean([np.hypot(*f["levels"][f"{h:g}"]["place"][:2]) for f in flights])
            for h in ALTITUDES
        ]
        right.plot(away, ALTITUDES, "o-", color=colour, label=label)
    left.set_xlabel("Fraction of safe sites known as safe\n(solid: reachable; dashed: all)")
    left.set_xlim(-0.02, 1.0)
    right.set_xlabel("Horizontal distance to the initial site (m)")
    for axes in (left, right):
        axes.set_ylabel("Altitude of the pads (m)")
        axes.grid(alpha=0.3)
    left.legend(loc="upper right", frameon=False)
    left.set_title(f"Known and reachable safe sites, mean of {len(rows)} fields", fontsize=10)
    right.set_title("Paths", fontsize=10)
    save(figure, path)


def _mean_fractions(flights: list[dict[str, Any]], name: str) -> list[float]:
    """Return the mean over flights of area / safe area at each altitude.

    `name` is the key of the area, e.g. "known_m2".
    """
    return [
        float(np.mean([f["levels"][f"{h:g}"][name] / max(f["levels"][f"{h:g}"]["safe_m2"], 1.0)
                       for f in flights]))
        for h in ALTITUDES
    ]  # fmt: skip
