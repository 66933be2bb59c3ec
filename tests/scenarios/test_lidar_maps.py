"""The matrix of worlds, and the two calibrations on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.safety.calibration import COUNT, FREE


def first(module, **changes):
    """Return a scene of a few metres, seen from near by."""
    scene = next(iter(module.scenes(8, 1)))
    return replace(scene, distance=140.0, angle_deg=0.0, relief="fractal-6", **changes)


def test_every_part_of_the_matrix_has_its_turn(script):
    worlds = script("lidar_maps", "worlds")
    deck = list(worlds.scenes(240, 3))
    for name, cards in (
        ("relief", worlds.RELIEFS), ("rocks", worlds.ROCKS), ("lander", tuple(worlds.LANDERS)),
    ):  # fmt: skip
        counts = [sum(getattr(s, name) == card for s in deck) for card in cards]
        assert max(counts) - min(counts) <= 1, name
    assert deck == list(worlds.scenes(240, 3))
    assert len({s.seed for s in deck}) == 240


@pytest.mark.parametrize("name", ["calibration", "quadtree_calibration"])
def test_a_scene_is_judged_the_same_twice(script, name):
    study = script("lidar_maps", name)
    scene = first(study, rocks="golombek-5", lander="small")
    a, b = study.judge(scene), study.judge(scene)
    assert np.array_equal(a.features, b.features)
    assert np.array_equal(a.safe, b.safe)
    assert len(a.safe) > 20
    assert len(a.features) == len(a.safe) == len(a.known) == len(a.bound) == len(a.ceiling)
    assert np.isfinite(a.features).all()
    done = CliRunner().invoke(study.main, ["--scenes", "2"])
    assert done.exit_code == 2


def test_what_is_kept_out_is_judged_by_a_fit_without_it(script):
    study = script("lidar_maps", "calibration")
    rng = np.random.default_rng(1)
    deck = list(study.scenes(24, 2))

    def judged(scene):
        x = rng.uniform(0.0, 1.0, (60, COUNT)).astype(np.float32)
        x[:, 0] = 1.0
        safe = rng.random(60) < 1.0 / (1.0 + np.exp(-(8.0 * x[:, FREE] - 4.0)))
        ones = np.ones(60)
        return study.Judged(scene, x, rng.random(60) < 0.8, ones, ones, ones, 0.005, safe)

    scenes = [judged(s) for s in deck]
    rows = list(study.left_out(scenes))
    assert {name.split()[0] for name, _, _ in rows} == {"relief", "rocks", "lander", "range"}
    for _, others, kept in rows:
        assert len(others) + len(kept) == 24
        assert not {id(j) for j in others} & {id(j) for j in kept}
    name, others, kept = rows[0]
    sites = study.Sites.of(kept)
    p = study.probability(study.fitted(others), sites)
    assert study.figures(p, sites.safe)["skill"] > 0.0
    # A constant has no error of calibration, and no skill.
    flat = study.figures(np.full(len(p), sites.safe.mean()), sites.safe)
    assert flat["ece"] < 0.01
    assert flat["skill"] == pytest.approx(0.0, abs=1e-9)
    assert study.table_of([(name, p, sites)]).row_count == 1
