"""Craters that wear away by diffusion."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.world.terrain import AgedCraters, CraterLaw, Heightfield
from lunarsim.world.terrain.crater_ages import (
    MIN_RELATIVE_DEPTH,
    PROFILE_RADII,
    diffuse_profile,
    fresh_depth_ratio,
    max_crater_age,
    relative_depth,
)
from tests.reference import craters as reference


@pytest.mark.parametrize("age", [1e-3, 0.03, 0.2, 0.7])
def test_profiles_are_those_of_the_heat_equation(age):
    r = np.linspace(0.0, 4.5, 40)
    plain = reference.worn(r, np.zeros_like(r), 1.0, 1.0, age)
    # The corner of the rim is smooth to the reference's posts.
    assert np.abs(diffuse_profile(r, age) - plain).max() < 2e-3


def test_wear_takes_no_terrain_away():
    r = np.linspace(0.0, 12.0, 2401)
    fresh = np.trapezoid(diffuse_profile(r, 0.0) * r, r)
    for age in (0.01, 0.1, 0.5):
        assert np.trapezoid(diffuse_profile(r, age) * r, r) == pytest.approx(fresh, rel=2e-3)


def test_depths_are_those_measured_on_the_maria():
    """Fassett and Thomson (2014): after 3 Gyr 52 % at 1 km, 7 % at 300 m; ours 60 and 7 %."""
    worn = 5.5 * 3000.0  # kappa t, m^2
    assert relative_depth(worn / 500.0**2) == pytest.approx(0.52, abs=0.1)
    assert relative_depth(worn / 150.0**2) == pytest.approx(0.07, abs=0.01)
    assert relative_depth(max_crater_age()) == pytest.approx(MIN_RELATIVE_DEPTH, rel=1e-6)
    left = [relative_depth(age) for age in np.linspace(0.0, max_crater_age(), 9)]
    assert left[0] == pytest.approx(1.0) and (np.diff(left) < 0.0).all()


def test_small_new_craters_are_shallow():
    assert fresh_depth_ratio([2.0, 10.0, 1000.0, 5000.0]) == pytest.approx([0.1, 0.1, 0.2, 0.2])
    assert (np.diff(fresh_depth_ratio(np.geomspace(10.0, 1000.0, 20))) > 0.0).all()


def test_terrain_with_craters_is_the_sum_of_plain_ones():
    """Sizes, places and ages drawn again in their order; the table errs by 1 % of a depth."""
    grid = Grid.centred((3.0, -2.0), 24.0, 0.5)
    flat = Heightfield(grid, np.zeros(grid.shape, np.float32))
    law = CraterLaw(0.06, 200.0)
    craters = AgedCraters.draw(flat, np.random.default_rng(5), minimum=2.5, maximum=6.0, law=law)
    found = craters.add_to(flat)

    rng = np.random.default_rng(5)
    edge = 0.5 * PROFILE_RADII * 6.0
    west, east, south, north = flat.bounds
    area = (east - west + 2.0 * edge) * (north - south + 2.0 * edge)
    diameter = law.sample(area, 2.5, 6.0, rng)
    x = rng.uniform(west - edge, east + edge, diameter.size)
    y = rng.uniform(south - edge, north + edge, diameter.size)
    age = rng.random(diameter.size) * max_crater_age()
    assert diameter.size > 20
    points = grid.centres().reshape(-1, 2)
    plain = sum(
        reference.worn(
            points[:, 0] - x[n], points[:, 1] - y[n], d / 2, fresh_depth_ratio(d) * d, age[n]
        )
        for n, d in enumerate(diameter)
    ).reshape(grid.shape)
    # Rims of new craters are sharp, and the reference's are not.
    off = np.abs(found.z - (plain - plain.mean()))
    assert np.quantile(off, 0.99) < 0.01 * 0.6
    assert off.max() < 0.03


def test_most_are_shallow():
    """Ages are even, so the median crater keeps under a fifth of its depth."""
    ages = np.linspace(0.0, max_crater_age(), 101)
    left = np.array([relative_depth(age) for age in ages])
    assert 0.1 < np.median(left) < 0.2
    assert 0.15 < left.mean() < 0.3


@pytest.mark.parametrize("age", [-0.1, np.nan, np.inf])
def test_ages_are_ages(age):
    with pytest.raises(InputError, match="age"):
        diffuse_profile(np.zeros(1), age)
