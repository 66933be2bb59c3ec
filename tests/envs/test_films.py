"""Flights as films and in a window."""

from __future__ import annotations

import cv2
import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import pytest

import lunarsim_envs
from lunarsim.errors import InputError
from lunarsim_envs.video import RecordVideos

assert lunarsim_envs.__name__

RETARGET = {"perception": "truth", "worlds": 1}


def flown(env, seed, steps=10_000):
    """Fly a flight, or some steps of it, and return the frames that it renders."""
    env.reset(seed=seed)
    frames, ended = [env.render()], False
    while not ended and len(frames) <= steps:
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        ended = terminated or truncated
        frames.append(env.render())
    return frames


def read(path):
    film, frames = cv2.VideoCapture(str(path)), []
    fps = film.get(cv2.CAP_PROP_FPS)
    while True:
        there, frame = film.read()
        if not there:
            return fps, frames
        frames.append(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))


@pytest.mark.parametrize(("name", "more"), [("Retarget-v1", RETARGET), ("Guidance-v1", {})])
def test_a_film_shows_what_is_rendered_at_its_pace(name, more, tmp_path):
    env = gymnasium.make(f"lunarsim/{name}", render_mode="rgb_array", **more)
    env.action_space.seed(1)
    # A short flight to its end, and the beginning of a long one.
    steps = 10_000 if name == "Retarget-v1" else 12
    plain = flown(env, 3, steps)
    env.action_space.seed(1)
    filmed = RecordVideos(env, tmp_path / "films", prefix="a")
    flown(filmed, 3, steps)
    if name == "Guidance-v1":
        filmed.close()
    fps, frames = read(tmp_path / "films" / "a-episode-0.mp4")
    assert fps == env.metadata["render_fps"]
    assert len(frames) == len(plain) > 5
    for one, other in zip(frames, plain, strict=True):
        # Coded with some loss.
        assert np.abs(one.astype(int) - other).mean() < 6.0
    assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 1.0


def test_films_are_of_the_flights_that_are_wanted_and_of_broken_off_ones(tmp_path):
    env = gymnasium.make("lunarsim/Guidance-v1", render_mode="rgb_array")
    env = RecordVideos(env, tmp_path, wanted=lambda flight: flight != 1, fps=4)
    flown(env, 1, steps=4)
    flown(env, 2, steps=4)
    flown(env, 3, steps=2)
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "film-episode-0.mp4", "film-episode-2.mp4",
    ]  # fmt: skip
    assert len(read(tmp_path / "film-episode-0.mp4")[1]) == 5
    fps, frames = read(tmp_path / "film-episode-2.mp4")
    assert fps == 4 and len(frames) == 3


def test_what_renders_nothing_is_not_filmed(tmp_path):
    with pytest.raises(InputError, match="render_mode"):
        RecordVideos(gymnasium.make("lunarsim/Guidance-v1"), tmp_path)


@pytest.mark.parametrize("name", ["Retarget-v1", "Guidance-v1"])
def test_without_a_screen_it_is_reported(name, monkeypatch):
    monkeypatch.setattr("matplotlib.pyplot.get_backend", lambda: "agg")
    more = RETARGET if name == "Retarget-v1" else {}
    with pytest.raises(InputError, match="needs a display"):
        gymnasium.make(f"lunarsim/{name}", render_mode="human", **more)
    monkeypatch.setenv("DISPLAY", ":0")
    env = gymnasium.make(f"lunarsim/{name}", render_mode="rgb_array", **more)
    assert "human" not in env.unwrapped.metadata["render_modes"]


@pytest.mark.parametrize("name", ["Retarget-v1", "Guidance-v1"])
def test_a_window_shows_every_frame(name, monkeypatch, recwarn):
    """Drawn by a canvas without a window: what it holds are the frames, pixel by pixel."""
    monkeypatch.setattr("matplotlib.pyplot.get_backend", lambda: "tkagg")
    monkeypatch.setattr("matplotlib.figure.Figure.show", lambda *_: None)
    monkeypatch.setenv("DISPLAY", ":0")
    more = RETARGET if name == "Retarget-v1" else {}
    plain = gymnasium.make(f"lunarsim/{name}", render_mode="rgb_array", **more)
    env = gymnasium.make(f"lunarsim/{name}", render_mode="human", **more)
    for one in (plain, env):
        one.reset(seed=4)
    action = np.int64(0) if name == "Retarget-v1" else np.zeros(3, np.float32)
    for _ in range(3):
        shown = np.asarray(plt.figure("lunarsim").canvas.buffer_rgba())[:, :, :3]
        assert np.array_equal(shown, plain.render())
        assert env.render() is None
        for one in (plain, env):
            one.step(action)
    env.close()
    assert not plt.fignum_exists("lunarsim")
    assert not [one for one in recwarn if "human" in str(one.message)]
