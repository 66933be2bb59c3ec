"""Scale network inputs in PyTorch, as `agents.network` does in NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import gymnasium
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor


class TwoScaleFeatures(BaseFeaturesExtractor):  # type: ignore[misc]
    """Input layer of a policy network: scale each observation value in two ways.

    A value x gives x / far and asinh(x / near). The second feature resolves small values near the
    terrain and never saturates.

    Parameters
    ----------
    observation_space
        Observation space of ``Guidance-v0`` or ``Control-v0`` (size,).
    far, near
        Scales (size,), in the units of the observation.
    """

    far: torch.Tensor
    near: torch.Tensor

    def __init__(
        self, observation_space: gymnasium.Space[object], far: Sequence[float],
        near: Sequence[float],
    ) -> None:  # fmt: skip
        super().__init__(observation_space, features_dim=2 * len(far))
        self.register_buffer("far", torch.as_tensor(far, dtype=torch.float32))
        self.register_buffer("near", torch.as_tensor(near, dtype=torch.float32))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return the scaled values (n, 2 size) of observations (n, size)."""
        return torch.cat((observations / self.far, torch.asinh(observations / self.near)), dim=1)
