"""Build observations of the descent environments from named components.

`register` adds custom components, which can then be named in an environment's `observation`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.typing import Array
from lunarsim.value_checks import check_shape
from lunarsim_envs.descent.batch import DescentBatch
from lunarsim_envs.named_components import PER_LANDER, check_new, named_parts

# Bound of distances (m), speeds (m/s) and masses (kg) in observations; larger values are clipped.
FAR = 5000.0


@dataclass(frozen=True)
class ObservationComponent:
    """One component of the observation of a descent, such as the position.

    Attributes
    ----------
    name
        Name by which the environment's argument `observation` selects the component.
    size, low, high
        Number of values, and their bounds.
    unit, meaning
        Unit and description, for the documentation.
    of
        Function that returns the values of all n landers of a batch (n, size).
    far, near
        Scales of the scaled observation: typical magnitude of a flight, and resolution near the
        target.
    """

    name: str
    size: int
    unit: str
    low: float
    high: float
    meaning: str
    of: Callable[[DescentBatch], Array]
    far: float = 1.0
    near: float = 1.0


PARTS: dict[str, ObservationComponent] = {}
# Default components of the observation.
DEFAULT = ("position", "velocity", "attitude", "rate", "thrust", "propellant", "time_left")


def register(part: ObservationComponent) -> None:
    """Register a custom component, so that environments can select it by name.

    Raises
    ------
    InputError
        If the name exists, the size is less than 1, or the bounds are empty.
    """
    check_new(part.name, PARTS)
    if part.size < 1:
        raise InputError(f"{part.name}.size", part.size, "must be 1 or more")
    if not part.low < part.high:
        raise InputError(f"{part.name}.low", part.low, f"must be less than high ({part.high})")
    for name in ("far", "near"):
        scale = getattr(part, name)
        if not 0.0 < scale < np.inf:
            raise InputError(f"{part.name}.{name}", scale, "must be positive and finite")
    PARTS[part.name] = part


def _position(lanes: DescentBatch) -> Array:
    return lanes.y[:, :3] - lanes.target


def _velocity(lanes: DescentBatch) -> Array:
    return lanes.y[:, 3:6]


def _attitude(lanes: DescentBatch) -> Array:
    return lanes.y[:, 6:10]


def _rate(lanes: DescentBatch) -> Array:
    return lanes.y[:, 10:13]


def _thrust(lanes: DescentBatch) -> Array:
    return lanes.y[:, 14:15] / lanes.y[:, 13:14]


def _propellant(lanes: DescentBatch) -> Array:
    return lanes.y[:, 13:14] - lanes.params[:, 3:4]


def _left(lanes: DescentBatch) -> Array:
    return (lanes.craft.time_limit - lanes.time)[:, None]


for _part in (
    ObservationComponent(
        "position", 3, "m", -FAR, FAR, "centre of mass relative to the target, ENU", _position,
        600.0, 3.0,
    ),
    ObservationComponent("velocity", 3, "m/s", -FAR, FAR, "velocity, ENU", _velocity, 40.0, 1.0),
    ObservationComponent(
        "attitude", 4, "", -1.0, 1.0, "quaternion, body axes to ENU, scalar last", _attitude, 1.0,
        0.1,
    ),
    ObservationComponent(
        "rate", 3, "rad/s", -10.0, 10.0, "angular rate, body axes", _rate, 0.5, 0.1
    ),
    ObservationComponent(
        "thrust", 1, "m/s^2", 0.0, 100.0, "current thrust over mass", _thrust, 4.0, 1.0
    ),
    ObservationComponent(
        "propellant", 1, "kg", -1.0, FAR, "remaining propellant", _propellant, 400.0, 400.0
    ),
    ObservationComponent(
        "time_left", 1, "s", 0.0, 1e5, "time until the time limit", _left, 120.0, 10.0
    ),
):  # fmt: skip
    register(_part)


class ObservationLayout:
    """Compute observations that consist of named components in sequence.

    Parameters
    ----------
    names
        Names of the components, in order.

    Attributes
    ----------
    places
        Slice of each component in the observation, by name.

    Raises
    ------
    InputError
        If a name is unknown or occurs twice, or there are no names.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.parts = named_parts("observation", names, PARTS)
        self._checked = False  # shapes are checked once, because a check takes a part of a step
        sizes = [p.size for p in self.parts]
        ends = np.cumsum(sizes)
        self.places = {
            p.name: slice(int(end) - p.size, int(end))
            for p, end in zip(self.parts, ends, strict=True)
        }
        self._low = np.repeat([p.low for p in self.parts], sizes).astype(np.float32)
        self._high = np.repeat([p.high for p in self.parts], sizes).astype(np.float32)

    def __reduce__(self) -> tuple[type[ObservationLayout], tuple[list[str]]]:
        """Pickle the names only, because functions of components may not be picklable."""
        return ObservationLayout, ([part.name for part in self.parts],)

    @property
    def space(self) -> spaces.Box:
        """Observation space of one lander."""
        return spaces.Box(self._low, self._high)

    def of(self, lanes: DescentBatch) -> NDArray[np.float32]:
        """Compute the observations of all landers of a batch (n, size)."""
        each = [p.of(lanes) for p in self.parts]
        for part, value in () if self._checked else zip(self.parts, each, strict=True):
            check_shape(f"observation {part.name!r}", value, (lanes.count, part.size), PER_LANDER)
        self._checked = True
        observation = np.concatenate(each, axis=1).astype(np.float32)
        # Twice as fast as `numpy.clip` for one lander.
        np.maximum(observation, self._low, out=observation)
        return np.minimum(observation, self._high, out=observation)


class ObservationScaling:
    """Scale observations for neural networks, in two ways.

    A value x becomes x / far and asinh(x / near), with the scales of its component. The second one
    resolves small values near the target and does not saturate. A scaled observation (2 size,) has
    x / far of all values, then asinh(x / near) of all values.

    Parameters
    ----------
    layout
        Components of the observation in physical units.

    Attributes
    ----------
    far, near
        Scales of all values (size,).
    """

    def __init__(self, layout: ObservationLayout) -> None:
        sizes = [part.size for part in layout.parts]
        self.far = np.repeat([part.far for part in layout.parts], sizes).astype(np.float32)
        self.near = np.repeat([part.near for part in layout.parts], sizes).astype(np.float32)
        low, high = (np.asarray(end, np.float32) for end in (layout.space.low, layout.space.high))
        self.space = spaces.Box(self.scaled(low), self.scaled(high))

    def scaled(self, physical: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return scaled observations (..., 2 size) of observations (..., size), SI."""
        return np.concatenate(
            (physical / self.far, np.arcsinh(physical / self.near)), axis=-1, dtype=np.float32
        )

    def physical(self, scaled: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the observations (..., size), SI, of scaled observations (..., 2 size)."""
        return np.asarray(scaled[..., : len(self.far)] * self.far, np.float32)
