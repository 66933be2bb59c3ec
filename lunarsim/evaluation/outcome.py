"""The figures of one flight, for the results table."""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim.simulation import Simulation
from lunarsim.simulation.flight import Flight

# Safe cells tried for reachability; they are spread over the scanned ground.
_TRIES = 400


def evaluate(simulation: Simulation, flight: Flight) -> dict[str, Any]:
    """Return one row of results: plain numbers, no wall-clock times.

    Map cells count where the map has observed them; a cell is called safe at p_safe > 0.5.
    """
    touchdown = flight.verdict.touchdown
    truth = simulation.truth
    start = flight.trajectory
    site = np.array([start[f"site_{a}"][0] for a in "xyz"])
    error = np.array([start[f"estimated_{a}"][0] - start[f"position_{a}"][0] for a in "xyz"])
    row: dict[str, Any] = {
        "policy": flight.policy,
        "safe": flight.verdict.safe,
        "failed": ",".join(flight.verdict.failed),
        "propellant_kg": flight.propellant_used,
        "duration_s": flight.duration,
        "divert_m": flight.divert_distance,
        "decisions": len(flight.decisions),
        "target_exactly_safe": bool(truth.safe_at((site - error)[:2])),
    }
    nan = float("nan")
    row |= {
        "touchdown_x_m": float(touchdown.position[0]) if touchdown else nan,
        "touchdown_y_m": float(touchdown.position[1]) if touchdown else nan,
        "touchdown_exactly_safe": bool(
            touchdown is not None and truth.safe_at(touchdown.position[:2])
        ),
        "vertical_speed_m_s": touchdown.vertical_speed if touchdown else nan,
        "horizontal_speed_m_s": touchdown.horizontal_speed if touchdown else nan,
        "tilt_deg": float(np.rad2deg(touchdown.tilt)) if touchdown else nan,
        "slope_deg": float(np.rad2deg(touchdown.slope)) if touchdown else nan,
        "roughness_m": touchdown.roughness if touchdown else nan,
        "tip_margin": touchdown.tip_margin if touchdown else nan,
    }
    return row | _map_figures(simulation, flight)


def _map_figures(simulation: Simulation, flight: Flight) -> dict[str, Any]:
    """Compare the last map with the truth, cell by cell."""
    empty = {"map_hits": 0, "map_false_safe": 0, "map_missed": 0, "safe_site_in_reach": False}
    if flight.hazard_map is None or simulation.first_map_estimate is None:
        return empty
    hazard_map = flight.hazard_map
    xy = hazard_map.grid.centres()
    safe = simulation.truth.safe_at(xy - flight.map_error[:2])[hazard_map.observed]
    called = hazard_map.p_safe[hazard_map.observed] > 0.5
    spots = xy[hazard_map.observed][safe]
    spots = spots[:: max(1, len(spots) // _TRIES)]
    in_reach = False
    if len(spots):
        sites = np.column_stack((spots, np.full(len(spots), simulation.site[2])))
        in_reach = bool(simulation.cost_of(sites, simulation.first_map_estimate).feasible.any())
    return {
        "map_hits": int((safe & called).sum()),
        "map_false_safe": int((~safe & called).sum()),
        "map_missed": int((safe & ~called).sum()),
        "safe_site_in_reach": in_reach,
    }
