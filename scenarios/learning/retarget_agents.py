"""Fly a random and a rule-based agent in the retargeting environment.

python scenarios/learning/retarget_agents.py --episodes 10
python scenarios/learning/retarget_agents.py --episodes 1 --video out/film.mp4
"""

from __future__ import annotations

from pathlib import Path

import click
import gymnasium
import numpy as np
from rich.progress import track

from lunarsim import InputError
from lunarsim.errors import check_output
from lunarsim_envs.video import save_video


def random_agent(observation: dict, info: dict, rng: np.random.Generator) -> int:
    """Select a random available action of Retarget-v1."""
    return int(rng.choice(np.flatnonzero(info["action_mask"])))


def rule_agent(observation: dict, info: dict, rng: np.random.Generator) -> int:
    """Select the nearest site with p_safe of 0.95 or more, else the safest one.

    The current site is kept (action 0) if that site is within 2 m; 1 + k selects candidate k.
    """
    sites = observation["sites"]
    good = (sites[:, 5] > 0) & (sites[:, 3] >= min(0.95, sites[:, 3].max()))
    distance = np.hypot(sites[:, 0], sites[:, 1])
    if not good.any() or distance[good].min() < 2.0:
        return 0
    return 1 + int(np.argmin(np.where(good, distance, np.inf)))


@click.command()
@click.option(
    "--episodes",
    type=click.IntRange(min=1),
    default=10,
    show_default=True,
    help="Number of flights per agent.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Random seed of the first flight; each further flight adds 1.",
)
@click.option(
    "--scenario",
    default=None,
    help="Scenario: TOML file, or a name from `lunarsim scenario list` (default: rolling "
    "highland).",
)
@click.option("--video", type=click.Path(path_type=Path), default=None,
              help="MP4 or GIF file for a video of the last flight of the rule-based agent. "
              "Default: no video.")  # fmt: skip
def main(episodes: int, seed: int, scenario: str | None, video: Path | None) -> None:
    """Fly a random and a rule-based agent over the same terrains; print the results."""
    mode = None if video is None else "rgb_array_list"
    try:
        if video is not None:
            video.parent.mkdir(parents=True, exist_ok=True)
            check_output("--video", video, ".gif" if video.suffix.lower() == ".gif" else ".mp4")
        env = gymnasium.make(
            "lunarsim_envs:lunarsim/Retarget-v1",
            perception="onboard",
            scenario=scenario,
            render_mode=mode,
        )
    except InputError as error:
        raise click.UsageError(str(error)) from None
    for name, agent in (("random", random_agent), ("rule-based", rule_agent)):
        rng = np.random.default_rng(seed)
        returns, safe = [], 0
        for episode in track(range(episodes), description=name):
            observation, info = env.reset(seed=seed + episode)
            total, over = 0.0, False
            while not over:
                observation, reward, ended, late, info = env.step(agent(observation, info, rng))
                over, total = ended or late, total + float(reward)
            returns.append(total)
            film = env.render()
            safe += info["safe"]
        print(f"{name}: mean return {np.mean(returns):.3f}, safe landings {safe} of {episodes}")
    if video is not None:
        save_video(film, video, env.metadata["render_fps"])
        print(f"{len(film)} frames in {video}")


if __name__ == "__main__":
    main()
