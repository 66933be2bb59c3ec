"""Frames of selected environments of a vector environment, and maps in frames."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from tests.envs.site_scene import SMALL

ID = "lunarsim_envs:lunarsim/"
SITES = {"scenario": SMALL, "perception": "truth", "worlds": 1}


def vector(name, mode="NextStep", **settings):
    return gymnasium.make_vec(
        ID + name, num_envs=3, vectorization_mode="vector_entry_point", autoreset_mode=mode,
        **settings,
    )  # fmt: skip


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize(("name", "settings"), [("Guidance-v1", {}), ("Retarget-v1", SITES)])
def test_frames_of_a_batch_are_those_of_single_environments(name, settings, mode):
    """Also after an automatic reset, which starts a new path."""
    many = vector(name, mode, render_mode="rgb_array", rendered=[2, 0], **settings)
    with pytest.raises(gymnasium.error.ResetNeeded):
        many.render()
    ones = {
        i: gymnasium.make(ID + name, render_mode="rgb_array", **settings).unwrapped for i in (2, 0)
    }
    many.reset(seed=7)
    for i, one in ones.items():
        one.reset(seed=7 + i)
    over, ends = dict.fromkeys(ones, False), 0
    many.action_space.seed(3)
    for n in range(900):
        actions = many.action_space.sample()
        many.step(actions)
        for i, one in ones.items():
            if over[i]:
                one.reset()
                over[i] = False
                continue
            over[i] = one.step(actions[i])[2]
            ends += over[i]
            if over[i] and mode == "SameStep":
                one.reset()
                over[i] = False
        if n % 40 == 0 or any(over.values()) or ends in (1, 2):
            frames = many.render()
            assert len(frames) == 2
            for frame, one in zip(frames, ones.values(), strict=True):
                assert np.array_equal(frame, one.render())
        if ends >= 3:
            break
    assert ends >= 3


def test_a_batch_without_render_mode_returns_no_frame():
    many = vector("Guidance-v1")
    many.reset(seed=1)
    assert many.render() is None


def test_a_frame_shows_map_candidates_site_and_lander():
    env = gymnasium.make(ID + "Retarget-v1", render_mode="rgb_array", **SITES).unwrapped
    observation, _ = env.reset(seed=1)
    while not observation["hazard_map"][1].any():
        assert not (env.render()[26:, 640:] == (0, 220, 255)).all(axis=2).any()
        observation, *_ = env.step(0)
    frame = env.render()
    assert frame.shape == (440, 1080, 3)
    chart = frame[:, 640:]
    lanes = env.flight.lanes
    cells = lanes.maps.p.shape[1]
    rows, cols = np.nonzero((chart[26:] == (255, 64, 64)).all(axis=2))
    site = (lanes.guidance.site[0, :2] - lanes.maps.corner[0]) / lanes.maps.posting + 0.5
    scale = 414.0 / cells  # pixels per cell; the legend has 26 rows
    assert cols.mean() == pytest.approx(site[0] * scale, abs=2.0)
    assert rows.mean() + 26 == pytest.approx(440.0 - site[1] * scale, abs=2.0)
    reached = np.isfinite(lanes.candidates.propellant[0, : lanes.candidates.number[0]])
    for colour, is_drawn in (((0, 220, 255), reached.any()), ((150, 150, 150), ~reached.all())):
        assert (chart == colour).all(axis=2).any() == is_drawn
    # Bright cells are safe, dark ones unsafe, and cells that are not observed grey; rings and
    # letters cover a few of them.
    found = []
    for row, col in np.random.default_rng(1).integers(0, cells - 1, (300, 2)):
        y, x = round(440.0 - (row + 0.5) * scale), round((col + 0.5) * scale)
        pixel = chart[y, x].astype(int)
        if not lanes.maps.seen[0, row, col]:
            found.append(pixel.tolist() == [60, 60, 66])
        else:
            found.append((pixel.sum() > 350) == (lanes.maps.p[0, row, col] > 0.5))
    assert np.mean(found) > 0.9


def test_the_triangle_is_where_the_lander_is_estimated():
    """Without a divert the lander ends above its site; on the way it is outside of the map."""
    env = gymnasium.make(ID + "Retarget-v1", render_mode="rgb_array", **SITES).unwrapped
    env.reset(seed=1)
    lanes, over = env.flight.lanes, False
    while not over:
        over = env.step(0)[2]
    scale = 414.0 / lanes.maps.p.shape[1]
    place = lanes.estimated_state[0][0, :2]
    col, row = ((place - lanes.maps.corner[0]) / lanes.maps.posting + 0.5) * scale
    rows, cols = np.nonzero((env.render()[26:, 640:] == (255, 255, 255)).all(axis=2))
    assert cols.mean() == pytest.approx(col, abs=4.0)
    assert rows.mean() + 26 == pytest.approx(440.0 - row, abs=5.0)
    lanes.guidance.site[0, :2] += 10.0  # the triangle does not follow the site
    rows, cols = np.nonzero((env.render()[26:, 640:] == (255, 255, 255)).all(axis=2))
    assert cols.mean() == pytest.approx(col, abs=4.0)
