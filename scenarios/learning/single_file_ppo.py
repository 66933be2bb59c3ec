"""Train an agent of Guidance-v1 by PPO in one file, without Stable-Baselines3.

    python scenarios/learning/single_file_ppo.py --out ppo.onnx
    lunarsim evaluate Guidance-v1 --agent ppo.onnx --agent apollo

Change this file for experiments with the algorithm. It follows Schulman et al., "Proximal policy
optimization algorithms", 2017, with generalised advantage estimation. Observations of the batch
are used as tensors without a copy. The script needs the extra `rl`.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import gymnasium
import numpy as np

from lunarsim import InputError
from lunarsim.errors import check_output
from lunarsim_envs.training.optional_packages import imports_of_extra

with imports_of_extra("rl"):
    import onnxscript  # noqa: F401  (torch.onnx needs it)
    import torch
    from torch import nn

ENV = "lunarsim_envs:lunarsim/Guidance-v1"
ONE_OR_MORE = click.IntRange(min=1)
# The discount is 0.98 per second of flight, at 5 Hz.
GAMMA, LAMBDA, CLIP, VALUE = 0.98**0.2, 0.98, 0.2, 0.5
# Initial standard deviation of actions, of which the range is -1 to 1.
DEVIATION = 0.5


def network(inputs: int, hidden: int, outputs: int, last: float) -> nn.Sequential:
    """Return a network with two hidden layers and orthogonal weights."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, size in zip(layers, (2**0.5, 2**0.5, last), strict=True):
        nn.init.orthogonal_(layer.weight, size)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


class ActorCritic(nn.Module):
    """Normal policy with the same standard deviation in all states, and a value network."""

    def __init__(self, inputs: int, hidden: int, actions: int) -> None:
        super().__init__()
        self.mean = network(inputs, hidden, actions, 0.01)
        self.value = network(inputs, hidden, 1, 1.0)
        self.log_deviation = nn.Parameter(torch.full((actions,), DEVIATION).log())

    def log_density(self, noise: torch.Tensor) -> torch.Tensor:
        """Return the log density, up to a constant, of actions with noise (..., actions).

        The noise is the distance of an action from the mean, in standard deviations.
        """
        return -0.5 * noise.square().sum(-1) - self.log_deviation.sum()


def advantages(rewards: torch.Tensor, values: torch.Tensor, ends: torch.Tensor) -> torch.Tensor:
    """Return generalised advantage estimates (steps, lanes).

    `values` (steps + 1, lanes) are those before each step and after the last one; `ends` (steps,
    lanes) is 1 where an episode ended.
    """
    found, last = torch.zeros_like(rewards), torch.zeros(rewards.shape[1])
    for n in reversed(range(len(rewards))):
        goes_on = 1.0 - ends[n]
        error = rewards[n] + GAMMA * values[n + 1] * goes_on - values[n]
        last = error + GAMMA * LAMBDA * goes_on * last
        found[n] = last
    return found


