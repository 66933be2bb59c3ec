"""Rocks that no sample has met: the height curve against rocks that are drawn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.rocks.shapes import IRREGULAR, shape_table
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.safety.unseen_rocks import ExceedanceCurve, depth_curve, height_curve


def drawn(rng: np.random.Generator, count: int, steep: float) -> np.ndarray:
    """Return heights of rocks, m, the numbers above which fall as a power of the height."""
    return np.minimum(0.1 * (1.0 - rng.random(count)) ** (-1.0 / steep), 2.0)


@pytest.mark.parametrize("steep", [4.0, 6.0, 8.0])
def test_missed_rocks_are_about_those_that_samples_miss(steep):
    rng = np.random.default_rng(0)
    high, ground, ratio = drawn(rng, 400_000, steep), 1e6, 0.8
    area = np.pi / (4.0 * ratio**2)
    height = np.geomspace(0.03, 3.0, 60)
    above = [(area * np.maximum(high**2 - h * h, 0.0)).sum() for h in height]
    curve = ExceedanceCurve(height, np.maximum(np.array(above) / ground, 1e-12))
    for h in (0.15, 0.2, 0.25):
        for density in (0.0, 1.0, 10.0, 50.0):
            seen = area * np.maximum(high**2 - h**2, 0.0)
            expected = (np.exp(-density * seen) * (high > h)).sum() / ground
            assert 0.5 < curve.missed_rocks(h, density) / expected < 4.0, (h, density)


def test_rocks_of_one_size_are_never_more_than_the_share_lets_stand():
    area, high, number = np.pi / (4.0 * 0.8**2), 0.3, 0.02
    height = np.geomspace(0.02, 2.0, 200)
    share = np.maximum(number * area * (high**2 - height**2), 1e-12)
    found = ExceedanceCurve(height, share).missed_rocks([0.1, 0.2, 0.25], 0.0)
    # A quarter of the most that there can be.
    assert found == pytest.approx(
        0.25 * number * high**2 / np.array([0.1, 0.2, 0.25]) ** 2, rel=0.1
    )


def test_missed_rocks_never_fall_with_less_height_or_thinner_samples_or_more_rocks():
    rng = np.random.default_rng(1)
    height = np.geomspace(0.02, 2.0, 40)
    for _ in range(20):
        share = np.exp(np.cumsum(-rng.exponential(0.3, 40))) * 0.3
        curve, more = ExceedanceCurve(height, share), ExceedanceCurve(height, 1.5 * share)
        h, density = np.sort(rng.uniform(0.0, 2.2, 50)), np.sort(rng.uniform(0.01, 3000.0, 50))
        assert (np.diff(curve.missed_rocks(h, 20.0)) <= 1e-12).all()
        assert (np.diff(curve.missed_rocks(0.3, density)) <= 1e-12).all()
        taller = ExceedanceCurve(
            height, np.maximum.accumulate((share * rng.uniform(1, 3, 40))[::-1])[::-1]
        )
        assert (taller.missed_rocks(h, density) >= curve.missed_rocks(h, density)).all()
        assert (more.missed_rocks(h, 20.0) >= curve.missed_rocks(h, 20.0)).all()
        assert curve.missed_rocks(h[:, None], density).shape == (50, 50)


@given(st.integers(0, 10_000), st.floats(1.0, 3.0), st.sampled_from([0.005, 0.02, 0.05]))
def test_taller_rocks_are_no_fewer_that_are_missed(seed, times, noise):
    """Some of the samples that met a rock met a higher one."""
    rng = np.random.default_rng(seed)
    rises = np.zeros(int(rng.choice([300, 3000])))
    count = int(rng.integers(1, 100))
    rises[:count] = 0.25 * rng.uniform(0.3, 2.5, count)
    taller = rises.copy()
    taller[: int(rng.integers(1, count + 1))] *= times
    h, density = rng.uniform(0.0, 1.0, 30), rng.uniform(0.1, 200.0, 30)
    low, high = (height_curve(r, noise, 0.25, 0.05) for r in (rises, taller))
    assert (high.missed_rocks(h, density) >= low.missed_rocks(h, density) * (1.0 - 1e-9)).all()
    assert (high.unseen_rocks(h, density) >= low.unseen_rocks(h, density) * (1.0 - 1e-9)).all()


def test_holes_are_counted_as_far_as_the_terrain_lies_below():
    rises = np.zeros(20_000)
    rises[:400] = -0.4
    deep = depth_curve(rises, 0.01, 0.25, 0.05)
    assert deep.at([0.1, 0.15, 0.2]) == pytest.approx(0.02, rel=0.3)
    assert depth_curve(-rises, 0.01, 0.25, 0.05).at(0.2) < 1e-3
    # 0.02 of the ground in squares of 0.5 m, each missed by 4 samples a square metre.
    assert deep.missed_holes(0.2, 4.0, 0.5) == pytest.approx(4.0 * deep.at(0.2) * np.exp(-1.0))
    assert (np.diff(deep.missed_holes(np.linspace(0.0, 1.0, 20), 4.0, 0.5)) <= 0.0).all()


def test_tops_of_faceted_rocks_are_narrower_than_those_of_half_ellipsoids():
    """Mean area above a height of the rocks that exceed it, by sampling their shapes."""
    rng = np.random.default_rng(1)
    table = shape_table()
    points = rng.uniform(-1.4, 1.4, (4000, 2))
    half_ellipsoid = np.sqrt(np.clip(1.0 - (points**2).sum(axis=1), 0.0, None))
    faceted = []
    for shape in range(IRREGULAR, len(table.count)):
        planes = table.planes[shape, : table.count[shape]]
        top, wall = planes[planes[:, 2] > 1e-9], planes[planes[:, 2] <= 1e-9]
        height = ((top[:, 3] - points @ top[:, :2].T) / top[:, 2]).min(axis=1)
        inside = (points @ wall[:, :2].T <= wall[:, 3]).all(axis=1)
        faceted.append(np.where(inside, height, 0.0))
    for cover in (0.02, 0.1):
        diameter = sample_diameters(1e5, cover, 0.15, 3.0, rng)
        high = diameter[0.5 * diameter > 0.25]
        relative = 0.25 / (0.5 * high)
        areas = [
            np.mean([(h[:, None] > relative).mean(axis=0) @ high**2 for h in heights])
            for heights in ([half_ellipsoid], faceted)
        ]
        assert 0.5 < areas[1] / areas[0] < 0.72


def test_more_faceted_rocks_than_half_ellipsoids_are_unseen():
    wide, narrow = (
        height_curve(np.zeros(2000), 0.005, 0.25, 0.05, 0.5, shape)
        for shape in ("hemisphere", "irregular")
    )
    assert np.array_equal(wide.share, narrow.share)
    assert narrow.unseen_rocks(0.25, 20.0) > 2.0 * wide.unseen_rocks(0.25, 20.0)
    assert narrow.with_gravel.unseen_rocks(0.25, 20.0) > wide.with_gravel.unseen_rocks(0.25, 20.0)
