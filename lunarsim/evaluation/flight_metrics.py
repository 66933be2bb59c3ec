"""Compute the result row of one flight from its record and the truth."""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim.evaluation.map_quality import MapQuality, evaluated_step, map_quality
from lunarsim.evaluation.reach import divert_cost_from
from lunarsim.models.lander import Lander
from lunarsim.simulation.flight import Flight
from lunarsim.typing import Array
from lunarsim.vehicle.touchdown import ABORTED, min_touchdown_margin
from lunarsim.world.truth import TerrainTruth

# Columns that `evaluate` returns, and their kinds.
COLUMNS: dict[str, str] = {
    "policy": "text",
    "safe": "bool",
    "failure_causes": "text",
    "aborted": "bool",
    "navigation_lost": "bool",
    "propellant_kg": "float",
    "duration_s": "float",
    "divert_m": "float",
    "decisions": "int",
    "target_exactly_safe": "bool",
    "touchdown_x_m": "float",
    "touchdown_y_m": "float",
    "touchdown_exactly_safe": "bool",
    "vertical_speed_m_s": "float",
    "horizontal_speed_m_s": "float",
    "tilt_deg": "float",
    "slope_deg": "float",
    "roughness_m": "float",
    "tip_margin": "float",
    "touchdown_margin": "float",
    "max_tilt_deg": "float",
    "max_rate_deg_s": "float",
    "lower_throttle_margin": "float",
    "upper_throttle_margin": "float",
    "horizontal_speed_at_10m_m_s": "float",
    "miss_m": "float",
    "navigation_error_m": "float",
    "navigation_velocity_error_m_s": "float",
    "p_safe": "float",
    "map_true_safe": "int",
    "map_false_safe": "int",
    "map_false_unsafe": "int",
    "safe_site_in_reach": "bool",
}
# Maximum number of safe cells tested for reachability; they are spread over the mapped terrain.
_MAX_TESTED_SITES = 400
# Height of the footpads at which the horizontal speed is reported, m.
_FINAL_HEIGHT_M = 10.0


def evaluate(flight: Flight, truth: TerrainTruth) -> dict[str, Any]:
    """Return the result row of one flight: values by column, no wall-clock times.

    The columns and their types are in `COLUMNS`.

    Map counts include observed cells only, 0.4 m apart; a cell is classified safe if p_safe > 0.5.

    Parameters
    ----------
    flight
        Record of the flight.
    truth
        Exact landing safety of the flight's terrain.
    """
    touchdown = flight.outcome.touchdown
    nan = float("nan")
    row: dict[str, Any] = {
        "policy": flight.policy,
        "safe": flight.outcome.safe,
        "failure_causes": ",".join(flight.outcome.failure_causes),
        "aborted": flight.outcome.failure_causes == (ABORTED,),
        "navigation_lost": flight.lost,
        "propellant_kg": flight.propellant_used,
        "duration_s": flight.duration,
        "divert_m": flight.divert_distance,
        "decisions": len(flight.decisions),
        "target_exactly_safe": bool(truth.is_safe_at(initial_aim_point(flight))),
        "touchdown_x_m": float(touchdown.position[0]) if touchdown else nan,
        "touchdown_y_m": float(touchdown.position[1]) if touchdown else nan,
        "touchdown_exactly_safe": bool(
            touchdown is not None and truth.is_safe_at(touchdown.position[:2])
        ),
        "vertical_speed_m_s": touchdown.vertical_speed if touchdown else nan,
        "horizontal_speed_m_s": touchdown.horizontal_speed if touchdown else nan,
        "tilt_deg": float(np.rad2deg(touchdown.tilt)) if touchdown else nan,
        "slope_deg": float(np.rad2deg(touchdown.slope)) if touchdown else nan,
        "roughness_m": touchdown.roughness if touchdown else nan,
        "tip_margin": touchdown.tip_margin if touchdown else nan,
        "touchdown_margin": min_touchdown_margin(truth.lander, touchdown) if touchdown else nan,
    }
    row |= trajectory_metrics(flight, truth.lander)
    row["p_safe"] = predicted_p_safe(flight)
    quality = MapQuality.none()
    if flight.hazard_map is not None:
        quality = map_quality(flight.hazard_map, truth, flight.map_error)
    return row | {
        "map_true_safe": quality.true_safe,
        "map_false_safe": quality.false_safe,
        "map_false_unsafe": quality.false_unsafe,
        "safe_site_in_reach": safe_site_in_reach(flight, truth),
    }


