"""Blocks of relief turned away from the Sun: against the reference, and in pictures."""

import numpy as np
import pytest

from lunarsim.frames import sensor_axes
from lunarsim.grid import Grid
from lunarsim.models.pinhole import View
from lunarsim.sensors.rendering import _tile_kernels as kernels
from lunarsim.sensors.rendering.relief_tiles import ReliefTiles, ShadowCasterBlocks, level_mesh
from lunarsim.sensors.rendering.renderer import Renderer
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief
from tests.reference import rendering as plain


def sun_at(rng, least=0.1):
    azimuth, elevation = rng.uniform(0.0, 6.0), rng.uniform(least, 0.8)
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


@pytest.mark.parametrize("seed", range(6))
def test_blocks_are_those_with_a_face_turned_away(seed):
    rng = np.random.default_rng(seed)
    z = np.cumsum(rng.normal(0.0, 0.08, (41, 52)), axis=0).astype(np.float32)
    z[:, rng.integers(0, 50)] += 0.3
    if seed % 2:
        z[5, 6] = np.nan
    first = np.array([[0, 0], [16, 0], [48, 0], [32, 32], [48, 32]], dtype=np.int32)
    sun, p = sun_at(rng), 0.4
    lee = kernels.shadow_caster_blocks(z, first, 16, 4, p, sun, 0.95)
    assert 0 < lee.sum() < lee.size
    for tile, found in zip(first, lee, strict=True):
        for block in range(16):
            j, i = tile + 4 * np.array([block % 4, block // 4])
            part = z[i : i + 5, j : j + 5]
            wanted = min(part.shape) > 1 and not plain.all_lit(part, p, sun, 0.95)
            assert found[block] == wanted


def test_what_is_known_of_one_sun_is_not_held_for_another():
    rng = np.random.default_rng(3)
    grid = Grid.centred((0.0, 0.0), 150.0, 1.0)
    relief = fractal_relief(grid, rng, hurst=0.8, rms_slope=0.2)
    tiles = ReliefTiles.of(relief)
    kept = ShadowCasterBlocks(relief, tiles)
    for _ in range(4):
        sun = sun_at(rng)
        for _ in range(2):
            picked = np.flatnonzero(rng.random(len(tiles.first)) < 0.5)
            fine = np.zeros((len(picked), 4), np.int32)
            found = kept.of(picked, fine, sun, 0.5)
            assert np.array_equal(
                found, ShadowCasterBlocks(relief, tiles).of(picked, fine, sun, 0.5)
            )
    assert kept.of(picked, fine, sun, 3.1).all()  # texels far larger than cells: drawn whole
    assert not kept.of(picked, fine, sun, 2.9).all()
    # So are tiles with a coarser neighbour.
    coarse = fine.copy()
    coarse[0, 3] = coarse[2, 0] = 1
    found[[0, 2]] = True
    assert np.array_equal(kept.of(picked, coarse, sun, 0.5), found)


def test_triangles_of_a_block_stand_together():
    posts, triangles = level_mesh(0)
    corner = posts[triangles].reshape(16, 8 * 8 * 2, 3, 2)
    for block in range(16):
        at = 8 * np.array([block % 4, block // 4])
        assert (corner[block].min(axis=(0, 1)) == at).all()
        assert (corner[block].max(axis=(0, 1)) == at + 8).all()
    u, v = corner[..., 1, :] - corner[..., 0, :], corner[..., 2, :] - corner[..., 0, :]
    assert (u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0] == 1).all()  # all of the tile, once


@pytest.mark.parametrize("seed", range(4))
def test_images_are_those_with_all_blocks_drawn(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    grid = Grid.centred((0.0, 0.0), 150.0, 0.5)
    relief = fractal_relief(grid, rng, hurst=0.8, rms_slope=0.15)
    z = relief.z.copy()
    if seed == 3:
        z[40:60, 100:130] = np.nan
    terrain = Terrain(Heightfield(grid, z))
    views = []
    for height in (30.0, 100.0, 400.0, 1500.0):
        eye = np.array([*rng.uniform(-40.0, 40.0, 2), height])
        axes = sensor_axes(np.array([*rng.uniform(-30.0, 30.0, 2), 0.0]) - eye)
        sun = Light(azimuth=rng.uniform(0.0, 6.0), elevation=rng.uniform(0.06, 0.3))
        views.append((View(eye, axes, 4.0 * height, 4.0 * height, 99.5, 79.5, 200, 160), sun))
    found = [Renderer(terrain).render(*view).radiance for view in views]
    monkeypatch.setattr(
        ShadowCasterBlocks, "of", lambda _, picked, *__: np.ones((len(picked), 16), np.bool_)
    )
    for view, picture in zip(views, found, strict=True):
        assert np.array_equal(Renderer(terrain).render(*view).radiance, picture)
        assert (picture == 0.0).mean() > 1e-3  # there are shadows
