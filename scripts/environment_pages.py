"""Prints the page of environments: `python scripts/environment_pages.py > docs/environments.md`."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

import gymnasium
from gymnasium.envs.registration import EnvSpec, load_env_creator

import lunarsim_envs

HEAD = """# Environments

Made by `python scripts/environment_pages.py > docs/environments.md` from what each environment says
of itself. `lunarsim_envs` registers them in [Gymnasium](https://gymnasium.farama.org) when it is
imported, and `make` imports what stands before the colon:

```python
import gymnasium

env = gymnasium.make("lunarsim_envs:lunarsim/Retarget-v0")
observation, info = env.reset(seed=1)
observation, reward, terminated, truncated, info = env.step(0)
```

![A flight of Retarget-v0: chase view, camera, gauges, path, hazard map](images/retarget.gif)

`views=True` draws such frames (`python scripts/environment_film.py docs/images/retarget.gif` makes
this film); the ground ends where the world that was drawn does. `render_mode="human"` shows frames
in a window where there is a screen; `RecordFilm` writes flights as films. Gymnasium's own
`RecordVideo` does so too, with MoviePy, which names an older Pillow but works with this one:
`pip install --no-deps moviepy imageio imageio-ffmpeg proglog tqdm decorator python-dotenv`.

```python
import gymnasium
from lunarsim_envs.video import RecordFilm

env = gymnasium.make("lunarsim/Retarget-v0", render_mode="rgb_array", perception="truth")
env = RecordFilm(env, "out/films")
observation, info = env.reset(seed=1)
over = False
while not over:
    observation, reward, terminated, truncated, info = env.step(0)
    over = terminated or truncated
```

The films are coded as MPEG-4 Part 2, which OpenCV writes without further libraries; players play
it, many browsers do not.

Thousands of descents fly in one kernel:

```python
import gymnasium

vector = gymnasium.make_vec(
    "lunarsim_envs:lunarsim/Guidance-v0", num_envs=64, vectorization_mode="vector_entry_point"
)
observations, info = vector.reset(seed=1)
observations, rewards, terminated, truncated, info = vector.step(vector.action_space.sample())
```

`python scripts/bench.py envs`, two cores, random actions, new flights
included, physics at 100 Hz; Gymnasium's LunarLander-v3 25,300 steps a second, PyFlyt's
Rocket-Landing-v4 570:

| | steps a second | simulated seconds a second |
| --- | --- | --- |
| `Guidance-v0`, one | 6,500, 11.3 of Rocket-Landing | 1,300 |
| `Guidance-v0`, 4096 lanes | 1,130,000, 44.9 of LunarLander | 227,000 |
| `Control-v0`, one | 7,100, 12.3 of Rocket-Landing | 140 |
| `Control-v0`, 4096 lanes | 1,760,000, 69.8 of LunarLander | 35,000 |
| `Retarget-v0`, truth, one | 1,700 a core | |
| `Retarget-v0`, surrogate, one | 1,030 a core | |
| `Retarget-v0`, surrogate, 64 lanes | 4,890 | |
| `Retarget-v0`, gaussian-dem, two maps a flight | 14 a core, 36 with cells of 0.4 m | |
| `Retarget-v0`, onboard | 4.5 a core | |

A step of `Guidance-v0` is twenty of the integration, each with the attitude loop about it.

## Recordings

`python scenarios/learning/record_episodes.py Guidance-v0 --agent apollo --out build/apollo` records
episodes in [Minari](https://minari.farama.org)'s format (`pip install "lunarsim[data]"`), which
`minari.MinariDataset("build/apollo")` reads.

## Agents

`lunarsim evaluate` flies agents over the same episodes and compares them, flight by flight:

```sh
lunarsim evaluate Guidance-v0 --agent random --agent apollo --agent e-guidance --episodes 100
lunarsim evaluate Retarget-v0 --scenario hirise --agent no-divert --agent safest --episodes 20
lunarsim evaluate Retarget-v0 --perception quadtree --agent nearest-safe --episodes 5
lunarsim evaluate Retarget-v0 --observation candidates --observation site --agent trained.npz
lunarsim evaluate Guidance-v0 --agent own_agents:Careful --set start.velocity_sigma_m_s=10
```

An agent of one's own is a function of observation and info, or a class that is built with the
environment and called so; one with `begin(rng)` is told of every flight, and draws from that
generator alone:

```python
import numpy as np


class Careful:
    def __init__(self, env):
        self.actions = env.unwrapped.descents.actions

    def begin(self, rng):
        self.rng = rng

    def __call__(self, observation, info):
        return self.actions.action([0.0, 0.0, 1.622 - 0.3 * (observation[5] + 2.0)])
```

Policies are shown what the onboard computer shows them and fly what the simulation flies with them,
bit for bit; laws of guidance are asked five times a second, on the true state. A site that is none
of the rows of `Retarget-v0`, and giving up the landing, are no actions there.

`python scenarios/learning/train_guidance.py --out out/ppo` trains an agent of `Guidance-v0` by
proximal policy optimisation (`pip install "lunarsim[rl]"`; PyTorch without CUDA is at
`--index-url https://download.pytorch.org/whl/cpu`): no law of guidance inside the action, starts at
shares of the way for some lanes, a checkpoint and a look at unseen seeds every few updates. Broken
off and called again it goes on, bit for bit. `agent.npz` in its folder is flown by NumPy alone,
`checkpoint/model.zip` by Stable-Baselines3. Networks of any framework fly as
[ONNX files](learning.md#networks-of-other-frameworks). RLlib pins an older Gymnasium and is left
out; MaskablePPO of sb3-contrib takes `Retarget-v0` as it is, through `action_masks()`.
"""


def environments() -> Iterator[EnvSpec]:
    """Yield what is registered in the namespace of the package, by name."""
    assert lunarsim_envs.__name__
    for name, spec in sorted(gymnasium.registry.items()):
        if name.startswith("lunarsim/"):
            yield spec


def section(spec: EnvSpec) -> str:
    """Return the docstring of an environment under its name, its headings one level lower."""
    assert spec.entry_point is not None
    maker = spec.entry_point
    said = inspect.getdoc(load_env_creator(maker) if isinstance(maker, str) else maker) or ""
    return f"## {spec.id}\n\n{re.sub('^## ', '### ', said, flags=re.MULTILINE)}\n"


def page() -> str:
    """Return the page as Markdown."""
    return "\n".join([HEAD, *map(section, environments())])


if __name__ == "__main__":
    print(page(), end="")
