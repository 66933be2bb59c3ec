"""Truncate episodes after a number of steps, as Gymnasium's `TimeLimit` does."""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim.typing import BoolArray
from lunarsim_envs.arguments import checked_int


class StepLimit:
    """Count the steps of the episodes of n parallel environments up to a limit.

    Parameters
    ----------
    max_episode_steps
        Number of steps after which an episode is truncated; None or -1 is no limit.
    count
        Number of environments n.
    """

    def __init__(self, max_episode_steps: Any, count: int) -> None:
        given = None if max_episode_steps == -1 else max_episode_steps
        self.most = None if given is None else checked_int("max_episode_steps", given, 1)
        self._steps = np.zeros(count, np.int64)

    def begin(self, mask: BoolArray) -> None:
        """Restart the count in the environments of `mask` (n,)."""
        self._steps[mask] = 0

    def reached(self, moved: BoolArray) -> BoolArray:
        """Count one step of some environments; return which of them reach the limit (n,).

        `moved` (n,) marks the environments that have stepped; the result is false for others.
        """
        self._steps[moved] += 1
        if self.most is None:
            return np.zeros_like(moved)
        return moved & (self._steps >= self.most)
