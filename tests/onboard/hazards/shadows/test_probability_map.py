"""The probability map: prior, painting, footprints, what is not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.evaluation.classification import RELIABILITY_EDGES, classify
from lunarsim.evaluation.reliability import reliability
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.map_evidence import RockTracks
from lunarsim.onboard.hazards.shadows import (
    HazardPrior,
    ProbabilityMap,
)
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import golombek_cover, golombek_exponent, golombek_number
from tests.shadow_scene import MODEL, SUN, at, follow, picture, rocks_on_a_plane, tracker_at

GRID = Grid.centred((0.0, 0.0), 40.0, 0.25)


def test_map_begins_with_the_prior_and_falls_by_eq_14():
    prior = HazardPrior(0.07, 0.4)
    mapping = ProbabilityMap(GRID, MODEL, prior)
    tracker = tracker_at((0.0, 0.0, 60.0))
    start = mapping.probability(tracker)
    assert start == pytest.approx(float(golombek_cover(0.4, 0.07)), rel=1e-5)
    assert not mapping.observed.any()
    # A rate that is 1 below a resolution and 0 above is Eq. 14.
    step = DetectionRates(false_clear_line=(1001.0, -500.0, 1e-9))
    sharp = ProbabilityMap(GRID, MODEL, prior, step)
    state, camera, counts = picture(rocks_on_a_plane("hemisphere", count=1), (0.0, 0.0, 150.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    view = camera.view(state)
    sharp.add_image(view, SUN, seen)
    q = float(MODEL.visible_q(1.0, 0.0, np.pi / 2, 150.0 / camera.fx))
    resolved = 2.0 * 2.0 / q
    expected = golombek_cover(0.4, 0.07) - golombek_cover(max(resolved, 0.4), 0.07)
    middle = sharp.probability(tracker)[80, 80]
    # Sizes are taken in 24 classes.
    assert middle == pytest.approx(float(expected), abs=0.15 * float(golombek_cover(0.4, 0.07)))


def test_map_is_a_probability_and_knows_the_rocks():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    path = [(-20.0 + 2.0 * k, 10.0, 80.0 - 3.0 * k) for k in range(12)]
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    tracker = follow(terrain, path, tracker_at(path[0]), mapping)
    p = mapping.probability(tracker)
    assert p.min() >= 0.0
    assert p.max() <= 1.0
    rock = terrain.rock_raster(GRID)
    assert p[rock >= 0].mean() > 20.0 * p[rock < 0].mean()
    result = classify(p, rock >= 0, observed=mapping.observed)
    assert result.rates["clear_recall"] > 0.5
    assert result.rates["clear_false"] < 0.0025
    table = reliability(p, rock >= 0, RELIABILITY_EDGES)
    assert table[:, 0].sum() == p.size
    assert len(table) == len(RELIABILITY_EDGES) - 1


def test_footprint_map_is_the_more_careful_and_keeps_off_the_edge():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    tracker = follow(terrain, [(0.0, 0.0, 55.0)] * 3, tracker_at((0.0, 0.0, 55.0)), mapping)
    point, wide = mapping.probability(tracker), mapping.probability(tracker, 1.5)
    assert (wide >= point - 1e-6).all()
    hazard_map = mapping.hazard_map(tracker, 1.5)
    assert not hazard_map.observed[:6].any()
    assert not hazard_map.observed[:, -6:].any()
    assert hazard_map.observed[80, 80]
    assert (hazard_map.p_safe[~hazard_map.observed] == 0.0).all()
    inside = hazard_map.observed
    assert hazard_map.p_safe[inside] == pytest.approx(1.0 - wide[inside], abs=1e-6)


def test_footprint_prior_counts_rocks_that_reach_in():
    """Against a Monte Carlo over Poisson fields of discs by the same law."""
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    p = float(mapping.probability(tracker_at((0.0, 0.0, 60.0)), 1.0)[0, 0])
    edges = np.geomspace(0.5, 4.0, 2000)
    number = -np.diff(golombek_number(edges, 0.05))
    middle = 0.5 * (edges[1:] + edges[:-1])
    expected = 1.0 - np.exp(-np.sum(number * np.pi * (1.0 + 0.5 * middle) ** 2))
    assert p == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("shape", ["cube", "ellipsoid", None])
def test_a_tracked_rock_is_a_hazard_if_its_longer_axis_is_long_enough(shape):
    """Against drawing shapes, axes and discs, under a footprint that it surely reaches into."""
    sun = np.radians(20.0)
    model = ShapeMixture(sun, "cube")
    if shape:
        model = ShapeMixture.known(ShadowModel(sun, RockModel(shape, burial=(0.0, 0.0))))
    mapping = ProbabilityMap(GRID, model, HazardPrior(0.05, 0.5))
    rng = np.random.default_rng(6)
    for radius, sigma in ((0.2, 0.02), (0.25, 0.05), (0.35, 0.03)):
        rock = RockTracks(
            np.zeros((1, 2)), np.full(1, 0.01), np.full(1, radius), np.full(1, sigma**2),
            np.full(1, 0.9),
        )  # fmt: skip
        estimated = 1.0 - mapping.clear_of(rock, 2.0)[80, 80]
        variance = sigma**2 + (model.radius_sigma * radius) ** 2
        steep = 2.0 * golombek_exponent(0.05) + 2.0 / radius
        disc = rng.normal(radius - variance * steep, np.sqrt(variance), 200_000)
        shapes = rng.choice(len(model.models), 200_000, p=model.shape_fractions)
        long = np.array([m.shapes.shape not in ("cube", "hemisphere") for m in model.models])
        stretch = np.where(long[shapes], rng.uniform(0.6, 1.0, 200_000) ** -0.5, 1.0)
        assert estimated == pytest.approx(0.9 * np.mean(disc * stretch >= 0.25), abs=0.01), radius


def test_dark_terrain_is_not_seen():
    mapping = ProbabilityMap(GRID, MODEL)
    terrain = rocks_on_a_plane("hemisphere", count=1)
    state, camera, counts = picture(terrain, (0.0, 0.0, 60.0))
    counts = counts.copy()
    counts[200:280, 280:360] = 0
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    mapping.add_image(camera.view(state), SUN, seen)
    assert not mapping.observed[80, 80]
    assert mapping.observed[10, 10]


def test_a_camera_that_looks_at_the_sky_changes_nothing():
    mapping = ProbabilityMap(GRID, MODEL)
    state, camera = at((0.0, 0.0, 60.0))
    sky = replace(camera, mount=camera.mount @ np.diag([1.0, -1.0, -1.0]))
    image = np.full((480, 640), 100, np.uint8)
    seen = detect_rocks(image, sky, state, SUN, model=MODEL)
    mapping.add_image(sky.view(state), SUN, seen)
    assert not mapping.observed.any()
    tracker = tracker_at((0.0, 0.0, 60.0))
    tracker.add_known([[0.0, 0.0]], 0.1, 1.0, 0.1)
    tracker.update(seen, sky, SUN, 0.0)
    assert tracker.filter.count == 1
    assert np.isfinite(tracker.filter.covariance).all()


def test_prior_must_make_sense():
    with pytest.raises(InputError, match=r"prior\.min_diameter"):
        HazardPrior(0.05, 5.0)
    with pytest.raises(InputError, match="cover"):
        HazardPrior(0.9)
