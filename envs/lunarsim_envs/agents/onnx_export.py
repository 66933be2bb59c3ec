"""Export agents of Stable-Baselines3 to ONNX; needs the extra ``rl``."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError, missing_package
from lunarsim.typing import Array
from lunarsim_envs.agents.sb3_agents import check_trust, load_model

# Mean, standard deviation and bound of a component of the observation.
Scaling = tuple[Array, Array, float]


def export_onnx(
    path: Path, out: Path, *, vec_normalize: Path | None = None, trust_pickle: bool = False
) -> None:
    """Write the deterministic policy of a Stable-Baselines3 agent to an ONNX file.

    The inputs are the observation or its entries by name. The output is the action, or for discrete
    actions the scores of all options. The file contains no code.

    Parameters
    ----------
    path
        Agent (``.zip``), a pickle that can run any code when it is loaded.
    out
        File to write.
    vec_normalize
        Statistics that `VecNormalize.save` wrote in the training, also a pickle; the network then
        normalises its inputs. None: the training did not use `VecNormalize`.
    trust_pickle
        Whether the user trusts these files. Otherwise they are refused without loading.

    Raises
    ------
    InputError
        If a file cannot be used, its statistics are of another observation, or PyTorch or
        Stable-Baselines3 are missing.
    """
    try:
        check_trust(str(path), trust_pickle)
    except InputError as error:
        raise error.with_field("agent") from None
    try:
        import onnxscript  # noqa: F401, PLC0415  (torch.onnx needs it)
        import torch  # noqa: PLC0415
    except ImportError as error:
        raise missing_package("agent", str(error.name), "rl") from None
    try:
        policy = load_model(path).policy
    except InputError as error:
        raise error.with_field("agent") from None
    if hasattr(policy, "lstm_actor"):
        raise InputError("agent", str(path), "must be a network without memory")
    space = policy.observation_space
    parts = dict(space.spaces) if isinstance(space, Dict) else {"observation": space}
    scalings = {} if vec_normalize is None else _load_scalings(vec_normalize, parts)

    def normalised(name: str, value: Any) -> Any:
        if name not in scalings:
            return value
        mean, deviation, bound = scalings[name]
        scaled = (value - torch.as_tensor(mean)) / torch.as_tensor(deviation)
        return torch.clamp(scaled, -bound, bound).float()

    class DeterministicPolicy(torch.nn.Module):  # type: ignore[misc]
        """Network that returns the deterministic action, or scores of discrete actions."""

        def __init__(self) -> None:
            super().__init__()
            self.policy = policy

        def forward(self, *seen: Any) -> Any:
            named = {n: normalised(n, one) for n, one in zip(parts, seen, strict=True)}
            shown = named if isinstance(space, Dict) else named["observation"]
            if isinstance(policy.action_space, Box):
                return policy._predict(shown, deterministic=True)
            if hasattr(policy, "q_net"):
                return policy.q_net(shown)
            chosen = policy.get_distribution(shown)
            several = getattr(chosen, "distributions", None) or chosen.distribution
            several = several if isinstance(several, list) else [several]
            return torch.cat([one.logits for one in several], dim=1)

    zeros = tuple(torch.zeros((1, *(part.shape or ()))) for part in parts.values())
    policy.set_training_mode(False)
    # The validation of distributions branches on values; an exported network cannot do that.
    torch.distributions.Distribution.set_default_validate_args(False)
    network = DeterministicPolicy().eval()
    options = {"input_names": list(parts), "external_data": False, "verbose": False}
    try:
        atomic_write(out, lambda file: torch.onnx.export(network, zeros, str(file), **options))
    finally:
        torch.distributions.Distribution.set_default_validate_args(__debug__)


def _load_scalings(path: Path, parts: dict[str, Any]) -> dict[str, Scaling]:
    """Load the scaling of each component of an observation from a file.

    The file is one of `VecNormalize.save`. `parts` are the spaces of the components by name. If the
    file has no such statistics, or those of another observation, an `InputError` is raised.
    """
    field = "--vec-normalize"
    try:
        # The caller has checked that the user trusts the file. A pickle can raise any error.
        saved = vars(pickle.loads(path.read_bytes()))
        if not saved["norm_obs"]:
            return {}
        statistics, bound = saved["obs_rms"], float(saved["clip_obs"])
        by_name = statistics if isinstance(statistics, dict) else {"observation": statistics}
        found = {
            name: (np.array(one.mean, float), np.array(one.var, float) + float(saved["epsilon"]))
            for name, one in by_name.items()
        }
    except Exception:
        raise InputError(field, str(path), "must be a file of VecNormalize.save") from None
    for name, (mean, variance) in found.items():
        shape = parts[name].shape if name in parts else None
        if not mean.shape == variance.shape == shape:
            own = ", ".join(f"{key} {part.shape}" for key, part in parts.items())
            raise InputError(
                field, str(path),
                f"must have statistics of the agent's observation ({own}), not of {name} "
                f"{mean.shape}",
            )  # fmt: skip
        if not (np.isfinite(mean).all() and (variance > 0.0).all() and bound > 0.0):
            raise InputError(
                field, str(path),
                f"must have finite means, positive variances and a positive clip_obs for {name}",
            )  # fmt: skip
    return {name: (mean, np.sqrt(variance), bound) for name, (mean, variance) in found.items()}
