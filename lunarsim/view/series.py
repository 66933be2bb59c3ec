"""Quantities of a flight that recordings plot over time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim.frames import quat_to_matrix
from lunarsim.models.lander import Lander
from lunarsim.simulation.columns import vector_columns
from lunarsim.simulation.flight import Flight
from lunarsim.typing import Array
from lunarsim.view.colours import COMMAND, ESTIMATE, FUEL, LIMIT, TRUTH
from lunarsim.world import World

Colour = tuple[int, ...]


class Series(NamedTuple):
    """One line of a plot.

    Attributes
    ----------
    path
        Entity of the recording; the part before the last slash is the plot.
    name
        Name in the legend, with the unit.
    colour
        RGB colour.
    time, values
        Times, s, and values (n,).
    """

    path: str
    name: str
    colour: Colour
    time: Array
    values: Array


def altitude_of(world: World, positions: Array, target: Array) -> Array:
    """Return heights (n,) of positions (n, 3) above the target (3,), m."""
    return np.asarray(world.height(positions) - world.height(target))


def tilt_of(attitude: Array) -> Array:
    """Return the angles (n,) between body z and up, deg, from quaternions (n, 4)."""
    cosine = quat_to_matrix(attitude)[..., 2, 2]
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def position_sigmas(navigation: dict[str, Array]) -> Array:
    """Return the standard deviations (n, 3) of the estimated position, m."""
    variance = np.column_stack([navigation[f"covariance_{k}{k}"] for k in range(3)])
    return np.sqrt(np.maximum(variance, 0.0))


def plotted_series(flight: Flight, world: World, lander: Lander) -> list[Series]:
    """Return all series of a record, or of a part of it.

    `world` and `lander` are the true ones.
    """
    t, c = flight.trajectory, flight.commands
    time, velocity = t["time"], vector_columns(t, "velocity")
    tilt = tilt_of(vector_columns(t, "attitude", "xyzw"))
    found = [
        Series("plots/altitude/true", "true (m)", TRUTH, time,
               altitude_of(world, flight.positions, flight.target)),
        Series("plots/speed/down", "descent rate (m/s)", TRUTH, time, -velocity[:, 2]),
        Series("plots/speed/horizontal", "horizontal speed (m/s)", ESTIMATE, time,
               np.hypot(velocity[:, 0], velocity[:, 1])),
        Series("plots/tilt/true", "true tilt (deg)", TRUTH, time, tilt),
        Series("plots/thrust/true", "true thrust (kN)", TRUTH, time, t["thrust"] / 1e3),
        Series("plots/propellant/true", "propellant (kg)", FUEL, time, t["mass"] - lander.dry_mass),
        Series("plots/propellant/estimated", "estimated (kg)", ESTIMATE, time,
               t["estimated_mass"] - lander.dry_mass),
    ]  # fmt: skip
    if c:
        found.append(
            Series("plots/thrust/command", "commanded (kN)", COMMAND, c["time"], c["thrust"] / 1e3)
        )
    return found + _navigation_series(flight, world)


def _navigation_series(flight: Flight, world: World) -> list[Series]:
    """Return the series of the estimate; none for a record without estimates."""
    n = flight.navigation
    if not n:
        return []
    time, position = n["time"], vector_columns(n, "position")
    found = [
        Series("plots/altitude/estimated", "estimated (m)", ESTIMATE, time,
               altitude_of(world, position, flight.target)),
    ]  # fmt: skip
    error, sigma = position - flight.positions, position_sigmas(n)
    for k, axis in enumerate(("east", "north", "up")):
        path = f"plots/navigation_error_{axis}"
        found += [
            Series(f"{path}/error", f"{axis} error (m)", ESTIMATE, time, error[:, k]),
            Series(f"{path}/upper", "+3 sigma (m)", LIMIT, time, 3.0 * sigma[:, k]),
            Series(f"{path}/lower", "-3 sigma (m)", LIMIT, time, -3.0 * sigma[:, k]),
        ]
    return found
