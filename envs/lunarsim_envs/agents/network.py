"""A trained network, flown by NumPy alone: weights in one file, no pickle."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.array_files import read_arrays
from lunarsim.errors import InputError
from lunarsim.whole_arrays import write_arrays_whole
from lunarsim_envs.agents.contract import refuse
from lunarsim_envs.descent.env import DescentEnv

Array = NDArray[np.float32]

_FORMAT = "lunarsim network 1"


@dataclass(frozen=True)
class Network:
    """Layers of tanh on two scales of each number of an observation.

    Attributes
    ----------
    far, near
        The first layer is shown every number over `far`, and the inverse hyperbolic sine of it over
        `near` (size,).
    weights, biases
        Of the layers, the last of which gives the action (m, n) and (m,).
    level
        "Guidance-v0" or "Control-v0".
    parts
        Names of the parts of the observation, in their order.
    rate
        Actions a second that it was trained at, Hz.
    """

    far: Array
    near: Array
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    level: str
    parts: tuple[str, ...]
    rate: float

    def __call__(self, observation: ArrayLike) -> Array:
        """Return actions for observations (size,) or (n, size)."""
        seen = np.asarray(observation, dtype=np.float32)
        layer = np.concatenate((seen / self.far, np.arcsinh(seen / self.near)), axis=-1)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            layer = np.tanh(layer @ weight.T + bias)
        return np.asarray(np.clip(layer @ self.weights[-1].T + self.biases[-1], -1.0, 1.0))

    def save(self, path: Path) -> None:
        """Write it as ``.npz``."""
        held: dict[str, Any] = {f"weight_{i}": w for i, w in enumerate(self.weights)}
        held |= {f"bias_{i}": b for i, b in enumerate(self.biases)}
        held |= {"far": self.far, "near": self.near, "rate": np.float64(self.rate)}
        held |= {"format": _FORMAT, "level": self.level, "parts": list(self.parts)}
        write_arrays_whole(path, held)

    @classmethod
    def load(cls, path: Path) -> Network:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is something else, or its layers do not fit on each other.
        """
        try:
            held = read_arrays(path)
            if str(held["format"]) != _FORMAT:
                raise ValueError(f"its format is {held['format']}")
            layers = sum(name.startswith("weight_") for name in held)
            network = cls(
                held["far"], held["near"],
                tuple(held[f"weight_{i}"] for i in range(layers)),
                tuple(held[f"bias_{i}"] for i in range(layers)),
                str(held["level"]), tuple(map(str, held["parts"])), float(held["rate"]),
            )  # fmt: skip
            network._check()
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise InputError(
                "--agent", str(path), f"a network written by `lunarsim_envs` ({error})"
            ) from None
        return network

    def _check(self) -> None:
        """Refuse layers that do not fit on each other, or are not finite."""
        width = 2 * len(self.far)
        if not self.weights or self.near.shape != self.far.shape:
            raise ValueError("layers or scales are missing")
        for weight, bias in zip(self.weights, self.biases, strict=True):
            if weight.shape != (len(bias), width):
                raise ValueError(f"a layer of shape {weight.shape} on {width} numbers")
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError("a layer with numbers that are not finite")
            width = len(bias)


class NetworkAgent:
    """A network that flies ``Guidance-v0`` or ``Control-v0``.

    Parameters
    ----------
    env
        Which, with the observation and the rate that it was trained on.
    network, name
        Of the file, for messages.

    Raises
    ------
    InputError
        If the environment is another.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], network: Network, name: str) -> None:
        flown = env.unwrapped
        level = f"{'Guidance' if getattr(flown, 'guided', False) else 'Control'}-v0"
        if not isinstance(flown, DescentEnv) or level != network.level:
            raise refuse(name, env, network.level)
        parts = tuple(part.name for part in flown.descents.shown.parts)
        if parts != network.parts:
            raise refuse(name, env, f"observations of {', '.join(network.parts)}")
        if abs(flown.descents.period * network.rate - 1.0) > 1e-9:
            raise refuse(name, env, f"{network.rate:g} actions a second")
        if network.weights[-1].shape[0] != len(flown.descents.actions.scale):
            raise refuse(name, env, f"actions of {network.weights[-1].shape[0]} numbers")
        self._network = network

    def begin(self, rng: np.random.Generator) -> None:
        """Draw nothing."""

    def act(self, observation: Any, info: dict[str, Any]) -> Array:
        """Return the network's action."""
        return self._network(observation)
