"""Train an agent of Guidance-v1 by PPO in one file, without Stable-Baselines3.

    python scenarios/learning/single_file_ppo.py --out ppo.onnx
    lunarsim evaluate Guidance-v1 --agent ppo.onnx --agent apollo

Change this file for experiments with the algorithm. It follows Schulman et al., "Proximal policy
optimization algorithms", 2017, with generalised advantage estimation. Two threads share collection
and learning. Observations are used as tensors without a copy. The script needs the extra `rl`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

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
# The discount is 0.98 per second of flight, at 5 Hz.
GAMMA, LAMBDA, CLIP, VALUE = 0.98**0.2, 0.98, 0.2, 0.5
# Initial standard deviation of actions, of which the range is -1 to 1.
DEVIATION = 0.5
# Difference between the seeds of the two halves of the flights.
SHIFT = 2**31


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


class Rollout(NamedTuple):
    """Steps of flights between two updates, and their last observations.

    `data` has observations (steps, lanes, inputs), actions (steps, lanes, actions), and (steps,
    lanes) log densities, advantages and returns. `safe` has the landing outcomes.
    """

    data: list[torch.Tensor]
    seen: torch.Tensor
    safe: list[bool]


@torch.no_grad()
def collect(
    env: gymnasium.vector.VectorEnv, agent: ActorCritic, seen: torch.Tensor, noise: torch.Tensor
) -> Rollout:
    """Fly one step per entry of `noise` (steps, lanes, actions) from the observations `seen`."""
    (horizon, lanes, size), inputs = noise.shape, seen.shape[1]
    observations = torch.empty(horizon, lanes, inputs)
    actions = torch.empty(horizon, lanes, size)
    rewards, ends = torch.empty(2, horizon, lanes)
    values, safe = torch.empty(horizon + 1, lanes), []
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
    data = [observations, actions, log_densities, gains, gains + values[:-1]]
    return Rollout(data, seen, safe)


def update_policy(
    agent: ActorCritic, optimiser: torch.optim.Optimizer, data: list[torch.Tensor],
    batches: list[torch.Tensor],
) -> None:  # fmt: skip
    """Improve the policy on the data of a rollout, in the order of `batches`."""
    for chosen in batches:
        seen, actions, before, gain = (one[chosen] for one in data[:4])
        noise = (actions - agent.mean(seen)) / agent.log_deviation.exp()
        ratio = (agent.log_density(noise) - before).exp()
        gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
        loss = -torch.min(gain * ratio, gain * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


def update_value(
    agent: ActorCritic, optimiser: torch.optim.Optimizer, data: list[torch.Tensor],
    batches: list[torch.Tensor],
) -> None:  # fmt: skip
    """Fit the value network to the returns of a rollout, in the order of `batches`."""
    for chosen in batches:
        loss = VALUE * (agent.value(data[0][chosen])[:, 0] - data[4][chosen]).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


def train(
    envs: list[gymnasium.vector.VectorEnv], agent: ActorCritic, steps: int, horizon: int,
    batch: int, epochs: int, rate: float, seed: int,
) -> None:  # fmt: skip
    """Train the agent, and print the progress every 20 updates.

    Two threads first collect one half of the flights each; then one updates the policy and the
    other one the value network, which have no common weights.
    """
    networks = [[*agent.mean.parameters(), agent.log_deviation], agent.value.parameters()]
    optimisers = [torch.optim.Adam(one, lr=rate, eps=1e-5, fused=True) for one in networks]
    shapes = [(horizon, *env.action_space.shape) for env in envs]
    seen = [torch.from_numpy(env.reset(seed=seed + k * SHIFT)[0]) for k, env in enumerate(envs)]
    started, safe = time.perf_counter(), [False]
    per_update = horizon * sum(env.num_envs for env in envs)
    updates = -(-steps // per_update)
    with ThreadPoolExecutor(2, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        for n in range(updates):
            noise = [torch.randn(shape) for shape in shapes]
            rollouts = list(pool.map(collect, envs, [agent] * len(envs), seen, noise))
            seen = [one.seen for one in rollouts]
            halves = zip(*(one.data for one in rollouts), strict=True)
            data = [torch.cat(parts, 1).flatten(0, 1) for parts in halves]
            orders = [torch.randperm(per_update) for _ in range(epochs)]
            batches = [one for order in orders for one in order.split(batch)]
            for optimiser in optimisers:
                optimiser.param_groups[0]["lr"] = rate * (1.0 - n / updates)
            work = zip((update_policy, update_value), optimisers, strict=True)
            tasks = [pool.submit(one, agent, adam, data, batches) for one, adam in work]
            for task in tasks:
                task.result()
            safe.extend(flight for one in rollouts for flight in one.safe)
            if n % 20 == 19:
                done, spent = (n + 1) * per_update, time.perf_counter() - started
                click.echo(
                    f"{done:9d} steps, {done / spent:6.0f} steps/s, "
                    f"safe in the last 500 flights: {np.mean(safe[-500:]):.3f}"
                )


def count(name: str, default: int, text: str) -> Callable:
    """Return an option for a positive integer."""
    number = click.IntRange(min=1)
    return click.option(name, type=number, default=default, show_default=True, help=text)


@click.command()
@count("--steps", 30_000_000, "Total number of steps.")
@count("--lanes", 4096, "Number of parallel flights.")
@count("--horizon", 32, "Steps between two updates.")
@count("--batch", 2048, "Size of a minibatch.")
@count("--epochs", 1, "How often an update uses each step.")
@count("--hidden", 32, "Width of the hidden layers.")
@click.option(
    "--rate", type=click.FloatRange(min=0, max=1, min_open=True), default=3e-3, show_default=True,
    help="Initial learning rate.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Root seed.")
@click.option(
    "--out", type=click.Path(path_type=Path), default="ppo.onnx", show_default=True,
    help="ONNX file to write.",
)  # fmt: skip
def main(
    steps: int, lanes: int, horizon: int, batch: int, epochs: int, hidden: int, rate: float,
    seed: int, out: Path,
) -> None:  # fmt: skip
    """Train an agent of Guidance-v1 and write it to an ONNX file."""
    try:
        check_output("--out", out, ".onnx")
    except InputError as error:
        raise click.UsageError(str(error)) from None
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # the training starts two threads
    kind = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "SameStep"}
    parts = (lanes - lanes // 2, lanes // 2) if lanes > 1 else (1,)
    envs = [gymnasium.make_vec(ENV, num_envs=part, **kind) for part in parts]
    inputs, size = envs[0].single_observation_space.shape[0], envs[0].single_action_space.shape[0]
    agent = ActorCritic(inputs, hidden, size)
    train(envs, agent, steps, horizon, batch, epochs, rate, seed)
    example = (torch.zeros(1, inputs),)
    torch.onnx.export(agent.mean.eval(), example, str(out), input_names=["observation"],
                      verbose=False, external_data=False)  # fmt: skip
    click.echo(f"written: {out}")


if __name__ == "__main__":
    main()
