"""Error states with correlations between all errors, for tests."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.navigation.error_state import ErrorState
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
BLOCKS = {"key": np.zeros((6, 6)), "ground": np.array([[4.0]])}
SIZE = 15 + 6 + 1


def made(rng: np.random.Generator, tail: int = 0) -> ErrorState:
    """Return an error state with correlations between all errors."""
    inertial = StrapdownState(rng.normal(size=3), rng.normal(size=3), UPRIGHT, 1.6)
    state = ErrorState(inertial, StartSigmas(), blocks=BLOCKS, capacity=tail)
    state.tail = tail
    root = rng.normal(size=(SIZE + tail, SIZE + tail))
    state.covariance[:] = root @ root.T / 30.0 + 0.1 * np.eye(SIZE + tail)
    return state


def alike(states, step, rng: np.random.Generator) -> None:
    """Apply one random step to each of several states."""
    number = int(rng.integers(2**32))
    for state in states:
        step(state, np.random.default_rng(number))
