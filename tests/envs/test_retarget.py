from __future__ import annotations

import runpy
import time
import warnings
from dataclasses import replace

import cv2
import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner
from gymnasium.utils.env_checker import check_env
from PIL import Image, ImageSequence

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim_envs.frame_renderer import FrameRenderer
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.video import save_video
from tests.worlds import SCENARIOS, TINY_FLIGHT

ID = "lunarsim_envs:lunarsim/Retarget-v1"


@pytest.fixture
def env(small_scenario):
    return gymnasium.make(
        ID, perception="onboard", scenario=small_scenario, render_mode="rgb_array"
    )


def test_check_env_without_a_warning(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)


def test_default_scenario_is_made_without_files():
    assert gymnasium.make(ID, perception="onboard").unwrapped.scenario.name == "golombek"


def test_one_decision_a_second_between_400_and_50_m(env):
    _, info = env.reset(seed=1)
    simulation = env.unwrapped.simulation
    assert simulation.altitude <= 400.0
    times, altitudes, ended = [info["time"]], [simulation.altitude], False
    while not ended:
        observation, reward, ended, truncated, info = env.step(0)
        assert not truncated
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
        if not ended:
            times.append(info["time"])
            altitudes.append(simulation.altitude)
    assert np.allclose(np.diff(times), 1.0, atol=1e-6)
    assert min(altitudes) >= 50.0
    assert info["reward_terms"]["touchdown"] == (1.0 if info["safe"] else -1.0)
    assert simulation.done


def test_masks_of_actions_are_those_of_info(env):
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.unwrapped.action_masks()
    _, info = env.reset(seed=1)
    masks = env.unwrapped.action_masks()
    assert masks.dtype == bool and masks.tolist() == (info["action_mask"] == 1).tolist()


def test_choosing_a_site_moves_the_target(env):
    observation, info = env.reset(seed=1)
    while not info["action_mask"][1:].any():
        observation, _, _, _, info = env.step(0)
    simulation = env.unwrapped.simulation
    action = int(np.flatnonzero(info["action_mask"])[1])
    wanted = simulation.site + observation["sites"][action - 1, :3]
    env.step(action)
    assert np.allclose(simulation.site, wanted, atol=1e-2)


def test_unavailable_sites_cost_and_keep(env):
    observation, info = env.reset(seed=1)
    action = int(np.flatnonzero(info["action_mask"] == 0)[0])
    site = env.unwrapped.simulation.site.copy()
    _, _, _, _, info = env.step(action)
    assert info["reward_terms"]["invalid"] < 0.0
    assert np.array_equal(env.unwrapped.simulation.site, site)


def test_same_seed_same_episode(env):
    def episode():
        observation, _ = env.reset(seed=11)
        out, ended = [observation["hazard_map"].sum()], False
        while not ended:
            observation, reward, ended, _, _ = env.step(0)
            out += [reward, observation["hazard_map"].sum()]
        return out

    assert episode() == episode()


def test_rendering(env):
    env.reset(seed=1)
    frame = env.render()
    assert frame.shape == (360, 800, 3)
    assert frame.dtype == np.uint8
    assert frame.std() > 10.0


def test_frames_keep_their_axes_and_show_action_reward_and_the_last_metres(env):
    env.reset(seed=1)
    frames, seconds, ended = [env.render()], [], False
    while not ended:
        *_, ended, _, _ = env.step(0)
        begun = time.process_time()
        frames.append(env.render())
        seconds.append(time.process_time() - begun)
    first, second, last = frames[0], frames[1], frames[-1]
    ticks = np.s_[316:, 55:240]  # numbers and name of the axis below the descent
    assert all(np.array_equal(frame[ticks], first[ticks]) for frame in frames)
    title = np.s_[:24]
    assert not np.array_equal(first[title], second[title])
    assert (second[title] < 128).sum() > (first[title] < 128).sum()
    close = np.s_[52:300, 312:448]  # within the axes of the last 60 m: nothing before, a path then
    assert np.array_equal(first[close], second[close])
    assert not np.array_equal(first[close], last[close])
    assert min(seconds) < 0.05


