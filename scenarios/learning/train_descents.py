"""Train an agent of Guidance-v1 or Control-v1 by proximal policy optimisation.

python scenarios/learning/train_descents.py --out out/ppo
python scenarios/learning/train_descents.py --out out/ppo     # resume after an interruption
python scenarios/learning/train_descents.py Control-v1 --out out/torques
lunarsim evaluate Guidance-v1 --agent out/ppo/agent.npz --agent apollo

It needs the extra `rl`: pip install ".[rl]", with PyTorch for processors without CUDA from
https://download.pytorch.org/whl/cpu. Output files: settings.json, agent.npz (flown without
PyTorch), curve.json, curve.png and checkpoint/.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import click
from rich.console import Console

from lunarsim import InputError
from lunarsim.console import plain_console
from lunarsim_envs.training.held_out import HeldOutResult
from lunarsim_envs.training.optional_packages import imports_of_extra
from lunarsim_envs.training.settings import SETTINGS, PpoSettings

# Reference agents of the final comparison on held-out seeds.
REFERENCE_AGENTS = ("zero", "hover", "random", "apollo")


def compare(out: Path, settings: PpoSettings, episodes: int, console: Console) -> None:
    """Fly the trained agent and the reference agents on held-out seeds; print results.

    `out` is the folder of the agent, `settings` are those of its training.
    """
    from lunarsim_envs.descent.core import flat_scenario
    from lunarsim_envs.evaluation.episodes import EvaluationStudy
    from lunarsim_envs.evaluation.parallel import fly
    from lunarsim_envs.evaluation.results import add_on_target, agent_metrics, differences
    from lunarsim_envs.evaluation.tables import agents_table, differences_table

    scenario = flat_scenario().changed(
        start={
            "position_sigma_m": settings.position_sigma,
            "velocity_sigma_m_s": settings.velocity_sigma,
        }
    )
    env = f"lunarsim_envs:lunarsim/{settings.environment}"
    study = EvaluationStudy(env, scenario, {"split": "test"}, seed=2)
    agents = (str(out / "agent.npz"), *REFERENCE_AGENTS)
    rows = add_on_target(fly(study, agents, episodes, jobs=1), 10.0)
    console.print(agents_table(agent_metrics(rows, study.seed), 10.0))
    pair = [row for row in rows if row["agent"] in ("agent", "apollo")]
    console.print(differences_table(differences(pair, study.seed)))


@click.command()
@click.argument("environment", type=click.Choice(list(SETTINGS)), default="Guidance-v1")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder for the results. If it has a saved training run, that run is continued.",
)
@click.option("--steps", type=click.IntRange(min=1), default=None,
              help="Number of steps over all parallel episodes. Default: 10 million for "
              "Guidance-v1, 4 million for Control-v1.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="Random seed of the training.")  # fmt: skip
@click.option("--evaluation-interval", type=click.IntRange(min=1), default=20,
show_default=True,
              help="Number of training updates between two evaluations; each evaluation saves a "
              "checkpoint.")  # fmt: skip
@click.option("--episodes", type=click.IntRange(min=1), default=200, show_default=True,
              help="Number of flights per agent in the final comparison.")  # fmt: skip
def main(
    environment: str, out: Path, steps: int | None, seed: int, evaluation_interval: int,
    episodes: int,
) -> None:  # fmt: skip
    """Train an agent of an environment and compare it with reference agents."""
    console = plain_console(150, soft_wrap=True)
    with imports_of_extra("rl"):
        from lunarsim_envs.training.curve import draw_curve
        from lunarsim_envs.training.descents import TrainingRun, train

    def report(run: TrainingRun, seen: HeldOutResult) -> None:
        spent = "-" if math.isnan(seen.propellant) else f"{seen.propellant:.1f} kg"
        console.print(
            f"update {run.done} of {run.settings.updates}, {run.model.num_timesteps / 1e6:.1f} M "
            f"steps, {run.seconds / 60:.1f} min: safe {seen.safe:.3f}, within 10 m "
            f"{seen.on_target:.3f}, propellant {spent}"
        )

    settings = SETTINGS[environment]
    settings = replace(settings, steps=settings.steps if steps is None else steps, seed=seed)
    try:
        run = train(settings, out, evaluation_interval, report)
    except (InputError, OSError) as error:
        raise click.UsageError(str(error)) from None
    (out / "curve.json").write_text(json.dumps(run.curve, indent=1), encoding="utf-8")
    draw_curve(run.curve, out / "curve.png")
    compare(out, settings, episodes, console)
    console.print(f"Agent, settings, curve and checkpoint: {out}")


if __name__ == "__main__":
    main()
