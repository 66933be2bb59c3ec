"""Export the policy of a Stable-Baselines3 agent to an ONNX file.

An ONNX file contains no code, so it can be flown without trusting its source.

python scenarios/learning/export_onnx.py out/ppo/checkpoint/model.zip --out out/ppo.onnx
lunarsim evaluate Guidance-v1 --agent out/ppo.onnx

The input file is a pickle, which can execute any code: export only agents that you trained. The
script needs the extras `rl` and `onnx`: pip install ".[rl,onnx]".
"""

from __future__ import annotations

from pathlib import Path

import click

from lunarsim_envs.agents.sb3_agents import load_model


@click.command()
@click.argument("agent", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="ONNX file to write (.onnx)."
)
def main(agent: Path, out: Path) -> None:
    """Export the policy of AGENT (Stable-Baselines3 .zip) to ONNX."""
    import torch
    from gymnasium.spaces import Box, Dict

    policy = load_model(agent).policy
    space = policy.observation_space
    parts = dict(space.spaces) if isinstance(space, Dict) else {"observation": space}

    class DeterministicPolicy(torch.nn.Module):
        """Network that returns the deterministic action, or scores of discrete actions."""

        def __init__(self) -> None:
            super().__init__()
            self.policy = policy

        def forward(self, *seen: torch.Tensor) -> torch.Tensor:
            shown = dict(zip(parts, seen, strict=True)) if isinstance(space, Dict) else seen[0]
            if isinstance(policy.action_space, Box):
                return policy._predict(shown, deterministic=True)
            if hasattr(policy, "q_net"):
                return policy.q_net(shown)
            chosen = policy.get_distribution(shown)
            several = getattr(chosen, "distributions", None) or chosen.distribution
            several = several if isinstance(several, list) else [several]
            return torch.cat([one.logits for one in several], dim=1)

    zeros = tuple(torch.zeros(1, *part.shape) for part in parts.values())
    out.parent.mkdir(parents=True, exist_ok=True)
    torch.onnx.export(DeterministicPolicy(), zeros, out, input_names=list(parts), dynamo=False)
    click.echo(f"Written: {out}")


if __name__ == "__main__":
    main()
