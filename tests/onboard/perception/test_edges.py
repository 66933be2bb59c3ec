"""Edges of shadows: their width against that of drawn ones, and the kernels against plain loops."""

from __future__ import annotations

from dataclasses import fields, replace

import cv2
import numpy as np
import pytest

from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.edge_widths import EdgeWidths, edge_widths
from lunarsim.onboard.perception.image_quality import MAX_SMEAR_RATIO
from tests.shadow_scene import SUN, at


def drawn(sigma, smear=0):
    """Dark squares of many sides on lit ground, through a point spread of a width."""
    rng = np.random.default_rng(0)
    scale = 8
    fine = np.full((480 * scale, 640 * scale), 100.0, np.float32)
    for row in range(20, 440, 55):
        for col in range(20, 600, 55):
            side = int(scale * rng.uniform(10, 16))
            i, j = scale * row + rng.integers(scale), scale * col + rng.integers(scale)
            fine[i : i + side, j : j + side] = 4.0
    fine = cv2.GaussianBlur(fine, (0, 0), sigma * scale)
    if smear:
        fine = cv2.blur(fine, (smear * scale, 1))
    # Point samples, as a detector of tiny pixels takes them.
    counts = np.rint(fine[scale // 2 :: scale, scale // 2 :: scale]).astype(np.uint8)
    state, camera = at((0.0, 0.0, 30.0))
    return detect_rocks(counts, camera, state, SUN)


@pytest.mark.parametrize("sigma", [0.6, 1.0, 1.5])
def test_edges_are_as_wide_as_they_were_drawn(sigma):
    found = edge_widths(drawn(sigma), 0.01)
    assert found.number > 50
    assert found.sharpest == pytest.approx(EdgeWidths.expected(sigma), rel=0.12)
    assert found.least_sharp_direction < 1.45 * EdgeWidths.expected(sigma)


def test_a_smear_shows_along_its_direction_alone():
    found = edge_widths(drawn(0.6, smear=10), 0.01)
    # Edges along the smear are as sharp as ever.
    assert found.sharpest < 1.2 * EdgeWidths.expected(0.6)
    # A box of ten pixels has a standard deviation of 2.9; its edge is as steep as a tenth.
    assert found.least_sharp_direction > 2.0 * EdgeWidths.expected(0.6)


def test_a_lit_face_beside_a_shadow_does_not_blur_the_shadows_other_edges():
    """Seen from the Sun's side, a rock is half as bright again as the ground, right by its shadow.

    The shadow's ends lie beside the face: compared with the range from dark to bright all about,
    their step down from the ground passed for the foot of a wide edge.
    """
    rng = np.random.default_rng(0)
    scale = 8
    fine = np.full((480 * scale, 640 * scale), 60.0, np.float32)
    for row in range(20, 440, 55):
        for col in range(20, 600, 55):
            i, j = scale * row + rng.integers(scale), scale * col + rng.integers(scale)
            # Four pixels of shadow, as many of the face below them, slanting ends.
            for k in range(5 * scale):
                lean = k // 3
                fine[i + k, j - lean : j + 12 * scale + lean] = 4.0
                fine[i + 5 * scale + k, j - lean : j + 12 * scale + lean] = 150.0
    counts = {}
    for name, length in (("still", 1), ("smeared", 5 * scale)):
        soft = cv2.GaussianBlur(cv2.blur(fine, (length, 1)), (0, 0), 0.6 * scale)
        counts[name] = np.rint(soft[scale // 2 :: scale, scale // 2 :: scale]).astype(np.uint8)
    state, camera = at((0.0, 0.0, 30.0))
    widths = {n: edge_widths(detect_rocks(c, camera, state, SUN), 0.01) for n, c in counts.items()}
    most = MAX_SMEAR_RATIO * EdgeWidths.expected(0.6)
    assert widths["still"].number > 50
    assert widths["still"].least_sharp_direction < most < widths["smeared"].least_sharp_direction


def test_nothing_to_measure_is_not_sharp():
    seen = drawn(0.6)
    none = {
        f.name: getattr(seen, f.name)[:0]
        for f in fields(seen)
        if f.name not in {"labels", "excluded_labels", "relative"}
    }
    found = edge_widths(replace(seen, **none), 0.01)
    assert (found.number, found.sharpest, found.least_sharp_direction) == (0, np.inf, np.inf)


def test_noise_is_no_edge():
    seen = drawn(4.0)
    rng = np.random.default_rng(3)
    under_noise = (seen.relative_to_lit_terrain + 0.1 * rng.standard_normal((480, 640))).astype(
        np.float32
    )
    found = edge_widths(replace(seen, relative_to_lit_terrain=under_noise), 0.1)
    assert found.number == 0 or found.sharpest > 2.0
    # Told that there is none, it takes noise for edges.
    assert edge_widths(replace(seen, relative_to_lit_terrain=under_noise), 0.0).sharpest < 2.0
