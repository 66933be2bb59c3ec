"""The plane on which rocks stand, from what another mapper has measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.shadows.terrain_errors import fit_terrain_plane

GRID = Grid.centred((40.0, -30.0), 80.0, 0.5)


def mapped(gradient, seen=1.0, noise=0.0):
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(GRID.x, GRID.y)
    z = 7.0 + gradient[0] * x + gradient[1] * y + rng.normal(0.0, noise, GRID.shape)
    observed = rng.random(GRID.shape) < seen
    z[~observed] = np.nan
    drawn = HazardMap.unobserved(GRID)
    return replace(drawn, observed=observed, elevation=z.astype(np.float32))


def test_the_plane_is_that_of_what_was_measured():
    plane = fit_terrain_plane(mapped((0.12, -0.08), seen=0.4, noise=0.3))
    assert plane.gradient == pytest.approx((0.12, -0.08), abs=2e-3)
    assert plane.heights(np.array([[40.0, -30.0]])) == pytest.approx(7.0 + 4.8 + 2.4, abs=0.05)


def test_what_is_no_elevation_or_was_not_observed_says_nothing():
    drawn = mapped((0.12, -0.08))
    z, observed = drawn.elevation.copy(), drawn.observed.copy()
    z[:40], z[40:60], observed[60:80] = np.nan, np.inf, False
    z[60:80] = 1e3
    plane = fit_terrain_plane(replace(drawn, elevation=z, observed=observed))
    assert plane.gradient == pytest.approx((0.12, -0.08), abs=1e-4)
    z[:] = np.nan
    assert fit_terrain_plane(replace(drawn, elevation=z)) is None
    assert fit_terrain_plane(replace(drawn, elevation=None)) is None


@pytest.mark.parametrize(("gradient", "seen"), [((0.1, 0.0), 0.2), ((0.28, 0.2), 1.0)])
def test_too_little_and_too_steep_terrain_give_none(gradient, seen):
    assert fit_terrain_plane(mapped(gradient, seen)) is None


@pytest.mark.parametrize(("corner", "diameter"), [((35.0, 35.0), 40.0), ((45.0, 0.0), 60.0)])
def test_part_of_a_crater_does_not_give_the_slope_of_the_terrain(corner, diameter):
    """Its wall fills the half or quarter that was seen; the whole map slopes by 0.02 or less."""
    x, y = np.meshgrid(GRID.x - 40.0, GRID.y + 30.0)
    away = np.hypot(x - corner[0], y - corner[1]) / (0.5 * diameter)
    z = np.where(away < 1.0, 0.18 * away**2 - 0.15, 0.03 * np.exp(3.0 - 3.0 * away)) * diameter
    seen = (x > 0.0) & ((y > 0.0) | (corner[1] == 0.0))
    drawn = replace(mapped((0.0, 0.0)), elevation=z.astype(np.float32))
    assert fit_terrain_plane(replace(drawn, observed=seen)) is None
    # The same part of a slope does.
    slope = replace(mapped((0.08, 0.05), noise=0.3), observed=seen)
    assert fit_terrain_plane(slope).gradient == pytest.approx((0.08, 0.05), abs=5e-3)
    # All of it is seen to be level, but for that.
    whole = fit_terrain_plane(drawn)
    assert whole is None or np.hypot(*whole.gradient) < 0.03


def test_a_map_of_few_cells_reports_what_they_do():
    few = Grid.centred((0.0, 0.0), 3.0, 1.0)
    x, _ = np.meshgrid(few.x, few.y)
    drawn = replace(HazardMap.unobserved(few), elevation=(0.1 * x).astype(np.float32))
    seen = np.ones(few.shape, bool)
    assert fit_terrain_plane(replace(drawn, observed=seen)).gradient[0] == pytest.approx(0.1)
    # Three in a row tell nothing of how it rises across.
    seen[1:] = False
    assert fit_terrain_plane(replace(drawn, observed=seen)).gradient == pytest.approx((0.1, 0.0))
