"""Ground about which a picture is lit far and wide is found lit as if each place had been asked."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from lunarsim.onboard.hazards.shadows import _evidence_kernels as kernels
from lunarsim.onboard.hazards.shadows._lit_tile_kernels import lit_tiles, max_radius_of_blocks
from tests.reference import looks as plain

EVERY = 16
RADII = np.array([0.3, 0.5])
# Of patches: the lit ground, rocks small and large, one tracked, one of any size.
LARGEST = np.array([0.0, 0.35, 0.8, -0.7, np.inf], np.float32)


def scene(rng, reach):
    """Return nodes about the origin, a camera that looks down on them aslant, and its picture."""
    x, y = np.meshgrid(4.0 * np.arange(4) - 6.0, 4.0 * np.arange(3) - 4.0)
    points = 2 * 3
    coarse = np.dstack((
        np.ones_like(x), x, y, rng.normal(0.0, 0.3, x.shape),
        reach * rng.uniform(0.0, 1.0, x.shape), rng.uniform(-2.0, 2.0, (*x.shape, 2 * points)),
    ))  # fmt: skip
    position = np.array([*rng.uniform(-4.0, 4.0, 2), rng.uniform(9.0, 16.0)])
    forward = np.array([*rng.normal(0.0, 1.0, 2), 0.0]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.3, 1.0, 0.0])
    right /= np.linalg.norm(right)
    axes = np.column_stack((right, np.cross(forward, right), forward))
    labels = np.zeros((100, 120), np.int32)
    for _ in range(rng.integers(0, 9)):
        row, col = rng.integers(0, 100), rng.integers(0, 120)
        size = rng.integers(1, 9, 2)
        labels[row : row + size[0], col : col + size[1]] = rng.integers(1, len(LARGEST))
    return coarse, position, axes, (rng.uniform(60.0, 130.0), 100.0, 59.5, 49.5), labels


@pytest.mark.parametrize("every", [16, 11, 26])
@pytest.mark.parametrize(("seed", "reach"), [(s, r) for s in range(8) for r in (0.0, 0.6, 3.0)])
def test_what_is_found_by_tiles_is_what_each_place_shows(seed, reach, every):
    rng = np.random.default_rng([seed, int(10.0 * reach)])
    coarse, position, axes, lens, labels = scene(rng, reach)
    shape = (len(RADII), 2 * every, 3 * every)
    lit, dark = np.zeros((2, *shape), np.float32)
    named = np.zeros(shape, np.bool_)
    kernels.record_observation(
        lit, dark, named, RADII, coarse, every, position, axes, *lens, labels, LARGEST, 2, 1.03, 2
    )
    some = rng.choice(lit[0].size, 80, replace=False)
    for s, place in product(range(len(RADII)), some):
        i, j = divmod(int(place), shape[2])
        found = plain.look(
            coarse, i / every, j / every, RADII[s], position, axes, lens, labels, LARGEST, 2, 2
        )
        assert (lit[s, i, j] > 0.0, dark[s, i, j] > 0.0, named[s, i, j]) == found


@pytest.mark.parametrize("seed", range(6))
def test_single_dark_pixels_are_found_at_whatever_height_they_show(seed):
    """Where many heights are asked at once, and boxes of few pixels."""
    rng = np.random.default_rng([seed, 7])
    coarse, position, axes, lens, labels = scene(rng, 3.0)
    coarse[..., 5:] *= 0.3
    labels[:] = 0
    labels[rng.integers(0, 100, 40), rng.integers(0, 120, 40)] = len(LARGEST) - 1
    shape = (len(RADII), 2 * EVERY, 3 * EVERY)
    lit, dark = np.zeros((2, *shape), np.float32)
    named = np.zeros(shape, np.bool_)
    kernels.record_observation(
        lit, dark, named, RADII, coarse, EVERY, position, axes, *lens, labels, LARGEST, 2, 1.03, 2
    )
    for s, place in product(range(len(RADII)), rng.choice(lit[0].size, 150, replace=False)):
        i, j = divmod(int(place), shape[2])
        found = plain.look(
            coarse, i / EVERY, j / EVERY, RADII[s], position, axes, lens, labels, LARGEST, 2, 2
        )
        assert (lit[s, i, j] > 0.0, dark[s, i, j] > 0.0, named[s, i, j]) == found


@pytest.mark.parametrize("worse", [np.nan, np.inf])
def test_nothing_is_lit_where_a_point_of_the_core_is_no_number(worse):
    coarse, position, axes, lens, labels = scene(np.random.default_rng(3), 0.0)
    labels[:] = 0
    coarse[1, 2, 7] = worse
    shape = (len(RADII), 2 * EVERY, 3 * EVERY)
    lit, dark = np.zeros((2, *shape), np.float32)
    named = np.zeros(shape, np.bool_)
    kernels.record_observation(
        lit, dark, named, RADII, coarse, EVERY, position, axes, *lens, labels, LARGEST, 2, 1.03, 2
    )
    about = (slice(None), slice(1, 2 * EVERY), slice(EVERY + 1, 3 * EVERY))
    assert lit.any() and not lit[about].any()


def test_most_tiles_of_such_scenes_are_lit_and_found_so():
    """So what the test above compares is found by tiles, and where it is not, by places."""
    shares = []
    for seed in range(8):
        coarse, position, axes, lens, labels = scene(np.random.default_rng([seed, 6]), 0.6)
        off = coarse[..., 1:4] - position
        cores = coarse[..., 5:].reshape(*off.shape[:2], -1, 2) @ axes[:2]
        nodes = np.concatenate(
            (coarse[..., [0, 4]], off, off @ axes, *np.moveaxis(cores, -1, 0)), axis=-1
        )
        of = LARGEST[labels].ravel()
        blocks = max_radius_of_blocks(of, *labels.shape)
        clear = lit_tiles(nodes, EVERY, RADII, axes[2], lens, *labels.shape, of, blocks)
        shares.append(clear.mean())
    assert 0.3 < np.mean(shares) < 0.95
