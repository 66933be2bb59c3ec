"""States of a flight for export: the true ones, or the estimates of navigation."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from lunarsim.errors import InputError
from lunarsim.simulation import Flight
from lunarsim.simulation.columns import vector_columns
from lunarsim.typing import Array


class States(NamedTuple):
    """States of the lander in the site frame, with strictly increasing times.

    Attributes
    ----------
    time
        Time since the start of the flight (n,), s.
    position, velocity
        Centre of mass (n, 3), m and m/s.
    attitude
        Quaternions, body to ENU, scalar last (n, 4).
    covariance
        Covariance of position and velocity (n, 6, 6), m and m/s; None for true states.
    """

    time: Array
    position: Array
    velocity: Array
    attitude: Array
    covariance: Array | None


def states_of(flight: Flight, kind: Literal["true", "estimate"]) -> States:
    """Return the true or the estimated states of a flight.

    Rows with a value that is not finite, and rows whose time does not increase by a microsecond or
    more, are omitted. The covariance does not count: rows without it have a covariance of NaN.

    Raises
    ------
    InputError
        If the flight has no such state.
    """
    table = flight.trajectory if kind == "true" else flight.navigation
    if not table:
        raise InputError(
            "--state", kind, "must be true, because the record has no estimates",
            "Records of schema version 1 have none.",
        )  # fmt: skip
    vectors = [vector_columns(table, name) for name in ("position", "velocity")]
    attitude = vector_columns(table, "attitude", "xyzw")
    covariance = None if kind == "true" else _covariances(table)
    numbers = np.column_stack((table["time"], *vectors, attitude))
    kept = np.flatnonzero(np.isfinite(numbers).all(axis=1))
    time = table["time"][kept]
    latest = np.maximum.accumulate(np.concatenate(([-np.inf], time[:-1])))
    kept = kept[time > latest + 1e-6]
    if not len(kept):
        raise InputError(
            "--state", kind, "must be a state that the flight has, because no value is finite"
        )
    return States(
        table["time"][kept], vectors[0][kept], vectors[1][kept], attitude[kept],
        None if covariance is None else covariance[kept],
    )  # fmt: skip


def _covariances(table: dict[str, Array]) -> Array:
    """Return the covariances of position and velocity (n, 6, 6)."""
    found = np.empty((len(table["time"]), 6, 6))
    for i in range(6):
        for j in range(i, 6):
            found[:, i, j] = found[:, j, i] = table[f"covariance_{i}{j}"]
    return found
