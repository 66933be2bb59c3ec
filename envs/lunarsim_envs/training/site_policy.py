"""Policy for MaskablePPO that scores all sites alike; needs the extra ``rl``."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from torch import nn

from lunarsim_envs.agents.site_network import SiteNetwork
from lunarsim_envs.sites.site_features import FEATURES
from lunarsim_envs.sites.site_inputs import SITES

_OPTIONS, _WIDTH = SITES + 1, len(FEATURES)


class SiteScores(nn.Module):  # type: ignore[misc]
    """Scores of all options by a site network, and features of the value.

    The input is the observation component ``site_features`` of n landers, as rows. The value is
    computed from the current site and from the maxima over all sites.
    """

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.latent_dim_pi, self.latent_dim_vf = _OPTIONS, hidden
        self.linear = nn.Linear(_WIDTH, 1, bias=False)
        self.inner, self.outer = nn.Linear(_WIDTH, hidden), nn.Linear(hidden, 1, bias=False)
        self.each = nn.Sequential(nn.Linear(_WIDTH, hidden), nn.Tanh())
        self.all = nn.Sequential(nn.Linear(2 * hidden, hidden), nn.Tanh())

    def forward(self, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return scores (n, 21) and features of the value (n, hidden)."""
        return self.forward_actor(rows), self.forward_critic(rows)

    def forward_actor(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the scores of all options (n, 21)."""
        sites = rows.reshape(len(rows), _OPTIONS, _WIDTH)
        scores = self.linear(sites) + self.outer(torch.tanh(self.inner(sites)))
        return scores[..., 0]

    def forward_critic(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the features of the value (n, hidden)."""
        each = self.each(rows.reshape(len(rows), _OPTIONS, _WIDTH))
        return self.all(torch.cat((each[:, 0], each.max(dim=1).values), dim=1))


class SitePolicy(MaskableMultiInputActorCriticPolicy):  # type: ignore[misc]
    """Policy of MaskablePPO for the observation ``["site_features"]``.

    Unlike "MultiInputPolicy", which has a weight for every row of the observation, it scores all
    sites with the same network, so that what it learns from one row holds for all.

    Parameters
    ----------
    hidden
        Width of the hidden layers.
    """

    def __init__(self, *arguments: Any, hidden: int = 32, **settings: Any) -> None:
        self.hidden = hidden
        super().__init__(*arguments, **settings)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = SiteScores(self.hidden)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # the scores are the logits
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1.0), **self.optimizer_kwargs
        )

    def _get_constructor_parameters(self) -> dict[str, Any]:
        parameters: dict[str, Any] = super()._get_constructor_parameters()
        return parameters | {"hidden": self.hidden}

    def site_network(self) -> SiteNetwork:
        """Return the network of the scores, which flies without PyTorch."""
        scores = self.mlp_extractor
        linear, inner, bias, outer = (
            np.asarray(weight.detach().numpy(), np.float64)
            for weight in (
                scores.linear.weight[0], scores.inner.weight, scores.inner.bias,
                scores.outer.weight[0],
            )
        )  # fmt: skip
        return SiteNetwork(linear, inner, bias, outer)
