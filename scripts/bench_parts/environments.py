"""Measure the speed of the environments and of other common environments."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numba
import numpy as np

import lunarsim_envs

# The other packages have their own virtual environment, because one requires an older NumPy.
_PEERS = Path(__file__).parents[2] / "out" / "bench" / "peers"
_PACKAGES = ("gymnasium[box2d]", "PyFlyt", "setuptools<81")
_SECONDS = 3.0
_PEER = """
import sys, time
import gymnasium
name, seconds = sys.argv[1], float(sys.argv[2])
if name.startswith("PyFlyt"):
    import PyFlyt.gym_envs
env = gymnasium.make(name)
env.reset(seed=1)
env.action_space.seed(1)
steps, begun = 0, time.perf_counter()
while time.perf_counter() - begun < seconds:
    *_, terminated, truncated, _ = env.step(env.action_space.sample())
    steps += 1
    if terminated or truncated:
        env.reset()
print("steps", steps / (time.perf_counter() - begun))
"""


def _peer(name: str) -> float:
    """Measure the steps per second of another project's environment; NaN if missing."""
    python = _PEERS / "bin" / "python"
    if not python.exists():
        print(f"  creating {_PEERS} for {', '.join(_PACKAGES)}", flush=True)
        subprocess.run([sys.executable, "-m", "venv", str(_PEERS)], check=True)
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", *_PACKAGES], check=False)
    done = subprocess.run(
        [str(python), "-c", _PEER, name, str(_SECONDS)], capture_output=True, text=True, check=False
    )
    values = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("steps ")]
    if not values:
        print(f"  {name} is not available: {done.stderr.strip().splitlines()[-1:]}")
        return float("nan")
    return float(values[0])


def _single(name: str, clock: Callable[[], float] = time.perf_counter, **settings: Any) -> float:
    """Measure the steps per second of an environment, random actions and resets.

    `clock` measures the time, s; `settings` are arguments of the environment.
    """
    env = gymnasium.make(name, **settings)
    env.reset(seed=1)
    env.action_space.seed(1)
    steps, start_s = -500, clock()
    while clock() - start_s < _SECONDS or steps < 1:
        if steps == 0:
            start_s = clock()
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        steps += 1
        if terminated or truncated:
            env.reset()
    return steps / (clock() - start_s)


def _retarget() -> None:
    """Print decisions per second of Retarget-v1 and time per map, by perception.

    One thread and processor time, so that other work on the machine has no effect.
    """
    name, threads = "lunarsim/Retarget-v1", numba.get_num_threads()
    numba.set_num_threads(1)
    coarse = {"mappers.dem.posting_m": 0.4}
    for words, wanted, settings in (
        ("truth", 1000, {"perception": "truth"}),
        ("surrogate", 1000, {"perception": "surrogate"}),
        ("gaussian-dem", 100, {"perception": "gaussian-dem"}),
        ("gaussian-dem, cells of 0.4 m", 100, {"perception": "gaussian-dem", "changes": coarse}),
        ("onboard", None, {"perception": "onboard"}),
    ):
        given: dict[str, Any] = {"worlds": 8} | settings
        env = gymnasium.make(name, **given)
        rate = _single(name, time.process_time, **given)
        asked = "" if wanted is None else f" (target: {wanted})"
        print(f"  {name}, {words}: {rate:,.1f} steps/s per core{asked}{_map_time(env)}")
    numba.set_num_threads(threads)
    for count in (16, 64):
        many = _retarget_batch(count)
        print(f"  {name}, surrogate, batch of {count} on {threads} threads: {many:,.0f} steps/s")


def _map_time(env: gymnasium.Env[Any, Any]) -> str:
    """Return the median time of a hazard map as text, ms.

    The text is empty if the environment does not simulate its flights in compiled kernels.
    """
    lanes = getattr(env.unwrapped.flight, "lanes", None)  # type: ignore[attr-defined]
    if lanes is None:
        return ""
    taken: list[float] = []
    scan = lanes.scan

    def timed(due: Any) -> None:
        start_s = time.process_time()
        scan(due)
        taken.append(time.process_time() - start_s)

    lanes.scan = timed
    for seed in range(4):
        env.reset(seed=seed)
        over = False
        while not over:
            *_, ended, late, _ = env.step(0)
            over = ended or late
    return f", {1e3 * float(np.median(taken[2:])):.1f} ms per map"


def _retarget_batch(count: int) -> float:
    """Measure decisions per second of `count` parallel Retarget-v1, with resets."""
    vector = gymnasium.make_vec(
        "lunarsim/Retarget-v1", num_envs=count, vectorization_mode="vector_entry_point", worlds=8
    )
    vector.reset(seed=1)
    keep = np.zeros(count, int)
    for _ in range(4):
        vector.step(keep)
    steps, start_s = 0, time.perf_counter()
    while time.perf_counter() - start_s < _SECONDS:
        vector.step(keep)
        steps += 1
    return steps * count / (time.perf_counter() - start_s)


def _batch(name: str, count: int) -> float:
    """Measure steps per second of `count` parallel environments, including resets."""
    vector = gymnasium.make_vec(name, num_envs=count, vectorization_mode="vector_entry_point")
    vector.reset(seed=1)
    rng = np.random.default_rng(1)
    some = [rng.uniform(-0.3, 0.5, vector.action_space.shape).astype(np.float32) for _ in range(16)]
    for action in some:
        vector.step(action)
    steps, start_s = 0, time.perf_counter()
    while time.perf_counter() - start_s < _SECONDS:
        vector.step(some[steps % 16])
        steps += 1
    return steps * count / (time.perf_counter() - start_s)


def envs() -> None:
    """Measure steps per second of the environments, relative to PyFlyt and Gymnasium."""
    assert lunarsim_envs.__name__
    lander, rocket = _peer("LunarLander-v3"), _peer("PyFlyt/Rocket-Landing-v4")
    print(f"  LunarLander-v3 {lander:,.0f} steps/s, PyFlyt/Rocket-Landing-v4 {rocket:,.0f} steps/s")
    for level, rate, wanted in (("Guidance", 5.0, 30), ("Control", 50.0, 60)):
        name = f"lunarsim/{level}-v1"
        one = _single(name)
        print(
            f"  {name}, one: {one:,.0f} steps/s, {one / rocket:.1f} of Rocket-Landing"
            f"{' (target: 10)' if level == 'Guidance' else ''}"
        )
        for count in (256, 4096):
            many = _batch(name, count)
            print(
                f"  {name}, batch of {count} on {numba.get_num_threads()} threads: {many:,.0f} "
                f"steps/s, {many / lander:.1f} times LunarLander (target: {wanted}), "
                f"{many / rate:,.0f} simulated s/s"
            )
    _retarget()
    again = _peer("LunarLander-v3")
    print(f"  LunarLander-v3 repeated: {again:,.0f} steps/s")
