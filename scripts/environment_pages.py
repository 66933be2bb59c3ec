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

Thousands of descents fly in one kernel:

```python
import gymnasium

vector = gymnasium.make_vec(
    "lunarsim_envs:lunarsim/Guidance-v0", num_envs=64, vectorization_mode="vector_entry_point"
)
observations, info = vector.reset(seed=1)
observations, rewards, terminated, truncated, info = vector.step(vector.action_space.sample())
```

`python scripts/bench.py envs`, two cores with other work beside it, random actions, new flights
included, physics at 100 Hz; Gymnasium's LunarLander-v3 33,500 steps a second, PyFlyt's
Rocket-Landing-v4 1,010:

| | steps a second | simulated seconds a second |
| --- | --- | --- |
| `Guidance-v0`, one | 12,900, 12.7 of Rocket-Landing | 2,600 |
| `Guidance-v0`, 4096 lanes | 336,000, 10 of LunarLander | 67,000 |
| `Control-v0`, one | 14,400, 14.2 of Rocket-Landing | 290 |
| `Control-v0`, 4096 lanes | 2,710,000, 81 of LunarLander | 54,000 |

A step of `Guidance-v0` is twenty of the integration, each with the attitude loop about it.
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
