"""What a picture draws, against plain references."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import sensor_axes
from lunarsim.grid import Grid
from lunarsim.sensors.rendering import _small_rock_kernels as small_rocks
from lunarsim.sensors.rendering import _tile_kernels as kernels
from lunarsim.sensors.rendering.relief_tiles import ReliefTiles
from lunarsim.world.terrain import fractal_relief
from tests.reference import rendering as plain


@pytest.mark.parametrize("seed", range(12))
def test_tiles_are_chosen_as_by_the_reference(seed):
    rng = np.random.default_rng(seed)
    side = float(rng.uniform(60.0, 300.0))
    relief = fractal_relief(Grid.centred((0.0, 0.0), side, 1.0), rng, hurst=0.8, rms_slope=0.1)
    tiles = ReliefTiles.of(relief)
    eye = np.array([*rng.uniform(-0.7, 0.7, 2) * side, rng.uniform(5.0, 300.0)])
    axes = sensor_axes([*rng.normal(size=2), -abs(rng.normal())])
    bounds = np.array([-1.0, 1.0, -1.0, 1.0]) * rng.uniform(0.1, 1.5, 4)
    tolerance, shadow_tolerance = rng.uniform(1e-5, 3e-3, 2)
    choice = tiles.choose(eye, axes, bounds, 0.5, tolerance, shadow_tolerance)
    boxes = list(zip(tiles.low, tiles.high, strict=True))
    shown = [plain.tile_in_view(*box, eye, axes, bounds, 0.5) for box in boxes]
    assert choice.shown.tolist() == shown
    distance = np.array([plain.distance_of_box(*box, eye) for box in boxes])
    for n, d in enumerate(distance):
        error = tiles.error[:, n]
        assert choice.shadow_level[n] == plain.coarsest_level(error, shadow_tolerance * d)
        # Steep rays are mended in the picture, up to fourfold.
        strict = plain.coarsest_level(error, tolerance * d)
        loose = plain.coarsest_level(error, 4.0 * tolerance * d)
        assert strict <= choice.level[n] <= loose
    if any(shown):
        assert choice.nearest == pytest.approx(distance[choice.shown].min())
        assert np.array_equal(choice.low, tiles.low[choice.shown].min(0))
        assert np.array_equal(choice.high, tiles.high[choice.shown].max(0))


def test_a_tile_straight_below_may_be_four_times_as_coarse():
    error = np.array([[0.0], [0.1], [0.39], [0.5]])
    low, high = np.array([[-1.0, -1.0, 0.0]]), np.array([[1.0, 1.0, 0.0]])
    args = (np.eye(3), np.array([-1.0, 1.0, -1.0, 1.0]), 0.1, 1e-3, 1e-3)
    below = kernels.choose_tiles(low, high, error, np.array([0.0, 0.0, 100.0]), *args)
    aside = kernels.choose_tiles(low, high, error, np.array([0.0, 400.0, 100.0]), *args)
    assert below[1].tolist() == [2]
    assert below[2].tolist() == [1]
    assert aside[1].tolist() == aside[2].tolist() == [2]  # farther, but not mended


def test_neighbours_of_tiles_meet_at_their_edges():
    rng = np.random.default_rng(0)
    relief = fractal_relief(Grid.centred((0.0, 0.0), 150.0, 1.0), rng, hurst=0.8, rms_slope=0.1)
    tiles = ReliefTiles.of(relief)
    place = {tuple(first): n for n, first in enumerate(tiles.first.tolist())}
    for (column, row), n in place.items():
        steps = ((-32, 0), (32, 0), (0, -32), (0, 32))
        expected = [place.get((column + dx, row + dy), n) for dx, dy in steps]
        assert tiles.neighbour[n].tolist() == expected


def test_corners_of_cells_and_least_depths():
    rng = np.random.default_rng(1)
    z = rng.normal(size=(7, 9)).astype(np.float32)
    z[2, 3] = np.nan
    made = kernels.cell_corners(z, 2.0)
    assert np.array_equal(
        made, plain.cell_corners(z.astype(float), 2.0).astype("f4"), equal_nan=True
    )
    points = np.column_stack(
        (rng.integers(0, 6, 200), rng.integers(0, 5, 200), rng.random(200))
    ).astype(np.float32)
    hit = rng.random(200) < 0.7
    assert np.array_equal(
        small_rocks.min_depth(points, hit, 5, 6), plain.least_map(points, hit, 5, 6)
    )
