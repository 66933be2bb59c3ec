"""Test the share of rocks among the large rock tracks of a camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.fusion.elevation_samples import ElevationSamples
from lunarsim.onboard.hazards.fusion.rock_existence import rock_track_precision
from lunarsim.onboard.hazards.fusion.rock_heights import estimate_rock_heights
from lunarsim.onboard.hazards.map_evidence import RockTracks
from tests.camera_and_lidar import bumps
from tests.reference import fusion as plain

SMALL = Grid(1.0, -2.0, 0.25, 16, 15)
WIDE = Grid.centred((0.0, 0.0), 30.0, 0.25)
LIMIT = Lander().roughness_limit


def places(rng, n) -> np.ndarray:
    """Return points at least 3 m from each other on the wide map."""
    grid = np.stack(np.meshgrid(np.arange(-12.0, 13.0, 4.0), np.arange(-12.0, 13.0, 4.0)), -1)
    return rng.permutation(grid.reshape(-1, 2))[:n] + rng.uniform(-0.4, 0.4, (n, 2))


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 6), st.sampled_from([0.5, 1.0]))
def test_the_share_equals_the_sum_over_all_assignments_of_the_others(seed, n, ratio):
    """To 2e-4: the package sums 200 shares."""
    rng = np.random.default_rng(seed)
    west, east, south, north = SMALL.extent
    xy = rng.uniform((west - 0.4, south - 0.4), (east + 0.4, north + 0.4), (n, 2))
    height, tells = rng.uniform(0.25, 0.9, n), rng.random(n) < 0.8
    residual_heights = bumps(xy[::2], SMALL, 0.5, 9.0, rng)
    density = rng.uniform(0.0, 20.0, SMALL.shape)
    found = rock_track_precision(
        xy, height, tells, ElevationSamples(residual_heights, density, SMALL, ratio)
    )
    expected = plain.track_precision(
        [(*p, h, t) for p, h, t in zip(xy, height, tells, strict=True)],
        residual_heights, SMALL.x0, SMALL.y0, SMALL.posting, density, ratio,
    )  # fmt: skip
    assert found == pytest.approx(expected, abs=2e-4)


def test_tracks_that_samples_show_are_rocks_and_of_others_few_are():
    rng = np.random.default_rng(2)
    xy = places(rng, 24)
    told = np.full(24, 0.6), np.ones(24, bool)
    density = np.full(WIDE.shape, 12.0)
    for rocks, least, most in ((24, 0.99, 1.0), (12, 0.6, 0.95), (0, 0.0, 0.3)):
        residual_heights = bumps(xy[:rocks], WIDE, 0.6, 12.0, rng)
        found = rock_track_precision(
            xy, *told, ElevationSamples(residual_heights, density, WIDE, 0.5)
        )
        assert (found >= least).all() and (found <= most).all(), rocks


def test_with_too_few_samples_tracks_are_as_likely_as_before():
    rng = np.random.default_rng(3)
    xy = places(rng, 24)
    told = np.full(24, 0.6), np.ones(24, bool)
    nothing = np.full(WIDE.shape, np.nan, np.float32)
    none, dense = (
        ElevationSamples(nothing, np.full(WIDE.shape, density), WIDE, 0.5)
        for density in (0.0, 12.0)
    )
    assert rock_track_precision(xy, *told, none) == pytest.approx(1.0)
    assert (rock_track_precision(xy + 100.0, *told, dense) == 1.0).all()
    assert (rock_track_precision(xy, told[0], ~told[1], dense) == 1.0).all()
    alone = rock_track_precision(xy[:1], *(v[:1] for v in told), dense)
    assert alone == pytest.approx(1.0)


def test_what_a_track_itself_shows_does_not_count_for_it_twice():
    rng = np.random.default_rng(4)
    xy = places(rng, 8)
    told = np.full(8, 0.6), np.ones(8, bool)
    density = np.full(WIDE.shape, 12.0)
    residual_heights = bumps(xy[:4], WIDE, 0.6, 16.0, rng)
    before = rock_track_precision(xy, *told, ElevationSamples(residual_heights, density, WIDE, 0.5))
    # Remove the rise of one track: the share of the other tracks changes, not its own.
    shown = residual_heights.copy()
    row, col = WIDE.cell(xy[7])
    shown[row, col] = 0.6
    after = rock_track_precision(xy, *told, ElevationSamples(shown, density, WIDE, 0.5))
    assert after[7] == pytest.approx(before[7], abs=0.02)
    assert (after[:7] > before[:7] + 0.01).all()


def tracks(xy, radius, there=0.95) -> RockTracks:
    """Return identical rocks."""
    n = len(xy)
    return RockTracks(
        np.asarray(xy), np.full(n, 0.1), np.full(n, radius), np.full(n, 1e-4), np.full(n, there)
    )


def test_hollows_that_are_tracked_as_large_rocks_hardly_count():
    rng = np.random.default_rng(5)
    xy = places(rng, 24)
    density = np.full(WIDE.shape, 12.0)
    level = bumps(xy[:0], WIDE, 0.6, 12.0, rng)

    def hazard(rocks, residual_heights=level):
        return estimate_rock_heights(
            rocks, ElevationSamples(residual_heights, density, WIDE, 0.5), Lander()
        ).hazard

    alone = hazard(tracks(xy[:1], 2.0 * LIMIT))[0]
    many = hazard(tracks(xy, 2.0 * LIMIT))
    assert alone > 0.3
    assert (many < 0.05).all()
    # Rocks below the limit and improbable tracks are ignored.
    low = tracks(xy, 0.6 * LIMIT)
    mixed = replace(low, radius=np.where(np.arange(24) == 0, 2.0 * LIMIT, low.radius))
    assert hazard(mixed)[0] == pytest.approx(alone)
    doubted = tracks(xy, 2.0 * LIMIT)
    doubted = replace(doubted, existence=np.where(np.arange(24) == 0, 0.95, 0.5))
    assert hazard(doubted)[0] == pytest.approx(alone)
    # True rocks keep their probability.
    true = bumps(xy, WIDE, 2.0 * LIMIT, 12.0, rng)
    assert (hazard(tracks(xy, 2.0 * LIMIT), true) > 0.7).mean() > 0.8
