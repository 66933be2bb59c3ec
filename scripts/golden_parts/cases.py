"""Golden cases: each computes results with a fixed seed and returns their digests.

The cases use only the command line and the registered environments, so that they also run with
older revisions. As a program, the module takes the name of a case and a JSON file to write.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from golden_parts.digests import digest, digests_of_folder
from golden_parts.names import SCENARIOS

Digests = dict[str, list[str]]

_CAMPAIGN = """
name = "golden"
scenario = "golombek.toml"
flights = 4
seed = 5

[[arms]]
name = "no-divert"
set = { policy = "no-divert" }

[[arms]]
name = "safest"
set = { policy = "safest" }
"""


def _lunarsim(folder: Path, *arguments: str) -> None:
    """Run the command `lunarsim` with arguments in a working folder."""
    subprocess.run([sys.executable, "-m", "lunarsim", *arguments], check=True, cwd=folder)


def _source() -> Path:
    """Return the repository folder from which lunarsim is imported."""
    import lunarsim

    return Path(lunarsim.__file__).parent.parent


def fly(scenario: str, *arguments: str) -> Digests:
    """Fly a supplied scenario with the policy `safest`; return digests of the results.

    `arguments` are options of `lunarsim fly`; ``--policy`` replaces the policy.
    """
    older = {new: old for old, new in SCENARIOS.items()}
    if not (_source() / "scenarios" / f"{scenario}.toml").is_file():
        scenario = older.get(scenario, scenario)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        policy = () if "--policy" in arguments else ("--policy", "safest")
        _lunarsim(folder, "fly", scenario, *policy, *arguments, "--out", "flight")
        return digests_of_folder(folder / "flight", _source())


def true_maps(scenario: str) -> Digests:
    """Compute the true safety map of a supplied scenario; return its digests."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _lunarsim(folder, "terrain", "truth", scenario, "--size", "40", "--out", "truth.nc")
        return digests_of_folder(folder, _source())


def campaign() -> Digests:
    """Run a small campaign, export its results, write its report; return digests."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _lunarsim(folder, "scenario", "new", "golombek")
        (folder / "golden.toml").write_text(_CAMPAIGN, encoding="utf-8")
        _lunarsim(folder, "campaign", "run", "golden.toml", "--out", "run", "--jobs", "1")
        (folder / "results").mkdir()
        _lunarsim(folder, "campaign", "export", "run", "--out", "results/rows.csv")
        _lunarsim(folder, "campaign", "report", "run", "--out", "results/report.md")
        return digests_of_folder(folder / "results", _source())


def steps(environment: str, count: int, lanes: int = 0, **arguments: Any) -> Digests:
    """Step an environment with random actions; return digests of its outputs.

    `count` is the number of steps; `lanes` is the number of parallel environments (0: a single
    environment), and `arguments` are those of the environment. The digests are of observations,
    rewards and ends.
    """
    import gymnasium
    import numpy as np

    env: Any
    if lanes:
        env = gymnasium.make_vec(
            f"lunarsim_envs:{environment}",
            lanes,
            vectorization_mode="vector_entry_point",
            **arguments,
        )
    else:
        env = gymnasium.make(f"lunarsim_envs:{environment}", **arguments)
    observation, _ = env.reset(seed=11)
    env.action_space.seed(12)
    observations, rewards, ends = [_flat(observation)], [], []
    for _ in range(count):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        observations.append(_flat(observation))
        rewards.append(np.asarray(reward, np.float64))
        ends.append(np.asarray([terminated, truncated]))
        if not lanes and (terminated or truncated):
            observation, _ = env.reset()
    env.close()
    series = {"observations": observations, "rewards": rewards, "ends": ends}
    return {name: digest(np.array(values)) for name, values in series.items()}


def _flat(observation: Any) -> Any:
    """Flatten an observation (array, dict or tuple) into one array."""
    import numpy as np

    if isinstance(observation, dict):
        observation = [observation[key] for key in sorted(observation)]
    if isinstance(observation, (list, tuple)):
        return np.concatenate([np.ravel(_flat(part)).astype(np.float64) for part in observation])
    return np.asarray(observation)


# The first two compile most of the kernels.
CASES: dict[str, Callable[[], Digests]] = {
    "steps of Retarget-v1, batch": partial(steps, "lunarsim/Retarget-v1", 200, 8),
    "fly hirise": partial(fly, "hirise"),
    "steps of Guidance-v1": partial(steps, "lunarsim/Guidance-v1", 1000),
    "steps of Guidance-v1, batch": partial(steps, "lunarsim/Guidance-v1", 1000, 8),
    "steps of Control-v1": partial(steps, "lunarsim/Control-v1", 1000),
    "steps of Control-v1, batch": partial(steps, "lunarsim/Control-v1", 1000, 8),
    "fly golombek": partial(fly, "golombek"),
    "fly hard": partial(fly, "hard"),
    "optimal path": partial(fly, "golombek", "--guidance", "optimal", "--policy", "no-divert"),
    "steps of Retarget-v1": partial(steps, "lunarsim/Retarget-v1", 40, perception="onboard"),
    "true maps of golombek": partial(true_maps, "golombek"),
    "true maps of hirise": partial(true_maps, "hirise"),
}
COMPLETE: dict[str, Callable[[], Digests]] = CASES | {
    "fly shadow_nominal": partial(fly, "shadow_nominal"),
    "fly shadow_modified": partial(fly, "shadow_modified"),
    "fly morpheus": partial(fly, "morpheus"),
    "fly camera_and_lidar": partial(fly, "camera_and_lidar"),
    "fly all_sensors_hard": partial(fly, "all_sensors_hard"),
    "fly instruments": partial(fly, "instruments"),
    "campaign and report": campaign,
}


def main(name: str, out: str) -> None:
    """Run the golden case `name` and write its digests to the JSON file `out`."""
    Path(out).write_text(json.dumps(COMPLETE[name]()), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