def trajectory_metrics(flight: Flight, lander: Lander) -> dict[str, float]:
    """Return extremes of a flight, and errors of navigation and guidance.

    Throttle margins are distances of the thrust from both ends of the range of `lander`, as
    fractions of this range. The miss is the distance of the touchdown from the last site, whose
    true position is that on the map minus the error of the map. Heights are those of the footpads
    above the place of touchdown. Values that need a touchdown are NaN without one.
    """
    t, touchdown = flight.trajectory, flight.outcome.touchdown
    position, velocity, rate, estimated, estimated_velocity = (
        np.column_stack([t[f"{name}_{axis}"] for axis in "xyz"])
        for name in ("position", "velocity", "rate", "estimated", "estimated_velocity")
    )
    up = 1.0 - 2.0 * (t["attitude_x"] ** 2 + t["attitude_y"] ** 2)
    throttle = (t["thrust"] - lander.thrust_min) / (lander.thrust_max - lander.thrust_min)
    speed = miss = float("nan")
    if touchdown is not None:
        height = position[:, 2] - lander.com_height - touchdown.position[2]
        below = np.flatnonzero(height <= _FINAL_HEIGHT_M)
        speed = float(np.hypot(*velocity[below[0], :2])) if len(below) else speed
        site = flight.sites[-1, :2] - flight.map_error[:2]
        miss = float(np.hypot(*(touchdown.position[:2] - site)))
    return {
        "max_tilt_deg": float(np.rad2deg(np.arccos(np.clip(up, -1.0, 1.0)).max())),
        "max_rate_deg_s": float(np.rad2deg(np.linalg.norm(rate, axis=1).max())),
        "lower_throttle_margin": float(throttle.min()),
        "upper_throttle_margin": float(1.0 - throttle.max()),
        "horizontal_speed_at_10m_m_s": speed,
        "miss_m": miss,
        "navigation_error_m": float(np.hypot(*(estimated - position)[-1, :2])),
        "navigation_velocity_error_m_s": float(np.linalg.norm((estimated_velocity - velocity)[-1])),
    }


def predicted_p_safe(flight: Flight) -> float:
    """Return p_safe of the last chosen site in the decision map.

    The decision map is the hazard map from which the policy chose the site. The result is NaN
    without a map, and if the site lies outside the map or on unobserved terrain.
    """
    m = flight.hazard_map
    if m is None or not m.grid.contains(flight.sites[-1, :2]):
        return float("nan")
    row, col = (int(i) for i in m.grid.cell(flight.sites[-1, :2]))
    return float(m.p_safe[row, col]) if m.observed[row, col] else float("nan")


def initial_aim_point(flight: Flight) -> Array:
    """Return the true position that the lander aimed at before any divert (2,), m.

    The position is east and north: the onboard target minus the navigation error at the first
    decision, or at the end of a flight without decisions.
    """
    t = flight.trajectory
    row = -1
    if flight.decisions:
        row = int(np.argmin(np.abs(t["time"] - flight.decisions[0]["time"])))
    error = [t[f"estimated_{a}"][row] - t[f"position_{a}"][row] for a in "xy"]
    return np.asarray(flight.sites[row, :2] - error)


def safe_site_in_reach(flight: Flight, truth: TerrainTruth) -> bool:
    """Return whether a safe site was in reach when terrain was first mapped.

    Safe means truly safe by `truth`; sites are cells that the hazard map observed. If many of them
    are safe, only some hundred are tested. Without a map the result is False.
    """
    m, first = flight.hazard_map, flight.first_map
    if m is None or first is None:
        return False
    step = evaluated_step(m.grid)
    xy = m.grid.centres()[::step, ::step][m.observed[::step, ::step]]
    spots = xy[truth.is_safe_at(xy - flight.map_error[:2])]
    spots = spots[:: max(1, len(spots) // _MAX_TESTED_SITES)]
    if len(spots) == 0:
        return False
    sites = np.column_stack((spots, np.full(len(spots), flight.sites[-1, 2])))
    return bool(divert_cost_from(flight, first, sites).feasible.any())
