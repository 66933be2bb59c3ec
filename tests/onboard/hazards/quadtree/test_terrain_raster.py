"""Test the terrain raster of a quadtree and the residual heights of its points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.quadtree import QuadtreeMap, SiteSelector, SiteSettings
from lunarsim.onboard.hazards.quadtree.site_evidence import quadtree_site_evidence
from lunarsim.onboard.hazards.quadtree.terrain_raster import (
    close_holes,
    residual_heights,
    sampling_coverage,
    terrain_raster,
)
from lunarsim.rocks.population import RockExpectation
from tests.reference import quadtree as reference


def mapped(points: np.ndarray) -> QuadtreeMap:
    quadtree = QuadtreeMap((0.0, 0.0, 100.0), 12.8, 0.1)
    quadtree.insert(points)
    return quadtree


def scattered(rng: np.random.Generator, count: int, side: float = 12.8) -> np.ndarray:
    xy = rng.uniform(-0.5 * side, 0.5 * side, (count, 2))
    return np.column_stack((xy, 100.0 + 0.15 * xy[:, 0] - 0.1 * xy[:, 1]))


@pytest.mark.parametrize("count", [60, 400, 6000])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_surface_is_that_of_a_plain_search(count, seed):
    rng = np.random.default_rng(seed)
    points = scattered(rng, count, 10.0)
    points[:, 2] += rng.normal(0.0, 0.3, count)
    quadtree = mapped(points)
    height, grid = terrain_raster(quadtree, 0.4, 1.6)
    assert (grid.posting, grid.shape) == (0.4, (32, 32))
    nodes = quadtree.band(0.4, 1.6)
    cells = np.column_stack((
        quadtree.centres(nodes), quadtree.sizes(nodes), quadtree.elevation(nodes)
    ))  # fmt: skip
    expected = reference.surface(cells, grid.centres(), 0.4)
    assert height == pytest.approx(expected, abs=1e-6, nan_ok=True)


def test_a_plane_seen_thinly_keeps_its_slope():
    rng = np.random.default_rng(3)
    quadtree = mapped(scattered(rng, 900))
    height, grid = terrain_raster(quadtree, 0.4, 1.6)
    xy = grid.centres()
    plane = 100.0 + 0.15 * xy[..., 0] - 0.1 * xy[..., 1]
    middle = (np.abs(xy) < 4.0).all(axis=-1)
    # Points are anywhere in their cells.
    assert np.abs(height - plane)[middle].mean() < 0.03
    east = np.gradient(height, grid.posting, axis=1)[middle].mean()
    assert east == pytest.approx(0.15, abs=0.01)


def test_terrain_far_from_any_point_is_unknown():
    rng = np.random.default_rng(4)
    points = scattered(rng, 4000)
    height, grid = terrain_raster(mapped(points[points[:, 0] < -1.0]), 0.4, 1.6)
    east = grid.centres()[..., 0]
    assert np.isfinite(height[east < -1.0]).all()
    assert np.isnan(height[east > 4.0]).all()


def test_rises_are_the_heights_above_the_terrain_about():
    rng = np.random.default_rng(5)
    points = scattered(rng, 20_000)
    # Boxes of 0.2 m, one every 1.4 m.
    tall = (points[:, :2] % 1.4 < 0.2).all(axis=1)
    points[:, 2] += np.where(tall, 0.4, 0.0) + rng.normal(0.0, 0.01, len(points))
    found = residual_heights(mapped(points))
    # A box hit by one point counts as a bird.
    assert tall.mean() - 0.003 < (found > 0.3).mean() <= tall.mean()
    assert (np.abs(found) < 0.1).mean() > 0.97


@pytest.mark.parametrize("seed", range(5))
def test_holes_are_filled_as_by_a_plain_search(seed):
    rng = np.random.default_rng(seed)
    height = rng.normal(0.0, 1.0, (14, 17))
    height[rng.random(height.shape) < 0.1] = np.nan
    for width in (0.3, 0.9, 1.3):
        filled = close_holes(height + 1e7, 0.4, width) - 1e7
        expected = reference.without_holes(height, int(np.ceil(width / 0.8)))
        assert filled == pytest.approx(expected, abs=1e-8, nan_ok=True)


def test_a_filled_plane_keeps_its_slope_and_its_rocks_and_loses_narrow_holes():
    row, col = np.mgrid[0:30, 0:30]
    plane = 0.05 * row - 0.03 * col
    rocks, holes = plane.copy(), plane.copy()
    rocks[10:12, 10:12] += 0.5
    holes[10:12, 10:12] -= 0.5
    inside = np.s_[4:-4, 4:-4]
    assert close_holes(plane, 0.4, 1.5)[inside] == pytest.approx(plane[inside])
    assert close_holes(rocks - plane, 0.4, 1.5) == pytest.approx(rocks - plane)
    # A depression between a rock and rising terrain behind it is a hole.
    assert (close_holes(rocks, 0.4, 1.5) <= rocks.max()).all()
    assert close_holes(rocks, 0.4, 1.5)[10:12, 10:12] == pytest.approx(rocks[10:12, 10:12])
    assert np.abs(close_holes(holes, 0.4, 1.5) - plane)[inside].max() < 0.17
    # A wider depression remains.
    holes[10:20, 10:20] -= 0.5
    assert close_holes(holes, 0.4, 1.5)[15, 15] == pytest.approx(holes[15, 15], abs=0.2)


def test_a_map_without_points_has_no_terrain():
    quadtree = QuadtreeMap((0.0, 0.0), 12.8, 0.1)
    assert np.isnan(terrain_raster(quadtree, 0.4, 1.6)[0]).all()
    assert len(residual_heights(quadtree)) == 0


@pytest.mark.parametrize("density", [40, 70, 100])
@pytest.mark.parametrize("width", [1.0, 1.4, 2.0])
@pytest.mark.parametrize("corner", [0.0, 0.13, 0.7])
def test_a_hole_that_chance_would_not_leave_is_a_gap(density, width, corner):
    rng = np.random.default_rng(6)
    points = scattered(rng, int(density * 12.8**2))
    hole = (np.abs(points[:, :2] - corner) < 0.5 * width).all(axis=1)
    quadtree = mapped(points[~hole])
    seen = sampling_coverage(quadtree)
    middle = (np.abs(seen.grid.centres() - corner) < 0.25).all(axis=-1)
    assert seen.gap[middle].any()
    height, grid = terrain_raster(quadtree, 0.4, 1.6, seen)
    near = (np.abs(grid.centres() - corner) < 0.5 * width).all(axis=-1)
    assert np.isnan(height[near]).any()
    # Observed terrain remains observed.
    away = (np.abs(seen.grid.centres() - corner) > 0.5 * width + 0.5).any(axis=-1)
    assert seen.gap[away & (np.abs(seen.grid.centres()) < 6.0).all(axis=-1)].mean() < 0.002


def test_a_trench_that_no_return_came_out_of_is_a_gap():
    rng = np.random.default_rng(7)
    points = scattered(rng, 60 * 164)
    points = points[np.abs(points[:, 0] - 0.3) > 0.35]
    seen = sampling_coverage(mapped(points))
    inside = np.abs(seen.grid.centres()[..., 0] - 0.3) < 0.2
    assert seen.gap[inside].mean() > 0.9


@pytest.mark.parametrize("density", [200, 600])
def test_terrain_beside_a_patch_seen_often_is_as_well_seen_as_without_it(density):
    rng = np.random.default_rng(16)
    coarse = scattered(rng, 40 * 164)
    patch = scattered(rng, 25 * density, 5.0)
    seen = sampling_coverage(mapped(np.concatenate((coarse, patch))))
    outside = (np.abs(seen.grid.centres()) > 2.6).any(axis=-1)
    assert not sampling_coverage(mapped(coarse)).gap.any()
    assert seen.gap[outside].mean() < 0.001


def test_coarse_terrain_between_patches_is_evaluated_by_what_lies_near_it():
    rng = np.random.default_rng(17)
    coarse = scattered(rng, 40 * 164)
    strips = scattered(rng, 600 * 164)
    strips = strips[np.abs(strips[:, 0]) > 2.4]
    seen = sampling_coverage(mapped(np.concatenate((coarse, strips))))
    assert seen.gap[np.abs(seen.grid.centres()[..., 0]) < 0.6].mean() < 0.001


def test_density_is_that_of_a_plain_count():
    rng = np.random.default_rng(8)
    points = scattered(rng, 5000, 9.0)
    seen = sampling_coverage(mapped(points))
    xy = seen.grid.centres()
    for row, col in rng.integers(8, 56, (20, 2)):
        # Differences at cell edges are due to float32.
        inside = (np.abs(points[:, :2] - xy[row, col]) < 0.5).all(axis=1).sum()
        assert seen.density[row, col] == pytest.approx(inside, abs=2)


def evidence(points: np.ndarray, side: float = 12.8):
    """Return the site features of a quadtree of points, and the site positions (n, 2)."""
    lander = replace(Lander(), leg_radius=1.0, pad_diameter=0.2)
    quadtree = QuadtreeMap((0.0, 0.0, 100.0), side, 0.1)
    quadtree.insert(points)
    settings = SiteSettings(zone_half_side=1.5, mesh_band=(1.6, 3.2))
    selection = SiteSelector(quadtree, settings, thorough=True, footprint=1.1).update()
    found = quadtree_site_evidence(quadtree, selection, 1.5, 0.01, lander, RockExpectation())
    return found, selection.position[:, :2]


def test_sites_whose_footprint_holds_a_gap_are_not_evaluated():
    rng = np.random.default_rng(9)
    points = scattered(rng, 60 * 164)
    whole, _ = evidence(points)
    # Within a cell of 1.6 m, so that each of its quarters still has points.
    hole = (np.abs(points[:, :2] - 0.8) < 0.5).all(axis=1)
    holed, xy = evidence(points[~hole])
    near = (np.abs(xy - 0.8) < 0.7).all(axis=1)
    assert whole.observed[near].all()
    assert not holed.observed[near].any()
    away = (np.abs(xy - 0.8) > 3.0).any(axis=1)
    assert (holed.observed == whole.observed)[away].all()


def test_a_footprint_is_as_thin_as_its_thinnest_metre():
    rng = np.random.default_rng(10)
    points = scattered(rng, 100 * 164)
    thin = (points[:, 0] > 0.0) & (rng.random(len(points)) < 0.7)
    found, xy = evidence(points[~thin])
    west, border = np.abs(xy[:, 0] + 3.2) < 0.5, np.abs(xy[:, 0] + 0.4) < 0.1
    inner = np.abs(xy[:, 1]) < 3.0
    assert np.median(found.min_density[west & inner]) == pytest.approx(80.0, abs=20.0)
    assert np.median(found.min_density[border & inner]) == pytest.approx(22.0, abs=10.0)
    assert np.median(found.density[border & inner]) > 50.0


def test_the_lander_stands_on_the_terrain_under_the_site():
    """Mirrored terrain gives mirrored evidence: no site uses a neighbouring cell."""
    rng = np.random.default_rng(11)
    xy = rng.uniform(-6.39, 6.39, (20_000, 2))
    # No point lies on an edge between cells, which belongs to the eastern cell.
    xy = xy[(np.abs(xy % 0.1 - 0.05) < 0.0499).all(axis=1)]
    bump = 0.6 * np.exp(-(((xy[:, 0] - 1.3) / 0.5) ** 2) - ((xy[:, 1] + 0.9) / 0.5) ** 2)
    points = np.column_stack((xy, 100.0 + bump))
    for axis in (0, 1):
        mirror = np.ones(3)
        mirror[axis] = -1.0
        found, place = evidence(points)
        other, seen = evidence(points * mirror)
        at = {tuple(np.round(p, 3)): n for n, p in enumerate(seen * mirror[:2])}
        pairs = [(n, at[tuple(np.round(p, 3))]) for n, p in enumerate(place)]
        mine, its = np.array(pairs).T
        assert np.nanmax(found.slope) > 0.3
        assert found.slope[mine] == pytest.approx(other.slope[its], abs=1e-3, nan_ok=True)
        assert found.roughness[mine] == pytest.approx(other.roughness[its], abs=1e-3, nan_ok=True)


def test_a_rock_and_a_slope_doom_a_site_and_a_hole_does_not():
    rng = np.random.default_rng(14)
    xy = scattered(rng, 30_000)[:, :2]
    # A square under the western leg of the central site.
    bad = (np.abs(xy - [-0.8, 0.0]) < 0.4).all(axis=1)
    grounds = {
        "level": (0.0, False), "rock": (np.where(bad, 0.6, 0.0), True),
        "hole": (np.where(bad, -0.6, 0.0), False), "slope": (0.4 * xy[:, 0], True),
    }  # fmt: skip
    for name, (height, doomed) in grounds.items():
        found, place = evidence(np.column_stack((xy, 100.0 + height + np.zeros(len(xy)))))
        middle = np.argmin(np.abs(place).sum(axis=1))
        assert found.observed[middle]
        over = max(found.slope[middle], found.roughness[middle]) > 1.0
        assert over == (name != "level"), name
        assert found.may_be_unsafe[middle] == doomed, name


def test_one_return_low_above_the_terrain_may_be_a_rock_and_a_high_one_is_not():
    rng = np.random.default_rng(12)
    points = scattered(rng, 20_000)
    points[::400, 2] += 0.5
    points[200::400, 2] += 7.0
    quadtree = mapped(points)
    assert quadtree.is_outlier.sum() > 60
    found = residual_heights(quadtree)
    assert ((found > 0.4) & (found < 0.6)).sum() == 50
    # Except points that are alone in their cell, which cannot be classified.
    assert (found > 1.0).sum() <= 10
