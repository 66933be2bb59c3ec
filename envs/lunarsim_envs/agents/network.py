"""Fly a trained network with NumPy only; weights are in one file without pickles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.atomic_files import atomic_write_arrays
from lunarsim.errors import InputError, error_reason
from lunarsim.untrusted_files import read_arrays
from lunarsim_envs.agents.agent_interface import incompatible_agent_error
from lunarsim_envs.descent.env import DescentEnv

Array = NDArray[np.float32]

_FORMAT = "lunarsim network 2"


@dataclass(frozen=True)
class Network:
    """Multilayer perceptron (tanh) from scaled observations of a descent to actions.

    Attributes
    ----------
    far, near
        Scales of the observation in the training (size,), as `ObservationScaling` has them.
    weights, biases
        Weights (m, n) and biases (m,) of the layers; the last layer outputs the action.
    level
        Environment for which the network is trained: "Guidance-v1" or "Control-v1".
    parts
        Names of the observation components, in order.
    rate
        Action rate of the training, Hz.
    """

    far: Array
    near: Array
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    level: str
    parts: tuple[str, ...]
    rate: float

    def __call__(self, observation: ArrayLike) -> Array:
        """Return actions from -1 to 1 for scaled observations (2 size,) or (n, 2 size)."""
        layer = np.asarray(observation, dtype=np.float32)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            layer = np.tanh(layer @ weight.T + bias)
        return np.asarray(np.clip(layer @ self.weights[-1].T + self.biases[-1], -1.0, 1.0))

    def save(self, path: Path) -> None:
        """Write the network to a ``.npz`` file."""
        held: dict[str, Any] = {f"weight_{i}": w for i, w in enumerate(self.weights)}
        held |= {f"bias_{i}": b for i, b in enumerate(self.biases)}
        held |= {"far": self.far, "near": self.near, "rate": np.float64(self.rate)}
        held |= {"format": _FORMAT, "level": self.level, "parts": list(self.parts)}
        atomic_write_arrays(path, held)

    @classmethod
    def load(cls, path: Path) -> Network:
        """Read a network written by `save`.

        Raises
        ------
        InputError
            If the file is not a network, or its layers have inconsistent shapes.
        """
        try:
            held = read_arrays(path)
            if str(held["format"]) != _FORMAT:
                raise ValueError(f"the format must be {_FORMAT}, not {held['format']}")
            layers = sum(name.startswith("weight_") for name in held)
            network = cls(
                held["far"], held["near"],
                tuple(held[f"weight_{i}"] for i in range(layers)),
                tuple(held[f"bias_{i}"] for i in range(layers)),
                str(held["level"]), tuple(map(str, held["parts"])), float(held["rate"]),
            )  # fmt: skip
            network._check()
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            array = "the array " if isinstance(error, KeyError) else ""
            raise InputError(
                "--agent",
                str(path),
                f"must be a network trained with lunarsim ({array}{error_reason(error)})",
            ) from None
        return network

    def _check(self) -> None:
        """Raise ValueError if shapes of layers are inconsistent or values not finite."""
        width = 2 * len(self.far)
        if not 0.01 <= self.rate <= 1000.0:
            raise ValueError(f"the action rate is {self.rate:g} Hz")
        if not self.weights or self.near.shape != self.far.shape:
            raise ValueError("layers or scales are missing")
        for weight, bias in zip(self.weights, self.biases, strict=True):
            if bias.ndim != 1 or weight.shape != (len(bias), width):
                raise ValueError(f"a layer has weights of shape {weight.shape}, but {width} inputs")
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError("a layer has values that are not finite")
            width = len(bias)


class NetworkAgent:
    """Fly ``Guidance-v1`` or ``Control-v1`` with a trained NumPy network.

    If the action rate of the environment is a multiple of that of the training, each action of the
    network is held for as many steps.

    Parameters
    ----------
    env
        Environment with the observation of the training, and its action rate or a multiple of it.
    network
        Trained network.
    name
        Name of the agent, for messages.

    Raises
    ------
    InputError
        If the environment does not fit the network.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], network: Network, name: str) -> None:
        flown = env.unwrapped
        level = f"{'Guidance' if getattr(flown, 'guided', False) else 'Control'}-v1"
        if not isinstance(flown, DescentEnv) or level != network.level:
            raise incompatible_agent_error(name, env, network.level)
        parts = tuple(part.name for part in flown.descents.shown.parts)
        if parts != network.parts:
            raise incompatible_agent_error(
                name, env, f"the observation components {', '.join(network.parts)}"
            )
        scaling = flown.descents.scaling
        if scaling is None or not (
            np.array_equal(scaling.far, network.far) and np.array_equal(scaling.near, network.near)
        ):
            raise incompatible_agent_error(
                name, env, "observations that are scaled as in its training"
            )
        steps = 1.0 / (flown.descents.period * network.rate)
        self._steps = max(round(steps), 1)
        if abs(steps / self._steps - 1.0) > 1e-9:
            raise incompatible_agent_error(
                name, env, f"{network.rate:g} actions per second, or a multiple of it"
            )
        if network.weights[-1].shape[0] != len(flown.descents.actions.high):
            raise incompatible_agent_error(
                name, env, f"actions with {network.weights[-1].shape[0]} values"
            )
        self._network, self._step = network, 0

    def begin(self, rng: np.random.Generator) -> None:
        """Begin a flight: the next action comes from its observation."""
        self._step = 0

    def act(self, observation: Any, info: dict[str, Any]) -> Array:
        """Return the action from an observation (2 size,), or the held action."""
        if self._step % self._steps == 0:
            self._action = self._network(observation)
        self._step += 1
        return self._action.copy()
