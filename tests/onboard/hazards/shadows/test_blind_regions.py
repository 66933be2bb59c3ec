"""Parts of a picture in which nothing would show."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import pytest
from scipy.stats import poisson

from lunarsim.grid import Grid
from lunarsim.messages.measurements import CameraImage
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap, ShadowMapper
from lunarsim.onboard.hazards.shadows.viewing_geometry import (
    COLS,
    ROWS,
    cell_centres,
    empty_cells,
    glare,
    relative_shadow_counts,
)
from lunarsim.rocks.size_distribution import golombek_number
from tests.picture_faults import rocky
from tests.shadow_scene import MODEL, SUN, picture, tracker_at

PLACE = (0.0, 0.0, 50.0)


def plain_empty_cells(found, expected):
    """Count shadows in every window by loops, and in all of the picture outside it."""
    out = np.zeros(found.shape, bool)
    for high, wide in product((3, 4, 6, 9, 12), (4, 6, 8, 11, 16)):
        for i, j in product(range(ROWS - high + 1), range(COLS - wide + 1)):
            window = np.zeros(found.shape, bool)
            window[i : i + high, j : j + wide] = True
            numbers = [
                found[~window].sum() * law[window].sum() / max(law[~window].sum(), 1e-300)
                for law in expected
            ]
            some = all(law[window].sum() > 0.0 for law in expected)
            if some and poisson.cdf(found[window].sum(), 0.5 * min(numbers)) < 1e-3:
                out |= window
    return out


@pytest.mark.parametrize("seed", range(4))
def test_empty_windows_equal_plain_counts(seed):
    rng = np.random.default_rng(seed)
    expected = rng.uniform(0.2, 1.0, (2, ROWS, COLS))
    expected[:, :2] = 0.0  # sky
    found = rng.poisson(2.5 * expected[0])
    found[4:9, 2:9] = rng.poisson(0.02, (5, 7))
    empty = empty_cells(found, expected)
    np.testing.assert_array_equal(empty, plain_empty_cells(found, expected))
    assert empty[5:8, 4:8].all() and not empty.all()


def test_windows_with_no_fewer_shadows_than_chance_has_are_not_empty():
    """Of a hundred pictures of rocks without clusters, none has a blind part."""
    rng = np.random.default_rng(5)
    expected = np.ones((2, ROWS, COLS))
    assert not any(
        empty_cells(rng.poisson(rate, (ROWS, COLS)), expected).any()
        for rate in (0.05, 0.3, 0.8, 3.0)
        for _ in range(25)
    )


def test_cells_should_have_shadows_by_their_terrain_and_by_the_least_rock_that_shows():
    sharpness, area = np.array([2.0, 4.0, 0.0, 4.0, np.nan]), np.array([8.0, 3.0, 5.0, np.nan, 1.0])
    by_size, by_area = relative_shadow_counts(sharpness, area, 0.05)
    # A shadow of two by two pixels is that of a rock of 1 m of radius where q is 2 for it.
    np.testing.assert_allclose(by_size[:2], area[:2] * golombek_number([2.0, 1.0], 0.05))
    np.testing.assert_allclose(by_area, [8.0, 3.0, 0.0, 0.0, 0.0])
    assert not by_size[2:].any()
    uv = cell_centres(640, 480)
    assert uv.shape == (ROWS * COLS, 2)
    np.testing.assert_allclose(uv[[0, 1, COLS]], [[19.5, 19.5], [59.5, 19.5], [19.5, 59.5]])


def test_glare_is_a_patch_and_what_lies_beside_it_no_hot_pixel():
    counts = np.full((60, 80), 100, np.uint8)
    counts[5, 5] = counts[8, 9:13] = 255
    assert not glare(counts).any()
    counts[30:40, 40:52] = 255
    found = glare(counts)
    assert found[30:40, 40:52].all() and found[26, 45] and not found[:20].any()


def good(counts, rng):
    return counts


def flat_half(counts, rng):
    out = np.where(np.arange(480)[:, None] < 240, 0.3 * np.median(counts), counts)
    return np.rint(out + 1.5 * rng.standard_normal(out.shape)).clip(0, 255).astype(np.uint8)


def veiled_half(counts, rng):
    out = counts + 0.8 * (np.median(counts) - counts) * (np.arange(640) < 320)
    return np.rint(out + 0.6 * rng.standard_normal(out.shape)).clip(0, 255).astype(np.uint8)


def defocused_disc(counts, rng):
    v, u = np.mgrid[:480, :640]
    blurred = cv2.GaussianBlur(counts.astype(np.float32), (0, 0), 5.0)
    out = np.where(np.hypot(v - 240, u - 320) < 180, blurred, counts)
    return np.rint(out + 0.6 * rng.standard_normal(out.shape)).clip(0, 255).astype(np.uint8)


def saturated_disc(counts, rng):
    v, u = np.mgrid[:480, :640]
    return np.where(np.hypot(v - 240, u - 320) < 90, 255, counts).astype(np.uint8)


@pytest.mark.parametrize("spoil", [good, flat_half, veiled_half, defocused_disc, saturated_disc])
def test_terrain_behind_a_part_that_shows_nothing_is_not_seen(spoil):
    terrain = rocky(3, 0.08, 0.0, "cube")
    state, camera, counts = picture(terrain, PLACE)
    rng = np.random.default_rng(2)
    place = ProbabilityMap(Grid.centred((0.0, 0.0), 36.0, 0.5), MODEL, HazardPrior(0.08, 0.5))
    mapper = ShadowMapper(tracker_at(PLACE), place, SUN, 1.0)
    rocks = mapper.tracker.filter
    for k in range(3):
        frame = (counts + rng.integers(-1, 2, counts.shape)).clip(0, 255).astype(np.uint8)
        estimate = rocks.inertial.estimate(rocks.covariance, 0.1 * k, 1.0)
        mapper.update(CameraImage(0.1 * k, spoil(frame, rng), camera.model), estimate)
    assert mapper.rejected_images.total() == 0
    observed = mapper.probability.observed
    xy = np.stack(np.meshgrid(place.grid.x, place.grid.y), -1).reshape(-1, 2)
    view = camera.model.view(state)
    x, y, z = view.enu_to_sensor @ (np.column_stack((xy, np.zeros(len(xy)))) - view.position).T
    u, v = view.fx * x / z + view.cx, view.fy * y / z + view.cy
    behind = {
        good: np.zeros(len(xy), bool), flat_half: v < 225, veiled_half: u < 290,
        defocused_disc: np.hypot(u - 320, v - 240) < 120,
        saturated_disc: np.hypot(u - 320, v - 240) < 85,
    }[spoil].reshape(observed.shape)  # fmt: skip
    assert not observed[behind].any()
    # Windows that reach over a part that shows nothing are not seen whole.
    assert observed[~behind].mean() > (0.5 if spoil is good else 0.01)
