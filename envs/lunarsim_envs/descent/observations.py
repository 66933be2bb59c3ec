"""What an agent is shown of a descent: named parts, one after another.

A part of one's own is added by `register`, and named in an environment's `observation`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim_envs.descent.lanes import Lanes
from lunarsim_envs.named_parts import check_new, check_shape, named_parts

Array = NDArray[np.float64]

# No distance (m), speed (m/s) or mass (kg) of a descent is larger: what would be is clipped.
FAR = 5000.0


@dataclass(frozen=True)
class Part:
    """One part of an observation.

    Attributes
    ----------
    name, unit, meaning
        As documents tell them.
    size, low, high
        Numbers in it, and the bounds of each.
    of
        Returns it for all lanes (n, size).
    """

    name: str
    size: int
    unit: str
    low: float
    high: float
    meaning: str
    of: Callable[[Lanes], Array]


PARTS: dict[str, Part] = {}
# What is seen unless something else is asked for.
DEFAULT = ("position", "velocity", "attitude", "rate", "thrust", "propellant")


def register(part: Part) -> None:
    """Add a part.

    Raises
    ------
    InputError
        If there is one of its name, or it has no room.
    """
    check_new(part.name, PARTS)
    if part.size < 1 or not part.low < part.high:
        raise InputError(
            part.name, (part.size, part.low, part.high), "a size of 1 or more, a range"
        )
    PARTS[part.name] = part


def _position(lanes: Lanes) -> Array:
    return lanes.y[:, :3] - lanes.target


def _velocity(lanes: Lanes) -> Array:
    return lanes.y[:, 3:6]


def _attitude(lanes: Lanes) -> Array:
    return lanes.y[:, 6:10]


def _rate(lanes: Lanes) -> Array:
    return lanes.y[:, 10:13]


def _thrust(lanes: Lanes) -> Array:
    return lanes.y[:, 14:15] / lanes.y[:, 13:14]


def _propellant(lanes: Lanes) -> Array:
    return lanes.y[:, 13:14] - lanes.figures[:, 3:4]


def _left(lanes: Lanes) -> Array:
    return (lanes.craft.limit - lanes.time)[:, None]


for _part in (
    Part("position", 3, "m", -FAR, FAR, "centre of mass from the target, ENU", _position),
    Part("velocity", 3, "m/s", -FAR, FAR, "ENU", _velocity),
    Part("attitude", 4, "", -1.0, 1.0, "quaternion, body axes to ENU, scalar last", _attitude),
    Part("rate", 3, "rad/s", -10.0, 10.0, "of the body, body axes", _rate),
    Part("thrust", 1, "m/s^2", 0.0, 100.0, "of the engine now, over the mass", _thrust),
    Part("propellant", 1, "kg", -1.0, FAR, "left", _propellant),
    Part("time_left", 1, "s", 0.0, 1e5, "until the flight is broken off", _left),
):
    register(_part)


class Shown:
    """An observation made of parts.

    Parameters
    ----------
    names
        Of the parts, in their order.

    Attributes
    ----------
    places
        Where each part stands in an observation, by name.

    Raises
    ------
    InputError
        If a name is unknown or comes twice, or there is none.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.parts = named_parts("observation", names, PARTS)
        self._checked = False  # at the first look: it takes a share of a step
        sizes = [p.size for p in self.parts]
        ends = np.cumsum(sizes)
        self.places = {
            p.name: slice(int(end) - p.size, int(end))
            for p, end in zip(self.parts, ends, strict=True)
        }
        self._low = np.repeat([p.low for p in self.parts], sizes).astype(np.float32)
        self._high = np.repeat([p.high for p in self.parts], sizes).astype(np.float32)

    def __reduce__(self) -> tuple[type[Shown], tuple[list[str]]]:
        """Copy by names: what a part is computed by need not be copied itself."""
        return Shown, ([part.name for part in self.parts],)

    @property
    def space(self) -> spaces.Box:
        """Of one lane."""
        return spaces.Box(self._low, self._high)

    def of(self, lanes: Lanes) -> NDArray[np.float32]:
        """Return the observation of every lane (n, size)."""
        each = [p.of(lanes) for p in self.parts]
        for part, value in () if self._checked else zip(self.parts, each, strict=True):
            check_shape(f"observation: {part.name}", value, (lanes.count, part.size))
        self._checked = True
        told = np.concatenate(each, axis=1).astype(np.float32)
        return np.clip(told, self._low, self._high, out=told)
