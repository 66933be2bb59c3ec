"""The scaling that a network begins with, in PyTorch; `agents.network` does the same in NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import gymnasium
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor


class TwoScales(BaseFeaturesExtractor):  # type: ignore[misc]
    """Each number at two scales: over `far`, and the inverse hyperbolic sine of it over `near`.

    The second tells a metre from two at the ground and saturates nowhere.

    Parameters
    ----------
    observation_space
        Of ``Guidance-v0`` or ``Control-v0``, numbers (size,).
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
        """Return features (n, 2 size)."""
        return torch.cat((observations / self.far, torch.asinh(observations / self.near)), dim=1)
