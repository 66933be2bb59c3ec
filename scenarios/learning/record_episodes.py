r"""Record episodes of an environment, flown by an agent, as a data set in Minari's format.

    python scenarios/learning/record_episodes.py Guidance-v0 --agent apollo --out build/apollo
    python scenarios/learning/record_episodes.py Retarget-v0 --perception surrogate \
        --agent nearest-safe --episodes 1000 --out build/nearest-safe

Episode i flies what ``lunarsim evaluate`` flies with the same seed. Infos hold the cost and the
terms of the reward, 0 at the reset; the metadata of an episode its seed, steps, return, and whether
it landed safe. Read it with ``minari.MinariDataset(FOLDER)``; the extra `data` installs Minari.
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

from lunarsim import __version__
from lunarsim.errors import InputError
from lunarsim.rng import Streams, flight_seed
from lunarsim.whole_files import filled_whole
from lunarsim_envs.agents.contract import Agent
from lunarsim_envs.agents.registry import agent_of, check
from lunarsim_envs.evaluation.episodes import Study
from lunarsim_envs.evaluation.request import study

ENVS = ("Guidance-v0", "Control-v0", "Retarget-v0")


def stacked(shown: list[Any]) -> Any:
    """Return what was shown or done, one after another, as arrays with the time first."""
    if isinstance(shown[0], dict):
        return {name: stacked([one[name] for one in shown]) for name in shown[0]}
    return np.stack([np.asarray(one) for one in shown])


def episode(
    env: gymnasium.Env[Any, Any], flies: Agent, name: str, streams: Streams
) -> dict[str, Any]:
    """Fly an episode; return what a Minari buffer takes, and ``told``, its metadata.

    Raises
    ------
    InputError
        If the agent of that name gives an action that the environment does not take.
    """
    flies.begin(streams.get("agent"))
    seed = int(streams.get("environment").integers(2**62))
    observation, info = env.reset(seed=seed)
    shown, done, rewards, costs, terms = [observation], [], [], [0.0], []
    over, late = False, False
    while not (over or late):
        action = flies.act(observation, info)
        try:
            observation, reward, over, late, info = env.step(action)
        except ValueError as error:
            raise InputError("--agent", name, f"actions that fit ({error})") from error
        shown.append(observation)
        done.append(action)
        rewards.append(float(reward))
        costs.append(info["cost"])
        terms.append(info["reward_terms"])
    ends = np.arange(len(done)) == len(done) - 1
    told = {"seed": seed, "steps": len(done), "return": sum(rewards)}
    # By the verdict: what a landing is worth is the weights' to say.
    told |= {"safe": bool(info["safe"])}
    return {
        "observations": stacked(shown), "actions": stacked(done), "rewards": np.array(rewards),
        "terminations": ends & over, "truncations": ends & late,
        "infos": {
            "cost": np.array(costs),
            "reward_terms": {
                name: np.array([0.0, *(one[name] for one in terms)]) for name in terms[0]
            },
        },
        "told": told,
    }  # fmt: skip


def record(flown: Study, agent: str, episodes: int, folder: Path) -> int:
    """Fly episodes and write them; return how many landed safe."""
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    env = flown.make()
    try:
        flies, safe = agent_of(agent, env, trust_pickle=flown.trust_pickle), 0
        folder.parent.mkdir(parents=True, exist_ok=True)
        # Minari does not find its own files again by a relative path.
        storage = MinariStorage.new(
            folder.absolute(), env.observation_space, env.action_space, data_format="hdf5"
        )
        for number in range(episodes):
            shown = episode(env, flies, agent, Streams(flight_seed(flown.seed, number)))
            told = shown.pop("told")
            storage.update_episodes([EpisodeBuffer(id=number, **shown)])
            storage.update_episode_metadata([told], [number])
            safe += told["safe"]
        storage.update_metadata(
            {
                "dataset_id": f"lunarsim/{folder.name}-v0", "algorithm_name": agent,
                "description": f"Episodes of {flown.env}", "author": {"lunarsim"},
                "lunarsim_version": __version__, "root_seed": flown.seed,
                "minari_version": importlib.metadata.version("minari"),
            }
        )  # fmt: skip
    finally:
        env.close()
    return safe


@click.command()
@click.argument("env", type=click.Choice(ENVS))
@click.option("--agent", default="random", show_default=True, help="Name, file or module:Name.")
@click.option("--episodes", type=click.IntRange(min=1), default=100, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed.")
@click.option(
    "--scenario",
    type=click.Path(path_type=Path),
    help="File or name; left out: as the environment has it.",
)
@click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    help="Change an entry of the scenario, as rocks.cover=0.1; again for more.",
)
@click.option("--perception", help="Of Retarget-v0.")
@click.option(
    "--observation",
    metavar="PART",
    multiple=True,
    help="Part of what is shown, again for more; left out: the usual ones.",
)
@click.option(
    "--action",
    metavar="PART",
    multiple=True,
    help="Part of what Retarget-v0 decides on, again for more; left out: the site.",
)
@click.option("--trust-pickle", is_flag=True, help="Read agents in .zip files; they can run code.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="A new folder.")
def main(
    env: str, agent: str, trust_pickle: bool, episodes: int, seed: int, scenario: Path | None,
    changes: tuple[str, ...], out: Path, **arguments: Any,
) -> None:  # fmt: skip
    """Record EPISODES of ENV, flown by AGENT."""
    if importlib.util.find_spec("minari") is None or importlib.util.find_spec("h5py") is None:
        raise click.UsageError("minari or h5py is missing: the extra `data` installs them")
    try:
        if out.exists():
            raise InputError("--out", str(out), "a folder that is not there yet")
        check(agent, trust_pickle=trust_pickle)
        given = {name: value for name, value in arguments.items() if value}
        flown = replace(study(env, scenario, changes, seed, **given), trust_pickle=trust_pickle)
        with filled_whole(out):
            safe = record(flown, agent, episodes, out)
    except InputError as error:
        raise click.UsageError(str(error)) from error
    click.echo(f"{episodes} episodes, {safe} landed safe: {out}")


if __name__ == "__main__":
    main()
