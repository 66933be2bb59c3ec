from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.world.terrain import Heightfield, place_rocks
from tests.worlds import flat_terrain


def test_placed_rocks_do_not_overlap_and_stand_on_the_relief():
    terrain = flat_terrain(size=60.0, level=3.0)
    rng = np.random.default_rng(2)
    rocks = place_rocks(terrain.relief, sample_diameters(3600.0, 0.1, 0.15, 3.0, rng), rng)
    gap = np.hypot(rocks.x[:, None] - rocks.x, rocks.y[:, None] - rocks.y)
    reach = rocks.a[:, None] + rocks.a
    np.fill_diagonal(gap, np.inf)
    assert (gap >= reach).all()
    assert np.allclose(rocks.base, 3.0)


def test_rocks_do_not_overlap_on_a_long_map_far_from_the_origin():
    grid = Grid(x0=2000.0, y0=-900.0, posting=1.0, rows=121, cols=31)
    relief = Heightfield(grid, np.zeros(grid.shape, np.float32))
    rng = np.random.default_rng(6)
    rocks = place_rocks(relief, rng.uniform(0.2, 2.0, 400), rng)
    gap = np.hypot(rocks.x[:, None] - rocks.x, rocks.y[:, None] - rocks.y)
    np.fill_diagonal(gap, np.inf)
    assert (gap >= rocks.a[:, None] + rocks.a).all()
    west, east, south, north = relief.bounds
    assert ((rocks.x > west) & (rocks.x < east) & (rocks.y > south) & (rocks.y < north)).all()
    assert np.ptp(rocks.y) > 0.9 * (north - south)


def test_same_seed_same_rocks():
    terrain = flat_terrain()
    fields = [
        place_rocks(terrain.relief, np.full(50, 0.5), np.random.default_rng(7)) for _ in range(2)
    ]
    assert np.array_equal(fields[0].x, fields[1].x)


def test_overfull_field_is_refused():
    with pytest.raises(InputError, match="must be smaller"):
        place_rocks(flat_terrain(size=10.0).relief, np.full(500, 1.5), np.random.default_rng(1))


@pytest.mark.parametrize("shape", ["hemisphere", "ellipsoid", "cube", "irregular", "mixed"])
def test_rocks_of_every_shape_do_not_overlap_and_reach_the_terrain(shape):
    rng = np.random.default_rng(4)
    ground = flat_terrain(60.0).relief
    diameters = sample_diameters(3600.0, 0.15, 0.2, 3.0, rng)
    rocks = place_rocks(ground, diameters, rng, model=RockModel(shape))
    assert len(rocks) == diameters.size
    centres = np.column_stack((rocks.x, rocks.y))
    reach = rocks.reach()
    i, j = cKDTree(centres).query_pairs(4.0, output_type="ndarray").T
    assert len(i) > 100
    gap = np.hypot(*(centres[i] - centres[j]).T) - reach[i] - reach[j]
    assert gap.min() >= -1e-9
    assert np.all(rocks.base <= 1e-12)
    assert np.all(rocks.base + rocks.height > 0.0)


@pytest.mark.parametrize("shape", ["ellipsoid", "irregular"])
def test_covered_area_and_height_above_terrain_follow_the_model(shape):
    """One rock of 1 m, many times: the area at ground level and the height above it."""
    rng = np.random.default_rng(8)
    model = RockModel(shape, height_ratio=(0.45, 0.08), burial=(0.1, 0.4))
    rocks = model.draw(np.ones(4000), rng)
    visible = rocks.base + rocks.height
    assert visible.mean() == pytest.approx(0.45, abs=0.005)
    assert visible.std() == pytest.approx(0.08, abs=0.005)
    buried = -rocks.base / rocks.height
    assert buried.min() >= 0.1 and buried.max() <= 0.4
    if shape == "ellipsoid":  # its section at the ground has the area of the disc
        section = np.pi * rocks.a * rocks.b * (1.0 - buried**2)
    else:  # its outline has
        section = np.pi * rocks.a * rocks.b
    assert np.allclose(section, np.pi / 4.0)


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("shape", {"shape": "sphere"}),
        ("height_ratio", {"height_ratio": (0.0, 0.1)}),
        ("burial", {"burial": (0.5, 0.2)}),
        ("axis_ratio", {"axis_ratio": (0.0, 1.0)}),
    ],
)
def test_bad_rock_models_are_refused(field, values):
    with pytest.raises(InputError, match=f"rocks.{field}"):
        RockModel(**values)
