"""Make the film of `Retarget-v1`: `environment_film.py docs/images/retarget.gif`."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import gymnasium
import numpy as np

import lunarsim_envs
from lunarsim_envs.agents.registry import agent_of
from lunarsim_envs.video import save_video

# Frame size, pixels; seed of the flight; number of repetitions of the last frame.
_SIZE, _SEED, _HOLD = (400, 360), 3, 5


def main() -> None:
    """Fly one episode of `Retarget-v1` and write a GIF with a frame every 2 s."""
    assert lunarsim_envs.__name__
    env = gymnasium.make(
        "lunarsim/Retarget-v1",
        perception="onboard",
        scenario="golombek",
        render_mode="rgb_array_list",
        views=True,
    )
    flies = agent_of("fuel-aware", env)
    flies.begin(np.random.default_rng(_SEED))
    observation, info = env.reset(seed=_SEED)
    frames, over = list(env.render()), False  # type: ignore[call-overload]
    while not over:
        observation, _, ended, late, info = env.step(flies.act(observation, info))
        over = ended or late
        frames += env.render()  # type: ignore[arg-type]
    env.close()
    chosen = [*frames[:-1:4], *frames[-1:] * _HOLD]
    small = [cv2.resize(frame, _SIZE, interpolation=cv2.INTER_AREA) for frame in chosen]
    save_video(small, Path(sys.argv[1]), 3.0)


if __name__ == "__main__":
    main()
