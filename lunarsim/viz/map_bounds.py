"""Choose the part of a world that the figure of the maps shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.evaluation.flight_metrics import initial_aim_point
from lunarsim.simulation.flight import Flight
from lunarsim.world import World

# West, east, south and north edges, m.
Bounds = tuple[float, float, float, float]

# If the mapped part is at least this share of the longer side, the complete world is shown.
_MIN_COMPLETE_SHARE = 0.5
# Margin around the mapped part, as a share of its width; and around single points, m.
_MARGIN, _POINT_MARGIN_M = 0.25, 10.0
# Half side of the figure around single points of a flight without a map, m.
_HALF_SIDE_M = 50.0


def divert_segments(flight: Flight) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Return start and end points (2,) of each divert of a flight, true frame, m.

    Decisions are recorded in the onboard frame; the navigation error at their time is subtracted.
    """
    t = flight.trajectory
    found = []
    for decision in flight.decisions:
        row = int(np.argmin(np.abs(t["time"] - decision["time"])))
        error = np.array([t[f"estimated_{a}"][row] - t[f"position_{a}"][row] for a in "xy"])
        ends = (np.asarray(decision[key], np.float64)[:2] - error for key in ("from", "to"))
        found.append((next(ends), next(ends)))
    return found


def map_figure_bounds(flight: Flight, world: World) -> Bounds:
    """Return the map figure's bounds: west, east, south, north, m, true frame.

    They contain the hazard map, the sites, the diverts and the touchdown.

    A world that is not much larger than the map is shown completely. In a larger world only the end
    of the path lies within the bounds.
    """
    west, east, south, north = world.terrain.bounds
    points = [initial_aim_point(flight), flight.positions[-1, :2]]
    points += [end for divert in divert_segments(flight) for end in divert]
    points += list(flight.candidates[:, :2] - flight.map_error[:2])
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    if flight.hazard_map is None:
        x0, y0 = low - _HALF_SIDE_M
        x1, y1 = high + _HALF_SIDE_M
    else:
        x0, x1, y0, y1 = flight.hazard_map.grid.moved(-flight.map_error).extent
    if max(x1 - x0, y1 - y0) >= _MIN_COMPLETE_SHARE * max(east - west, north - south):
        return west, east, south, north
    margin = _MARGIN * (x1 - x0)
    low = np.minimum(low - _POINT_MARGIN_M, [x0 - margin, y0 - margin])
    high = np.maximum(high + _POINT_MARGIN_M, [x1 + margin, y1 + margin])
    return (
        max(west, float(low[0])), min(east, float(high[0])),
        max(south, float(low[1])), min(north, float(high[1])),
    )  # fmt: skip
