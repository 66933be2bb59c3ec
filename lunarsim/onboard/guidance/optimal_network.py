"""Network for thrust and time-to-go of minimum-propellant descents, in NumPy only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.atomic_files import atomic_write_arrays
from lunarsim.errors import InputError
from lunarsim.typing import Array
from lunarsim.untrusted_files import read_arrays

DEFAULT_NETWORK_PATH = Path(__file__).parent / "trained" / "optimal.npz"
INPUTS, OUTPUTS = 6, 4  # number of network inputs and outputs
_FORMAT = "lunarsim optimal network 1"
_MAX_FILE_BYTES = 1_000_000  # maximum file size, bytes
_PROBLEM_SIZE = 7  # number of parameters in `OptimalNetwork.problem`


def reduce_state(
    displacement: ArrayLike, velocity: ArrayLike, mass: ArrayLike
) -> tuple[Array, Array]:
    """Reduce a state by symmetry to the network inputs, with the axes of its output.

    The problem is symmetric under rotation about the vertical through the end and under reflection.
    The first axis points horizontally from the end to the lander; the second is horizontal, across
    it, on the side of the velocity.

    Parameters
    ----------
    displacement, velocity
        Position relative to the end, and velocity (..., 3), ENU, m and m/s.
    mass
        Mass (...), kg.

    Returns
    -------
    inputs
        Network inputs (..., 6): horizontal distance and height, m, velocity along the first, second
        and up axis, m/s, and mass, kg.
    axes
        Unit vectors in rows (..., 3, 3), ENU.
    """
    displacement, velocity = np.asarray(displacement, np.float64), np.asarray(velocity, np.float64)
    horizontal = np.hypot(displacement[..., 0], displacement[..., 1])
    near = horizontal < 1e-9
    along = np.where(
        near[..., None], [1.0, 0.0], displacement[..., :2] / np.maximum(horizontal, 1e-9)[..., None]
    )
    across = np.stack((-along[..., 1], along[..., 0]), axis=-1)
    crossrange_speed = np.sum(across * velocity[..., :2], axis=-1)
    across = across * np.where(crossrange_speed < 0.0, -1.0, 1.0)[..., None]
    inputs = np.stack(
        (
            horizontal, displacement[..., 2], np.sum(along * velocity[..., :2], axis=-1),
            np.abs(crossrange_speed), velocity[..., 2],
            np.broadcast_to(np.asarray(mass, np.float64), horizontal.shape),
        ),
        axis=-1,
    )  # fmt: skip
    axes = np.zeros((*horizontal.shape, 3, 3))
    axes[..., 0, :2], axes[..., 1, :2], axes[..., 2, 2] = along, across, 1.0
    return inputs, axes


@dataclass(frozen=True)
class OptimalNetwork:
    """Trained network that maps a state to optimal thrust and time-to-go.

    Its layers are linear functions, followed by tanh except in the last layer; the inputs enter in
    two scalings.

    Attributes
    ----------
    far, near
        Scales of the inputs (6,): the first layer gets each input over `far`, and the inverse
        hyperbolic sine of the input over `near`.
    low, high
        Bounds of the training domain (6,), in the order of `reduce_state`.
    scale
        Scales of the outputs (4,): thrust over mass in the axes of `reduce_state`, m/s^2, and
        time-to-go, s.
    weights, biases
        Weights (outputs, inputs) and biases (outputs,) of each layer.
    problem
        Parameters of the training (7,): gravity (m/s^2), minimum and maximum thrust (N), exhaust
        velocity and final downward speed (m/s), maximum tilt and glideslope (rad).
    """

    far: Array
    near: Array
    low: Array
    high: Array
    scale: Array
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    problem: Array

    def is_in_domain(self, inputs: Array) -> bool:
        """Return whether network inputs (6,) are in the training domain."""
        return bool(np.all(inputs >= self.low) and np.all(inputs <= self.high))

    def __call__(self, inputs: Array) -> Array:
        """Return thrust over mass in the axes of `reduce_state` and time-to-go (..., 4).

        `inputs` (..., 6) are the network inputs from `reduce_state`; thrust over mass is in m/s^2,
        time in s.
        """
        layer = np.concatenate((inputs / self.far, np.arcsinh(inputs / self.near)), axis=-1)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            layer = np.tanh(layer @ weight.T + bias)
        return np.asarray((layer @ self.weights[-1].T + self.biases[-1]) * self.scale)

    def save(self, path: Path) -> None:
        """Write the network as ``.npz``, with weights in single precision."""
        arrays: dict[str, Any] = {f"weight_{i}": np.float32(w) for i, w in enumerate(self.weights)}
        arrays |= {f"bias_{i}": np.float32(b) for i, b in enumerate(self.biases)}
        for name in ("far", "near", "low", "high", "scale", "problem"):
            arrays[name] = getattr(self, name)
        atomic_write_arrays(path, arrays | {"format": _FORMAT})

    @classmethod
    def load(cls, path: Path = DEFAULT_NETWORK_PATH) -> OptimalNetwork:
        """Read a network that `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, larger than 1 MB or not a network, or its layers do not fit.
        """
        try:
            arrays = read_arrays(path, _MAX_FILE_BYTES)
            if str(arrays.pop("format")) != _FORMAT:
                raise ValueError("it has another format")
            layers = sum(name.startswith("weight_") for name in arrays)
            wide = {name: np.asarray(array, np.float64) for name, array in arrays.items()}
            network = cls(
                **{n: wide[n] for n in ("far", "near", "low", "high", "scale", "problem")},
                weights=tuple(wide[f"weight_{i}"] for i in range(layers)),
                biases=tuple(wide[f"bias_{i}"] for i in range(layers)),
            )
            network._check()
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            reason = f"the array {error} is missing" if isinstance(error, KeyError) else error
            raise InputError(
                "guidance.weights", str(path), f"must be a file of network weights ({reason})",
                "Write one with scenarios/learning/train_optimal.py.",
            ) from None  # fmt: skip
        return network

    def _check(self) -> None:
        """Raise ValueError if layers have inconsistent shapes or values are not finite."""
        scales = (self.far, self.near, self.low, self.high)
        if any(a.shape != (INPUTS,) for a in scales) or not self.weights:
            raise ValueError("it has no layers, or its input scales have a wrong shape")
        if self.scale.shape != (OUTPUTS,) or self.problem.shape != (_PROBLEM_SIZE,):
            raise ValueError("its output scale or its landing problem has a wrong shape")
        width = 2 * INPUTS
        for n, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if bias.ndim != 1 or weight.shape != (len(bias), width):
                raise ValueError(f"weight_{n} or bias_{n} has a wrong shape")
            width = len(bias)
        if width != OUTPUTS:
            raise ValueError(f"the network has {width} outputs instead of {OUTPUTS}")
        arrays = (*scales, self.scale, self.problem, *self.weights, *self.biases)
        if not all(np.isfinite(a).all() for a in arrays):
            raise ValueError("some numbers are not finite")
