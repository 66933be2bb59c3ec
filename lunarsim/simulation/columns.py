"""Columns of a recorded trajectory: name, unit and value of each, once."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.onboard.computer import OnboardComputer
from lunarsim.typing import Array
from lunarsim.vehicle.state import State


class Cycle(NamedTuple):
    """What one control cycle provides for a row of the trajectory.

    `time` is that since the start of the flight, s; `state` the true state; `time_to_go` the time
    until the end of the guidance phase, s, 0 after the flight.
    """

    time: float
    state: State
    computer: OnboardComputer
    time_to_go: float


class ColumnGroup(NamedTuple):
    """Columns whose values come from one expression.

    `names` and `unit` describe the columns; `value` returns their values in a cycle, one per name.
    """

    names: tuple[str, ...]
    unit: str
    value: Callable[[Cycle], ArrayLike]


def _axes(name: str, axes: str = "xyz") -> tuple[str, ...]:
    """Return the names of the components of a vector or quaternion."""
    return tuple(f"{name}_{axis}" for axis in axes)


# In the order of the file. Positions and velocities are in m and m/s, ENU.
GROUPS = (
    ColumnGroup(("time",), "s", lambda c: c.time),
    ColumnGroup(_axes("position"), "m", lambda c: c.state.position),
    ColumnGroup(_axes("velocity"), "m/s", lambda c: c.state.velocity),
    ColumnGroup(_axes("attitude", "xyzw"), "1", lambda c: c.state.attitude),
    ColumnGroup(_axes("rate"), "rad/s", lambda c: c.state.rate),
    ColumnGroup(("mass",), "kg", lambda c: c.state.mass),
    ColumnGroup(("thrust",), "N", lambda c: c.state.thrust),
    ColumnGroup(_axes("estimated"), "m", lambda c: c.computer.estimate.position),
    ColumnGroup(_axes("estimated_velocity"), "m/s", lambda c: c.computer.estimate.velocity),
    ColumnGroup(("estimated_mass",), "kg", lambda c: c.computer.estimate.mass),
    ColumnGroup(_axes("site"), "m", lambda c: c.computer.site),
    ColumnGroup(("time_to_go",), "s", lambda c: c.time_to_go),
    ColumnGroup(
        ("phase",),
        "0 approach, 1 vertical descent, 2 abort, 3 braking, 4 hover",
        lambda c: c.computer.phase,
    ),
    ColumnGroup(
        ("lost",),
        "1 while navigation reports that it is lost",
        lambda c: c.computer.estimate.lost,
    ),
)
# Unit of each column by name, in order.
COLUMNS: dict[str, str] = {name: group.unit for group in GROUPS for name in group.names}


def row_of(cycle: Cycle) -> Array:
    """Return the values (columns,) of one control cycle, in the order of `COLUMNS`."""
    return np.concatenate([np.atleast_1d(group.value(cycle)) for group in GROUPS]).astype(float)