def test_frames_have_lander_and_site_where_they_are_believed_to_be(env):
    _, info = env.reset(seed=1)
    env.render()
    first, moved, ended = env.unwrapped.frames.target, 0.0, False
    while not ended:
        action = int(np.flatnonzero(info["action_mask"])[-1])
        _, _, ended, _, info = env.step(action)
        env.render()
        simulation, frames = env.unwrapped.simulation, env.unwrapped.frames
        rows, site = simulation.recorder.trajectory(), simulation.site
        east, north, up = (rows[f"estimated_{a}"][-1] - site[k] for k, a in enumerate("xyz"))
        assert frames.target == pytest.approx(site[:2])
        assert frames.place == pytest.approx((np.hypot(east, north), up))
        moved = max(moved, np.hypot(*np.subtract(first, site[:2])))
    assert moved > 3.0


def test_the_first_frame_of_a_flight_takes_no_longer_than_others(env):
    seconds = []
    for seed in (1, 2, 3):
        env.reset(seed=seed)
        begun = time.process_time()
        env.render()
        seconds.append(time.process_time() - begun)
    assert min(seconds) < 0.05


def test_a_film_holds_nothing_of_the_flight_before(small_scenario, monkeypatch):
    env = gymnasium.make(
        ID, perception="onboard", scenario=small_scenario, render_mode="rgb_array_list"
    )
    drawn, draw = [], FrameRenderer.draw
    monkeypatch.setattr(FrameRenderer, "draw", lambda *a: drawn.append(a[0].simulation) or draw(*a))
    for seed in (1, 2):
        env.reset(seed=seed)
        assert len(env.render()) == 1
    assert len(drawn) == 2
    assert drawn[1] is env.unwrapped.simulation


def test_frames_say_of_a_map_that_reports_nothing_what_it_is(env):
    env.reset(seed=1)
    observation = env.unwrapped.simulation.observe()
    frames, drawn = FrameRenderer(env.unwrapped.simulation, observation), []
    m = observation.hazard_map
    for observed, p, words in (
        (False, 0.9, "Map observed nothing"),
        (True, 0.9, "Map classifies all observed terrain safe"),
        (True, 0.2, "Map classifies no observed terrain safe"),
    ):
        flat = np.full(m.grid.shape, np.float32(p))
        told = replace(m, p_safe=flat, observed=np.full(m.grid.shape, observed), in_domain=None)
        picture = frames.draw(replace(observation, hazard_map=told), None, None)
        drawn.append(picture[24:70, 480:])
        assert frames.map_title == words
    assert not np.array_equal(drawn[1], drawn[2])
    assert all((one[:4] > 200).all() and (one < 128).any() for one in drawn)  # whole, and there


def test_frames_say_what_the_reward_was_and_how_it_ended(env):
    _, info = env.reset(seed=1)
    env.render()
    frames = env.unwrapped.frames
    assert "reward" not in frames.title
    env.step(int(np.flatnonzero(info["action_mask"] == 0)[0]))
    env.render()
    _, reward, ended, _, info = env.step(0)
    env.render()
    assert reward < 0.0
    assert f"keep the site,  reward -{abs(reward):.3f}" in frames.title
    while not ended:
        _, reward, ended, _, info = env.step(0)
    env.render()
    assert f"reward {'+' if reward > 0.0 else '-'}{abs(reward):.3f}" in frames.title
    assert frames.title.endswith(
        "landed safely" if info["safe"] else ", ".join(info["failure_causes"])
    )


def _colours(picture, box):
    """Return the mean green of a part of the map, as shares of it from its left and its top."""
    rows, cols = np.nonzero(np.ptp(picture[:, 500:740].astype(int), axis=2) > 40)
    top, low, left, right = rows.min(), rows.max(), cols.min() + 500, cols.max() + 500
    x0, x1, y0, y1 = box
    part = picture[
        int(top + y0 * (low - top)) : int(top + y1 * (low - top)),
        int(left + x0 * (right - left)) : int(left + x1 * (right - left)), 1,
    ]  # fmt: skip
    return float(np.median(part))


