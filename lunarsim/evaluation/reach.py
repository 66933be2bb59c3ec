"""Compute from a flight record where the lander could have landed."""

from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid
from lunarsim.onboard.guidance.divert_cost import DivertCost
from lunarsim.onboard.guidance.rotation import RotationLimits
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.reachability import ReachabilityMap, elevation_on_grid
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight
from lunarsim.typing import Array

_APPROACH_PHASE = 0.0


def divert_cost_from(flight: Flight, estimate: Estimate, sites: Array) -> DivertCost:
    """Return the onboard divert cost from a state of a flight to sites (n, 3).

    `estimate` is the navigation estimate of the state; sites are in the local frame, m.
    """
    scenario = Scenario.from_toml(flight.scenario)
    approach, lander = scenario.approach.make(), scenario.vehicle.make()
    law, end, gravity = scenario.guidance.make(), approach.end(sites, lander), scenario.gravity_m_s2
    cost: DivertCost = law.cost(estimate, end, lander, gravity, approach.limits)
    rotation = RotationLimits.of(lander, scenario.control.make())
    return rotation.limit(cost, law, estimate, end, gravity, approach.limits)


def estimate_at_row(flight: Flight, row: int) -> Estimate:
    """Return the navigation estimate in a row of a flight's trajectory table.

    Estimates of attitude, angular rate and covariance are not recorded: the true attitude and rate
    are used, and the covariance is NaN.
    """
    t = flight.trajectory
    position, velocity = (
        np.array([t[f"estimated_{name}{a}"][row] for a in "xyz"]) for name in ("", "velocity_")
    )
    attitude = np.array([t[f"attitude_{a}"][row] for a in "xyzw"])
    rate = np.array([t[f"rate_{a}"][row] for a in "xyz"])
    return Estimate(
        float(t["time"][row]), position, velocity, attitude, rate,
        float(t["estimated_mass"][row]), np.full((9, 9), np.nan),
    )  # fmt: skip


def decision_rows(flight: Flight) -> tuple[int, int] | None:
    """Return the first and last trajectory row in which a policy could decide.

    The result is None if there is no such row. Decisions need a map, the approach phase, and a
    height within the scenario's limits.
    """
    if flight.first_map is None:
        return None
    t, scenario = flight.trajectory, Scenario.from_toml(flight.scenario)
    window, lander = scenario.decisions.make(), scenario.vehicle.make()
    height = t["estimated_z"] - t["site_z"] - lander.com_height
    asked = np.flatnonzero(
        (t["phase"] == _APPROACH_PHASE) & (t["time"] >= flight.first_map.time)
        & (height <= window.first_altitude) & (height >= window.last_altitude)
    )  # fmt: skip
    return (int(asked[0]), int(asked[-1])) if len(asked) else None


def reach_at_row(flight: Flight, row: int, grid: Grid) -> ReachabilityMap:
    """Return where the lander could land from its state in a trajectory row.

    The result is on `grid`, in the local (onboard) frame. Terrain heights are from the last hazard
    map; elsewhere, the height of the landing site is used. Sites that are not visible through the
    lander's window count as within reach.
    """
    estimate, site = estimate_at_row(flight, row), flight.sites[row]
    height = elevation_on_grid(grid, flight.hazard_map, float(site[2]))
    return ReachabilityMap(grid, height, lambda sites: divert_cost_from(flight, estimate, sites))
