"""Descents that the tests of optimal paths share."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from lunarsim.optimal.problem import Descent

DATA = Path(__file__).parent / "data" / "powered_descent_reference_cases.csv"
CANT = np.cos(np.deg2rad(27.0))
MOON = 1.622


def published() -> dict[tuple[str, str], str]:
    """Return the value of each (case, quantity) of the table."""
    with DATA.open(newline="", encoding="utf-8") as file:
        return {(row["case"], row["quantity"]): row["value"] for row in csv.DictReader(file)}


def east_north_up(vector: str) -> np.ndarray:
    """Return a vector of the table, whose x is up, with its z as east."""
    up, north, east = (float(x) for x in vector.strip("[]").split())
    return np.array([east, north, up])


def mars(position=(2000.0, 0.0, 1500.0), velocity=(100.0, 0.0, -75.0), **changes) -> Descent:
    """Return the Mars lander of Acikmese and Ploen."""
    given = {
        "position": np.array(position), "velocity": np.array(velocity), "mass": 1905.0,
        "end_position": np.zeros(3), "end_velocity": np.zeros(3), "gravity": 3.7114,
        "thrust_min": 0.3 * 6.0 * 3100.0 * CANT, "thrust_max": 0.8 * 6.0 * 3100.0 * CANT,
        "exhaust_velocity": 225.0 * 9.80665 * CANT, "dry_mass": 1505.0,
    }  # fmt: skip
    return Descent(**{**given, **changes})


def moon(rng: np.random.Generator | None = None, **changes) -> Descent:
    """Return the approach of the default lander; a generator draws where it starts."""
    position, velocity = np.array([-600.0, 0.0, 500.0]), np.array([28.0, 0.0, -18.0])
    if rng is not None:
        height = rng.uniform(150.0, 600.0)
        position = np.array([*rng.uniform(-1.0, 1.0, 2) * height, height])
        velocity = np.array(
            [*(-0.05 * position[:2] + rng.normal(0.0, 4.0, 2)), rng.uniform(-25.0, -5.0)]
        )
    given = {
        "position": position, "velocity": velocity, "mass": 1500.0,
        "end_position": np.array([0.0, 0.0, 11.6]), "end_velocity": np.array([0.0, 0.0, -2.0]),
        "gravity": MOON, "thrust_min": 1032.0, "thrust_max": 5568.0,
        "exhaust_velocity": 311.0 * 9.80665, "dry_mass": 1115.0, "max_tilt": np.deg2rad(40.0),
        "glideslope": np.deg2rad(8.0), "apex_depth": 0.5,
    }  # fmt: skip
    return Descent(**{**given, **changes})