def update(
    agent: ActorCritic, optimiser: torch.optim.Optimizer, data: list[torch.Tensor], batch: int,
    epochs: int,
) -> None:  # fmt: skip
    """Improve the agent on one rollout.

    `data` has observations (n, inputs), actions (n, actions), and (n,) log densities, advantages
    and returns. `batch` is the size of a minibatch, and `epochs` how often all data are
    used.
    """
    for _ in range(epochs):
        for chosen in torch.randperm(len(data[0])).split(batch):
            seen, actions, before, gain, returns = (one[chosen] for one in data)
            noise = (actions - agent.mean(seen)) / agent.log_deviation.exp()
            ratio = (agent.log_density(noise) - before).exp()
            gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
            policy_loss = -torch.min(gain * ratio, gain * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
            value_loss = (agent.value(seen)[:, 0] - returns).square().mean()
            loss = policy_loss + VALUE * value_loss
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()


@click.command()
@click.option(
    "--steps",
    type=ONE_OR_MORE,
    default=30_000_000,
    show_default=True,
    help="Total number of steps.",
)
@click.option(
    "--lanes",
    type=ONE_OR_MORE,
    default=4096,
    show_default=True,
    help="Number of parallel flights.",
)
@click.option(
    "--horizon", type=ONE_OR_MORE, default=32, show_default=True, help="Steps between two updates."
)
@click.option(
    "--batch", type=ONE_OR_MORE, default=2048, show_default=True, help="Size of a minibatch."
)
@click.option(
    "--epochs",
    type=ONE_OR_MORE,
    default=1,
    show_default=True,
    help="How often an update uses each step.",
)
@click.option(
    "--hidden", type=ONE_OR_MORE, default=32, show_default=True, help="Width of the hidden layers."
)
@click.option(
    "--rate",
    type=click.FloatRange(min=0, max=1, min_open=True),
    default=3e-3,
    show_default=True,
    help="Initial learning rate.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Root seed.")
@click.option(
    "--out", type=click.Path(path_type=Path), default="ppo.onnx", show_default=True,
    help="ONNX file to write.",
)  # fmt: skip
def main(
    steps: int,
    lanes: int,
    horizon: int,
    batch: int,
    epochs: int,
    hidden: int,
    rate: float,
    seed: int,
    out: Path,
) -> None:
    """Train an agent of Guidance-v1 and write it to an ONNX file."""
    try:
        check_output("--out", out, ".onnx")
    except InputError as error:
        raise click.UsageError(str(error)) from None
    torch.manual_seed(seed)
    env = gymnasium.make_vec(
        ENV, num_envs=lanes, vectorization_mode="vector_entry_point", autoreset_mode="SameStep"
    )
    inputs, size = env.single_observation_space.shape[0], env.single_action_space.shape[0]
    agent = ActorCritic(inputs, hidden, size)
    optimiser = torch.optim.Adam(agent.parameters(), lr=rate, eps=1e-5, fused=True)
    seen = torch.from_numpy(env.reset(seed=seed)[0])
    observations = torch.zeros(horizon, lanes, inputs)
    actions = torch.zeros(horizon, lanes, size)
    rewards, ends = torch.zeros(2, horizon, lanes)
    values = torch.zeros(horizon + 1, lanes)
    started, safe = time.perf_counter(), [False]
    updates = -(-steps // (lanes * horizon))
    for n in range(updates):
        optimiser.param_groups[0]["lr"] = rate * (1.0 - n / updates)
        noise = torch.randn(horizon, lanes, size)
        with torch.no_grad():
            log_densities, deviation = agent.log_density(noise), agent.log_deviation.exp()
            for k in range(horizon):
                observations[k], values[k] = seen, agent.value(seen)[:, 0]
                actions[k] = agent.mean(seen) + deviation * noise[k]
                shown, reward, ended, _, info = env.step(actions[k].clamp(-1.0, 1.0).numpy())
                seen = torch.from_numpy(shown)
                rewards[k], ends[k] = torch.from_numpy(reward), torch.from_numpy(ended)
                if ended.any():
                    safe.extend(info["final_info"]["safe"][ended].tolist())
            values[horizon] = agent.value(seen)[:, 0]
            gains = advantages(rewards, values, ends)
        rollout = [observations, actions, log_densities, gains, gains + values[:-1]]
        update(agent, optimiser, [one.flatten(0, 1) for one in rollout], batch, epochs)
        if n % 20 == 19:
            done, spent = (n + 1) * lanes * horizon, time.perf_counter() - started
            click.echo(
                f"{done:9d} steps, {done / spent:6.0f} steps/s, "
                f"safe in the last 500 flights: {np.mean(safe[-500:]):.3f}"
            )
    example = (torch.zeros(1, inputs),)
    torch.onnx.export(agent.mean, example, str(out), input_names=["observation"], verbose=False,
                      external_data=False)  # fmt: skip
    click.echo(f"written: {out}")


if __name__ == "__main__":
    main()