def test_frames_show_the_map_north_up_and_east_right(env):
    env.reset(seed=1)
    observation = env.unwrapped.simulation.observe()
    frames = FrameRenderer(env.unwrapped.simulation, observation)
    m = observation.hazard_map
    for axis, high, low in ((0, (0.1, 0.9, 0.05, 0.2), (0.1, 0.9, 0.8, 0.95)),
                            (1, (0.8, 0.95, 0.1, 0.9), (0.05, 0.2, 0.1, 0.9))):  # fmt: skip
        p = np.zeros(m.grid.shape, np.float32)
        half = np.s_[m.grid.rows // 2 :, :] if axis == 0 else np.s_[:, m.grid.cols // 2 :]
        p[half] = 1.0  # rows run north, columns east
        told = replace(m, p_safe=p, observed=np.ones(m.grid.shape, bool))
        picture = frames.draw(replace(observation, hazard_map=told), None, None)
        assert _colours(picture, high) > _colours(picture, low) + 100.0


def test_a_film_goes_down_to_the_terrain(small_scenario, tmp_path):
    scenario = small_scenario.changed(simulation={"cycle_s": 0.1})
    env = gymnasium.make(ID, perception="onboard", scenario=scenario, render_mode="rgb_array_list")
    env.reset(seed=1)
    (first,) = env.render()
    assert env.render() == []
    frames, ended = [first], False
    while not ended:
        *_, ended, _, _ = env.step(0)
        last = env.render()
        frames += last
    assert len(last) > 8  # of the last 50 m, which are one step
    close = np.s_[52:300, 312:448]
    grown = [(frame[close] < 200).any(axis=2).sum() for frame in last]
    assert grown[-1] > grown[len(grown) // 2] > 0
    duration = env.unwrapped.simulation.time
    assert abs(len(frames) - env.metadata["render_fps"] * duration) < 0.3 * len(frames)
    for name in ("film.gif", "film.mp4"):
        save_video(frames, tmp_path / name, env.metadata["render_fps"])
        shown = _played(tmp_path / name)
        assert len(shown) == len(frames)
        for mine, theirs in ((frames[0], shown[0]), (frames[-1], shown[-1])):
            assert np.abs(mine.astype(int) - theirs).mean() < 8.0
    assert {path.name for path in tmp_path.iterdir()} == {"film.gif", "film.mp4"}
    pace = env.metadata["render_fps"]
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.info["duration"] == 1000 / pace
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == pace


def _played(path):
    """Return the frames of a film, red, green and blue."""
    film, out = cv2.VideoCapture(str(path)), []
    while (read := film.read())[0]:
        out.append(read[1][..., ::-1])
    if not out:  # this reader knows no GIF
        with Image.open(path) as many:
            out = [np.asarray(one.convert("RGB")) for one in ImageSequence.Iterator(many)]
    return out


def test_films_of_nothing_are_refused(tmp_path):
    frame = np.zeros((8, 8, 3), np.uint8)
    for frames, name, fps, words in (
        ([], "a.gif", 2.0, "frames"),
        ([frame, frame[:4]], "a.gif", 2.0, "the same size"),
        ([frame], "a.avi", 2.0, "a.avi"),
        ([frame], "a.gif", 0.0, "fps"),
    ):
        with pytest.raises(InputError, match=words):
            save_video(frames, tmp_path / name, fps)
    assert not list(tmp_path.iterdir())


def test_misuse_is_explained(small_scenario):
    fresh = gymnasium.make(ID, perception="onboard", scenario=small_scenario).unwrapped
    with pytest.raises(gymnasium.error.ResetNeeded):
        fresh.step(0)
    fresh.reset(seed=1)
    with pytest.raises(ValueError, match=r"action: must.*got 99"):
        fresh.step(99)
    with pytest.raises(ValueError, match="render_mode"):
        RetargetEnv(small_scenario, render_mode="ansi", perception="onboard")
    blind = small_scenario.to_dict() | {"mappers": {}, "tasking": {}}
    blind["sensors"] = {k: v for k, v in blind["sensors"].items() if k != "flash"}
    with pytest.raises(InputError, match="mappers"):
        RetargetEnv(small_scenario.from_dict(blind), perception="onboard")
    with pytest.raises(InputError, match="existing TOML"):
        gymnasium.make(ID, perception="onboard", scenario="missing.toml")


def test_scenario_objects_are_taken(small_scenario):
    assert isinstance(small_scenario, Scenario)
    assert (
        gymnasium.make(ID, perception="onboard", scenario=small_scenario).unwrapped.scenario
        is small_scenario
    )


def test_example_script_runs(tmp_path):
    (path,) = SCENARIOS.rglob("retarget_agents.py")
    Scenario.from_dict(TINY_FLIGHT).save(tmp_path / "tiny.toml")
    film = tmp_path / "film.gif"
    done = CliRunner().invoke(
        runpy.run_path(str(path))["main"],
        ["--episodes", "1", "--video", str(film), "--scenario", str(tmp_path / "tiny.toml")],
    )
    assert done.exit_code == 0, done.output
    assert film.is_file()
    assert "rule-based: mean return" in done.output
