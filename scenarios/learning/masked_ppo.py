"""Train an agent of Retarget-v1 by MaskablePPO on the surrogate, and save it.

    python scenarios/learning/masked_ppo.py --out out/masked.npz
    lunarsim evaluate Retarget-v1 --scenario few_sites --agent out/masked.npz --agent safest

The surrogate is a fast statistical model of the mapper. MaskablePPO is PPO with masks of the
available actions; it needs the extra `rl`. Saved agents need only NumPy.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import gymnasium

from lunarsim import InputError
from lunarsim.errors import check_output
from lunarsim_envs.training.held_out import HeldOutResult, evaluate_held_out
from lunarsim_envs.training.optional_packages import imports_of_extra

with imports_of_extra("rl"):
    import torch
    from sb3_contrib import MaskablePPO

    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv
    from lunarsim_envs.training.site_policy import SitePolicy

STEPS, RATE = 200_000, 2e-3
# Parallel flights and their worlds, and steps of each flight between two updates.
LANES, WORLDS, HORIZON = 64, 24, 64
Report = Callable[[int, float, str, HeldOutResult], None]


def batch_env(flights: int, split: str) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    """Return parallel flights of few_sites over worlds of a split."""
    return gymnasium.make_vec(
        "lunarsim_envs:lunarsim/Retarget-v1", num_envs=flights, autoreset_mode="SameStep",
        vectorization_mode="vector_entry_point", scenario="few_sites", perception="surrogate",
        observation=["site_features"], worlds=WORLDS, split=split,
    )  # fmt: skip


def fly(model: MaskablePPO, batch: Any) -> HeldOutResult:
    """Evaluate a model with its most likely actions, one episode in each environment of a batch."""

    def agent(seen: Any, info: Any) -> Any:
        return model.predict(seen, action_masks=batch.action_masks(), deterministic=True)[0]

    return evaluate_held_out(batch, agent)


def train(steps: int, seed: int, checks: int, report: Report) -> MaskablePPO:
    """Train an agent and return the model.

    `report` is called with steps, seconds of training, split and result: `checks` times with 300
    flights of the split "validation", and at the end with 500 of "test".
    """
    torch.set_num_threads(1)
    env = Sb3VecEnv(batch_env(LANES, "train"))
    env.seed(seed)
    model = MaskablePPO(SitePolicy, env, n_steps=HORIZON, batch_size=512, seed=seed, device="cpu")
    validation, spent = batch_env(300, "validation"), 0.0
    updates = -(-steps // (LANES * HORIZON))
    due = {-(-updates * k // checks) for k in range(1, checks + 1)}
    for n in range(updates):
        start = time.perf_counter()
        rate = RATE * (1.0 - n / updates)
        model.lr_schedule = lambda _, rate=rate: rate
        model.learn(LANES * HORIZON, reset_num_timesteps=False)
        spent += time.perf_counter() - start
        if n + 1 in due:
            report(model.num_timesteps, spent, "validation", fly(model, validation))
    report(model.num_timesteps, spent, "test", fly(model, batch_env(500, "test")))
    return model


@click.command()
@click.option(
    "--steps",
    type=click.IntRange(min=1),
    default=STEPS,
    show_default=True,
    help="Number of decisions of all parallel flights.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Random seed of the training.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="File for the network (.npz)."
)  # fmt: skip
def main(steps: int, seed: int, out: Path) -> None:
    """Train an agent of Retarget-v1 and save its network."""
    try:
        check_output("--out", out, ".npz")
        out.parent.mkdir(parents=True, exist_ok=True)
    except (InputError, OSError) as error:
        raise click.UsageError(str(error)) from None

    def report(done: int, seconds: float, split: str, result: HeldOutResult) -> None:
        click.echo(
            f"{done:8d} steps, {seconds / 60.0:4.1f} min, split {split}: safe {result.safe:.3f}, "
            f"propellant {result.propellant:.1f} kg"
        )

    model = train(steps, seed, 10, report)
    model.policy.site_network().save(out)
    click.echo(f"written: {out}")


if __name__ == "__main__":
    main()
