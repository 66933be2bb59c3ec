"""Environments beside those that people learn in today."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import numba
import numpy as np

import lunarsim_envs

# Peers have an environment of their own: one of them wants an older NumPy.
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
    """Return steps a second of a peer under random actions, resets included; NaN where it lacks."""
    python = _PEERS / "bin" / "python"
    if not python.exists():
        print(f"  making {_PEERS} for the peers: {', '.join(_PACKAGES)}", flush=True)
        subprocess.run([sys.executable, "-m", "venv", str(_PEERS)], check=True)
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", *_PACKAGES], check=False)
    done = subprocess.run(
        [str(python), "-c", _PEER, name, str(_SECONDS)], capture_output=True, text=True, check=False
    )
    told = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("steps ")]
    if not told:
        print(f"  {name} is missing: {done.stderr.strip().splitlines()[-1:]}")
        return float("nan")
    return float(told[0])


def _single(name: str) -> float:
    """Return steps a second of one environment under random actions, resets included."""
    env = gymnasium.make(name)
    env.reset(seed=1)
    env.action_space.seed(1)
    steps, begun = -500, time.perf_counter()
    while time.perf_counter() - begun < _SECONDS or steps < 1:
        if steps == 0:
            begun = time.perf_counter()
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        steps += 1
        if terminated or truncated:
            env.reset()
    return steps / (time.perf_counter() - begun)


def _batch(name: str, count: int) -> float:
    """Return steps a second of all lanes of a batch together, new flights included."""
    vector = gymnasium.make_vec(name, num_envs=count, vectorization_mode="vector_entry_point")
    vector.reset(seed=1)
    rng = np.random.default_rng(1)
    some = [rng.uniform(-0.3, 0.5, vector.action_space.shape).astype(np.float32) for _ in range(16)]
    for action in some:
        vector.step(action)
    steps, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < _SECONDS:
        vector.step(some[steps % 16])
        steps += 1
    return steps * count / (time.perf_counter() - begun)


def envs() -> None:
    """Steps a second beside PyFlyt's and Gymnasium's, and simulated seconds a second."""
    assert lunarsim_envs.__name__
    lander, rocket = _peer("LunarLander-v3"), _peer("PyFlyt/Rocket-Landing-v4")
    print(f"  LunarLander-v3 {lander:,.0f} steps/s, PyFlyt/Rocket-Landing-v4 {rocket:,.0f} steps/s")
    for level, rate, wanted in (("Guidance", 5.0, 30), ("Control", 50.0, 60)):
        name = f"lunarsim/{level}-v0"
        one = _single(name)
        print(
            f"  {name}, one: {one:,.0f} steps/s, {one / rocket:.1f} of Rocket-Landing"
            f"{' (asked: 10)' if level == 'Guidance' else ''}"
        )
        for count in (256, 4096):
            many = _batch(name, count)
            print(
                f"  {name}, {count} lanes on {numba.get_num_threads()} threads: {many:,.0f} "
                f"steps/s, {many / lander:.1f} of LunarLander (asked: {wanted}), "
                f"{many / rate:,.0f} simulated s/s"
            )
    again = _peer("LunarLander-v3")
    print(f"  LunarLander-v3 once more: {again:,.0f} steps/s")
