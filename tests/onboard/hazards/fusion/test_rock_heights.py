"""Test the heights of rocks that one sensor tracks and another has sampled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.fusion import rock_heights as fused_heights
from lunarsim.onboard.hazards.fusion.elevation_samples import ElevationSamples
from lunarsim.onboard.hazards.fusion.rock_existence import COMMON_MISS_PROBABILITY
from lunarsim.onboard.hazards.fusion.rock_heights import (
    RockHeights,
    estimate_height_scale,
    estimate_rock_heights,
    highest_residual,
    rock_free_probability,
)
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.map_evidence import RockTracks, TerrainEvidence
from lunarsim.onboard.hazards.shadows.probability import cover_probability
from tests.reference import fusion as plain

LANDER = Lander()
LIMIT = LANDER.roughness_limit
GRID = Grid(-3.0, 2.0, 0.25, 30, 26)


def tracks(*rocks, sigma=0.05) -> RockTracks:
    """Return rocks, each given as (x, y, radius, existence)."""
    table = np.array(rocks, np.float64).reshape(-1, 4)
    n = len(table)
    return RockTracks(table[:, :2], np.full(n, sigma), table[:, 2], np.full(n, 0.0016), table[:, 3])


def heights(rocks, top=0.0, density=8.0) -> RockHeights:
    """Return the height estimates of rocks on a map with one residual height everywhere."""
    residual_heights = np.full(GRID.shape, top, np.float32)
    return estimate_rock_heights(
        rocks,
        ElevationSamples(residual_heights, np.full(GRID.shape, float(density)), GRID, 0.5),
        LANDER,
    )


# --- samples about a rock ----------------------------------------------------------------------


@given(
    st.integers(0, 10_000), st.floats(-4.0, 5.0), st.floats(1.0, 10.0), st.floats(0.05, 0.8),
    st.floats(0.0, 0.6),
)  # fmt: skip
def test_the_highest_sample_about_a_rock_equals_that_of_all_cells(seed, x, y, radius, sigma):
    rng = np.random.default_rng(seed)
    residual_heights = rng.normal(0.0, 0.2, GRID.shape).astype(np.float32)
    residual_heights[rng.random(GRID.shape) < 0.7] = np.nan
    found = highest_residual(tracks((x, y, radius, 0.9), sigma=sigma), residual_heights, GRID)[0]
    reach = 1.4 * radius + min(sigma, 0.3) + 0.1
    expected = plain.highest_sample(residual_heights, GRID.x0, GRID.y0, GRID.posting, (x, y), reach)
    assert found == pytest.approx(expected)


# --- the scale ---------------------------------------------------------------------------------

some_rocks = st.lists(
    st.tuples(st.floats(0.1, 0.8), st.floats(0.0, 1.0), st.floats(-0.1, 0.9), st.floats(0.0, 30.0)),
    max_size=9,
)


@given(some_rocks, st.floats(0.3, 1.0))
def test_the_height_scale_equals_the_update_of_its_prior(rocks, ratio):
    table = np.array(rocks, np.float64).reshape(-1, 4)
    assert estimate_height_scale(*table.T, ratio) == pytest.approx(plain.height_scale(rocks, ratio))


def test_rocks_read_as_too_small_are_found_to_be_so():
    rng = np.random.default_rng(1)
    true = rng.uniform(0.3, 0.6, 40)
    density = np.full(40, 20.0)
    # Median of the highest of n samples on a hemisphere.
    count = rng.poisson(density * np.pi * true**2)
    top = np.array([
        h * np.sqrt(rng.random(max(n, 1)).max()) for h, n in zip(true, count, strict=True)
    ])  # fmt: skip
    found, sigma = estimate_height_scale(0.7 * true, np.ones(40), top, density, 0.5)
    assert found == pytest.approx(1.0 / 0.7, rel=0.1)
    assert abs(np.log(0.7 * found)) < 2.0 * sigma < 0.1
    # Samples underestimate heights; the scale is at least the expectation of the mission.
    assert estimate_height_scale(0.7 * true, np.ones(40), 0.1 * top, density, 0.5)[0] == 1.0


def test_a_scale_that_nobody_has_measured_holds_every_shape_that_a_shadow_may_be_read_as():
    """Hemispheres read as cubes have 0.7 of their radius; cubes have their own radius."""
    none = np.zeros(0)
    scale, sigma = estimate_height_scale(none, none, none, none, 0.4)
    assert 0.8 < scale < 0.8 / 0.7
    assert abs(np.log([0.8 / scale, 0.8 / 0.7 / scale])).max() < 1.5 * sigma
    # Rocks that may be too high are therefore not ignored.
    read = 0.7 * 1.1 * LIMIT
    assert heights(tracks((0.0, 5.0, read, 1.0)), 0.0, 0.0).hazard[0] > 0.3


# --- the height of each ------------------------------------------------------------------------


@given(
    st.floats(0.1, 0.6), st.floats(0.0, 1.0), st.floats(0.0, 0.4), st.floats(0.0, 2.0)
)  # fmt: skip
def test_the_probability_of_a_high_rock_equals_the_integral(radius, there, top, density):
    """To 0.01: the package sums 160 heights 3.8 % apart, so that the limit is that uncertain."""
    rock = tracks((0.0, 5.0, radius, there))
    found = heights(rock, top, density)
    scale, vague = plain.height_scale([(radius, there, top, density)], 0.5)
    assert found.scale == pytest.approx(scale)
    spread = np.sqrt(0.12**2 + vague**2 + (0.04 / radius) ** 2)
    expected = plain.hazard_probability(
        scale * radius, spread, there, top, density, LIMIT, 0.5, COMMON_MISS_PROBABILITY
    )
    assert found.hazard[0] == pytest.approx(expected, abs=0.01)


def test_samples_that_show_nothing_leave_what_both_sensors_miss():
    rock = tracks((0.0, 5.0, 0.6, 0.8))
    dense = heights(rock, 0.0, 400.0).hazard[0]
    odds = COMMON_MISS_PROBABILITY * 0.8 / 0.2
    assert dense == pytest.approx(odds / (1.0 + odds), rel=1e-3)
    # A rock that the samples show keeps its odds: the elevations count it already.
    assert heights(rock, LIMIT, 1e-9).hazard[0] == pytest.approx(0.8, abs=1e-3)
    assert heights(replace(rock, existence=np.array([0.4])), LIMIT, 1.0).hazard[0] <= 0.4


@given(
    st.floats(0.1, 0.6), st.floats(0.0, 0.5), st.floats(0.0, 0.4), st.floats(0.0, 60.0),
    st.floats(0.0, 0.5), st.floats(0.0, 1.0),
)  # fmt: skip
def test_worse_evidence_never_makes_a_rock_less_likely(radius, there, top, density, more, share):
    def hazard(e=there, t=top, d=density):
        return heights(tracks((0.0, 5.0, radius, e)), t, d).hazard[0]

    before = hazard()
    assert hazard(e=min(there + more, 0.5)) >= before - 1e-12
    assert hazard(t=top + more) >= before - 1e-12
    assert hazard(d=share * density) >= before - 1e-12


def test_larger_rocks_are_no_less_likely_too_high_and_reach_no_less_far():
    radius = np.geomspace(0.3, 1000.0, 60)
    found = heights(tracks(*((40.0, 5.0, r, 0.8) for r in radius)))
    assert (np.diff(found.hazard) >= -1e-9).all()
    assert (np.diff(found.reach) >= 0.0).all()
    # Rocks far above the limit exceed it over their complete outline.
    large = radius > 3.0
    assert found.hazard[large] == pytest.approx(0.8)
    assert found.reach[large] == pytest.approx(found.scale * radius[large], rel=0.15)
    under = rock_free_probability(
        tracks((0.0, 5.0, 1000.0, 0.8)), heights(tracks((0.0, 5.0, 1000.0, 0.8))), GRID, LANDER
    )
    assert (under < 1.0).all()


def test_off_the_map_samples_say_nothing():
    away = tracks((40.0, 5.0, 0.6, 0.8))
    assert heights(away, 0.0, 400.0).hazard[0] == pytest.approx(0.8, abs=1e-3)


# --- under the lander --------------------------------------------------------------------------


def test_a_rock_counts_as_far_as_it_is_too_high():
    wide = Grid.centred((0.0, 0.0), 8.0, 0.1)
    rock = tracks((0.0, 0.0, 0.4, 0.6), sigma=1e-6)
    reach = np.sqrt(0.4**2 - LIMIT**2)
    clear = rock_free_probability(
        rock, RockHeights(1.0, np.array([0.6]), np.array([reach])), wide, LANDER
    )
    far = np.hypot(*np.moveaxis(wide.centres(), -1, 0))
    # Positions have an uncertainty of a fifth of the radius.
    edge, soft = LANDER.leg_radius + reach, 3.0 * np.hypot(0.2 * 0.4, 0.15 * reach + 0.02)
    assert clear[far < edge - soft] == pytest.approx(0.4, abs=0.02)
    assert clear[far > edge + 1.4 * soft] == pytest.approx(1.0, abs=1e-3)
    covered = cover_probability(
        far.reshape(1, -1), [0.2 * 0.4], [edge], [0.15 * reach + 0.02]
    ).reshape(far.shape)
    assert clear == pytest.approx(1.0 - 0.6 * covered, abs=0.01)
    rare = rock_free_probability(
        rock, RockHeights(1.0, np.array([1e-5]), np.array([reach])), wide, LANDER
    )
    assert (rare == 1.0).all()


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(0.1, 0.6), st.floats(0.0, 1.0),
            st.floats(0.05, 0.5),
        ),
        min_size=1, max_size=3,
    ),
    st.floats(0.02, 1.0),
)  # fmt: skip
def test_the_probability_of_no_high_rock_equals_that_of_all_combinations(rocks, sigma):
    """To 0.005 a rock: profiles are interpolated between 65 distances and cut off at 3.9 sigma."""
    few = Grid.centred((0.0, 0.0), 6.0, 1.5)
    table = tracks(*(rock[:4] for rock in rocks), sigma=sigma)
    hazard, reach = table.existence, np.array([rock[4] for rock in rocks])
    found = rock_free_probability(table, RockHeights(1.0, hazard, reach), few, LANDER)
    for at in np.ndindex(few.shape):
        centre = few.centre_of(*at)
        covered = [
            plain.reach_probability(
                np.hypot(x - centre[0], y - centre[1]), np.hypot(sigma, 0.2 * radius),
                LANDER.leg_radius + far, 0.15 * far + 0.02,
            )
            for x, y, radius, _, far in rocks
        ]  # fmt: skip
        expected = plain.no_hazard(list(zip(hazard, covered, strict=True)))
        assert found[at] == pytest.approx(expected, abs=0.005 * len(rocks))


def test_rocks_of_flat_tops_are_too_high_as_far_as_they_reach():
    rock = tracks((0.0, 5.0, 0.5, 0.9))
    samples = ElevationSamples(np.zeros(GRID.shape, np.float32), np.zeros(GRID.shape), GRID, 0.5)
    round_one, flat = (
        estimate_rock_heights(rock, samples, LANDER, shape).reach[0]
        for shape in ("ellipsoid", "cube")
    )
    high = heights(rock, 0.0, 0.0).scale * 0.5
    assert round_one < flat == pytest.approx(high, rel=0.1)
    assert round_one == pytest.approx(np.sqrt(high**2 - LIMIT**2), rel=0.1)


def test_rises_of_other_cells_than_the_map_are_refused():
    unseen = HazardMap.unobserved(GRID)
    with pytest.raises(InputError, match=r"evidence\.residual_heights"):
        TerrainEvidence(unseen, residual_heights=np.zeros((2, 2), np.float32))


def test_only_tracks_reported_to_be_too_high_are_rocks_by_the_share_of_them_that_are(monkeypatch):
    asked = []

    def half(xy, height, tells, *rest):
        asked.append((height, tells))
        return np.full(len(height), 0.5)

    monkeypatch.setattr(fused_heights, "rock_track_precision", half)
    # Samples of this height double the height over the radius.
    rocks = tracks(
        (0.0, 5.0, 0.6 * LIMIT, 0.8), (0.0, 5.0, 0.3 * LIMIT, 0.8), (0.0, 5.0, LIMIT, 0.4)
    )
    top = 1.2 * LIMIT
    found = heights(rocks, top, 200.0)
    ((height, tells),) = asked
    assert found.scale > 1.7
    assert height == pytest.approx(found.scale * rocks.radius)
    assert tells.tolist() == [True, False, False]
    vague = plain.height_scale([(r, 0.8, top, 200.0) for r in rocks.radius[:2]], 0.5)[1]
    for n, there in enumerate((0.4, 0.8, 0.2)):
        spread = np.sqrt(0.12**2 + vague**2 + (0.04 / rocks.radius[n]) ** 2)
        expected = plain.hazard_probability(
            height[n], spread, there, top, 200.0, LIMIT, 0.5, COMMON_MISS_PROBABILITY
        )
        assert found.hazard[n] == pytest.approx(expected, abs=0.01)
