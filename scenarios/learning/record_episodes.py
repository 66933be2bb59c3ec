r"""Record episodes of an environment, flown by an agent, as a Minari data set.

    python scenarios/learning/record_episodes.py Guidance-v1 --agent apollo --out build/apollo
    python scenarios/learning/record_episodes.py Retarget-v1 --perception surrogate \
        --agent nearest-safe --episodes 1000 --out build/nearest-safe

Episode i is the same as that of ``lunarsim evaluate`` with the same seed. The infos hold the cost
and the reward terms, 0 at the reset. The metadata of an episode hold its seed, steps, return, and
whether the landing was safe. Read it with ``minari.MinariDataset(FOLDER)``; the extra `data`
installs Minari.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import gymnasium
import numpy as np

from lunarsim import InputError, RandomStreams, __version__, flight_seed
from lunarsim.atomic_files import remove_contents_on_error
from lunarsim_envs.agents.agent_interface import Agent
from lunarsim_envs.agents.registry import agent_of, check
from lunarsim_envs.evaluation.episodes import EvaluationStudy
from lunarsim_envs.evaluation.request import evaluation_study

ENVS = ("Guidance-v1", "Control-v1", "Retarget-v1")


def stack_items(items: list[Any]) -> Any:
    """Stack a list of observations or actions into arrays with time as the first axis.

    Dictionaries are stacked by key.
    """
    if isinstance(items[0], dict):
        return {name: stack_items([one[name] for one in items]) for name in items[0]}
    return np.stack([np.asarray(one) for one in items])


def fly_episode(
    env: gymnasium.Env[Any, Any], agent: Agent, name: str, streams: RandomStreams
) -> dict[str, Any]:
    """Fly one episode; return its data for a Minari buffer, and its metadata.

    `name` is the agent's name in error messages; `streams` gives the random numbers.

    Raises
    ------
    InputError
        If the agent gives an action that the environment does not accept.
    """
    agent.begin(streams.get("agent"))
    seed = int(streams.get("environment").integers(2**62))
    observation, info = env.reset(seed=seed)
    shown, done, rewards, costs, terms = [observation], [], [], [0.0], []
    over, late = False, False
    while not (over or late):
        action = agent.act(observation, info)
        try:
            observation, reward, over, late, info = env.step(action)
        except ValueError as error:
            raise InputError("--agent", name, "must return valid actions", str(error)) from error
        shown.append(observation)
        done.append(action)
        rewards.append(float(reward))
        costs.append(info["cost"])
        terms.append(info["reward_terms"])
    ends = np.arange(len(done)) == len(done) - 1
    metadata = {"seed": seed, "steps": len(done), "return": sum(rewards)}
    # The landing outcome, not the reward, because the reward depends on its weights.
    metadata |= {"safe": bool(info["safe"])}
    return {
        "observations": stack_items(shown), "actions": stack_items(done),
        "rewards": np.array(rewards),
        "terminations": ends & over, "truncations": ends & late,
        "infos": {
            "cost": np.array(costs),
            "reward_terms": {
                name: np.array([0.0, *(one[name] for one in terms)]) for name in terms[0]
            },
        },
        "metadata": metadata,
    }  # fmt: skip


def record_dataset(study: EvaluationStudy, agent: str, episodes: int, folder: Path) -> int:
    """Fly episodes and write a Minari data set; return the number of safe landings.

    `study` gives the environment and the root seed.
    """
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    env = study.make()
    try:
        flies, safe = agent_of(agent, env, trust_pickle=study.trust_pickle), 0
        folder.parent.mkdir(parents=True, exist_ok=True)
        # Minari cannot reopen its files from a relative path.
        storage = MinariStorage.new(
            folder.absolute(), env.observation_space, env.action_space, data_format="hdf5"
        )
        for number in range(episodes):
            shown = fly_episode(env, flies, agent, RandomStreams(flight_seed(study.seed, number)))
            metadata = shown.pop("metadata")
            storage.update_episodes([EpisodeBuffer(id=number, **shown)])
            storage.update_episode_metadata([metadata], [number])
            safe += metadata["safe"]
        storage.update_metadata(
            {
                "dataset_id": f"lunarsim/{folder.name}-v1", "algorithm_name": agent,
                "description": f"Episodes of {study.env}", "author": {"lunarsim"},
                "lunarsim_version": __version__, "root_seed": study.seed,
                "minari_version": importlib.metadata.version("minari"),
            }
        )  # fmt: skip
    finally:
        env.close()
    return safe


@click.command()
@click.argument("env", type=click.Choice(ENVS))
@click.option(
    "--agent",
    default="random",
    show_default=True,
    help="Agent that flies the episodes: a name, a file, or a Python object module:Name, as for "
    "`lunarsim evaluate`.",
)
@click.option("--episodes", type=click.IntRange(min=1), default=100, show_default=True,
              help="Number of episodes to record.")  # fmt: skip
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option(
    "--scenario",
    type=click.Path(path_type=Path),
    help="Scenario: TOML file, or a name from `lunarsim scenario list` (default: scenario of the "
    "environment).",
)
@click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    help="Set a scenario key, for example rocks.cover=0.1. Repeat the option for several keys.",
)
@click.option(
    "--perception", help="Source of the hazard map in Retarget-v1, as for `lunarsim evaluate`."
)
@click.option(
    "--observation",
    metavar="PART",
    multiple=True,
    help="Component of the observation; repeat the option for several components (default: those "
    "of the environment).",
)
@click.option(
    "--action",
    metavar="PART",
    multiple=True,
    help="Component of the action in Retarget-v1; repeat the option for several components "
    "(default: site).",
)
@click.option(
    "--trust-pickle",
    is_flag=True,
    help="Allow an agent in a .zip file. It contains a Python pickle, which can run any code when "
    "it is loaded.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="New folder for the recorded episodes.",
)
def main(
    env: str, agent: str, trust_pickle: bool, episodes: int, seed: int, scenario: Path | None,
    changes: tuple[str, ...], out: Path, **arguments: Any,
) -> None:  # fmt: skip
    """Record EPISODES of ENV, flown by AGENT."""
    if importlib.util.find_spec("minari") is None or importlib.util.find_spec("h5py") is None:
        raise click.UsageError("The package minari or h5py is missing. Install the extra `data`.")
    try:
        if out.exists():
            raise InputError("--out", str(out), "must be a new folder")
        check(agent, trust_pickle=trust_pickle)
        given = {name: value for name, value in arguments.items() if value}
        given["split"] = "train"  # data to learn from
        flown = replace(
            evaluation_study(env, scenario, changes, seed, **given), trust_pickle=trust_pickle
        )
        with remove_contents_on_error(out):
            safe = record_dataset(flown, agent, episodes, out)
    except InputError as error:
        raise click.UsageError(str(error)) from error
    click.echo(f"{episodes} episodes, {safe} safe landings: {out}")


if __name__ == "__main__":
    main()
