"""Why no path leads from the start to the target: which field of `[approach]` forbids it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Software
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]

# What asks nothing of a path, by field. A tilt of a quarter turn and more is no approach's.
_ASKS_NOTHING: dict[str, Any] = {
    "max_tilt": np.deg2rad(84.0),
    "glideslope": 0.0,
    "reserve": 0.0,
    "throttle_margin": 0.0,
    "arrival_acceleration": (0.0, 0.0, 0.0),
    "arrival_velocity": (0.0, 0.0),
    "arrival_offset": (0.0, 0.0),
    "vertical_altitude": Approach().vertical_altitude,
    "vertical_speed": Approach().vertical_speed,
}
_UNITS = {"arrival_acceleration": "_m_s2", "arrival_velocity": "_m_s", "arrival_offset": "_m"}
_UNITS |= {"max_tilt": "_deg", "glideslope": "_deg", "reserve": "_kg", "vertical_speed": "_m_s"}
_UNITS |= {"vertical_altitude": "_m"}


def unreachable(
    here: Estimate, target: Array, software: Software, lander: Lander, gravity: float
) -> InputError:
    """Return the error of a start from which the target (3,) cannot be reached.

    It names the field of `[approach]` that is not its default and without which there is a path,
    the end of the approach where that lies above the start, and else the start.
    """
    approach, plain = software.approach, Approach()
    above = here.position - target
    ends = float(approach.vertical_altitude + lander.com_height)
    if ends >= above[2] > plain.vertical_altitude + lander.com_height:
        return InputError(
            "approach.vertical_altitude_m", approach.vertical_altitude,
            f"less: the start's centre of mass is {above[2]:g} m above the target",
        )  # fmt: skip
    for name in _to_blame(here, target, software, lander, gravity):
        value = getattr(approach, name)
        told = round(float(np.rad2deg(value)), 9) if _UNITS.get(name) == "_deg" else value
        return InputError(
            f"approach.{name}{_UNITS.get(name, '')}", told,
            "one that leaves a path from the start to the target within thrust and propellant: "
            "without it there is one",
        )  # fmt: skip
    return InputError(
        "start.position_m", tuple(float(v) for v in above),
        "a start from which the target can be reached within thrust, tilt, glideslope and "
        "propellant: no time-to-go is admissible",
    )  # fmt: skip


def _to_blame(
    here: Estimate, target: Array, software: Software, lander: Lander, gravity: float
) -> Iterator[str]:
    """Yield the fields, not at their defaults, without any one of which there is a path."""
    approach, plain = software.approach, Approach()
    for name, nothing in _ASKS_NOTHING.items():
        if getattr(approach, name) == getattr(plain, name):
            continue
        # A jerk asks nothing of a path, but for a speed over ground to count along.
        eased = replace(approach, **({"jerk": None} | {name: nothing}))
        end = eased.end(target[None, :], lander)
        cost = software.guidance.cost(here, end, lander, gravity, eased.limits)
        if cost.feasible[0]:
            yield name
