"""Light and shadow on ground whose slopes are dark and bright."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lunarsim.onboard.perception.segmentation import segment

SHADOWS = [(60, 70, 5, 9), (200, 300, 8, 4), (350, 500, 12, 6), (410, 90, 6, 6), (120, 560, 9, 9)]


def ground(slopes, seed=0, side=40):
    """Slopes whose brightness is drawn from some, with a shadow of each size on them."""
    rng = np.random.default_rng(seed)
    facets = rng.choice(slopes, (480 // side, 640 // side))
    image = 100.0 * cv2.resize(facets, (640, 480), interpolation=cv2.INTER_LINEAR)
    shadow = np.zeros(image.shape, bool)
    for row, col, high, wide in SHADOWS:
        shadow[row : row + high, col : col + wide] = True
    image[shadow] = 2.0
    return image + rng.standard_normal(image.shape), shadow


@pytest.mark.parametrize("slopes", [(1.0,), (0.6, 1.0, 1.4), (0.45, 0.8, 1.0, 1.3)])
def test_dark_slopes_are_no_shadows_and_shadows_on_them_are(slopes):
    image, shadow = ground(slopes)
    found = segment(image).dark.astype(bool)
    assert found[shadow].mean() > 0.95
    assert found[~shadow].mean() < 0.001


def test_terrain_in_its_own_shadow_is_dark_as_a_whole():
    image, _ = ground((0.8, 1.0, 1.2))
    image[200:400, 100:400] = 3.0 + np.random.default_rng(1).standard_normal((200, 300))
    found = segment(image).dark.astype(bool)
    assert found[205:395, 105:395].mean() > 0.99


def test_terrain_that_ends_in_a_black_sky_shows_its_shadows():
    """Most of the picture is black, as beyond the edge of a terrain."""
    image, shadow = ground((0.9, 1.0, 1.1))
    image[:, :240] = image[240:] = 0.0
    kept = shadow.copy()
    kept[:, :240] = kept[240:] = False
    found = segment(image).dark.astype(bool)
    assert found[kept].mean() > 0.95
    assert found[10:230, 260:][~kept[10:230, 260:]].mean() < 0.01


@pytest.mark.parametrize("share", [0.55, 0.68])
def test_small_shadows_that_optics_fill_with_light_are_dark(share):
    """Two pixels by two that keep so much light; a slope as dark as that is not."""
    image, _ = ground((1.0,))
    image[300:302, 400:402] = 100.0 * share
    found = segment(image).dark.astype(bool)
    assert found[300:302, 400:402].all() == (share < 0.6)
    assert not segment(image).deep[300:302, 400:402].any()
