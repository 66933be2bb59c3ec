"""Draw outlines of the reachable area on a map."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from lunarsim.evaluation.reach import decision_rows, reach_at_row
from lunarsim.grid import Grid
from lunarsim.simulation.flight import Flight

_GRID_CELLS = 100  # number of cells along the longer side
# White under the black line, visible on dark and bright terrain.
_LINES = (("first", "-"), ("last", ":"))


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
    grid = Grid.centred(middle, width, max(width, height) / _GRID_CELLS, height)
    handles = []
    for row, (when, style) in zip(rows, _LINES, strict=True):
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
