from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.world.terrain import (
    CraterLaw,
    Heightfield,
    add_craters,
    add_detail,
    crater_profile,
    fractal_relief,
)


def test_profile_has_the_depth_and_rim_of_a_fresh_crater():
    assert crater_profile(50.0, 100.0, 1.0) == pytest.approx(3.6)
    assert crater_profile(50.0, 100.0, 1.0) - crater_profile(0.0, 100.0, 1.0) == pytest.approx(20.0)
    assert crater_profile(150.0, 100.0, 1.0) == pytest.approx(0.0)
    r = np.linspace(0.0, 200.0, 4001)
    assert np.abs(np.diff(crater_profile(r, 100.0, 0.7))).max() < 0.05  # no step anywhere


def test_sizes_follow_the_law():
    law = CraterLaw(0.079, 30.0)
    area = 4e6
    found = law.sample(area, 5.0, 200.0, np.random.default_rng(2))
    for d in (5.0, 10.0, 30.0, 60.0, 120.0):
        expected = area * float(law.number(d) - law.number(200.0))
        assert np.sum(found >= d) == pytest.approx(expected, abs=4.0 * np.sqrt(expected))
    assert law.number(29.999) == pytest.approx(law.number(30.001), rel=1e-3)


def test_detail_leaves_the_measured_posts_where_they_are():
    rng = np.random.default_rng(0)
    measured = fractal_relief(
        Grid.centred((0.0, 0.0), 60.0, 2.0), rng, hurst=0.9, rms_slope=0.1, baseline=2.0
    )
    fine = measured.refined(0.25)
    detail = fractal_relief(fine.grid, rng, hurst=0.8, rms_slope=0.1)
    both = add_detail(measured, detail)
    assert np.allclose(both.z[::8, ::8], measured.z, atol=1e-5)
    assert np.std(both.z - fine.z) > 0.01
    elsewhere = Heightfield(Grid.centred((0.0, 0.0), 40.0, 0.5), np.zeros((80, 80), np.float32))
    with pytest.raises(InputError, match=r"terrain\.detail"):
        add_detail(measured, elsewhere)


def test_smoothing_of_steps_stays_within_the_rounding():
    rng = np.random.default_rng(1)
    true = fractal_relief(
        Grid.centred((0.0, 0.0), 200.0, 2.0), rng, hurst=0.95, rms_slope=0.05, baseline=2.0
    )
    rounded = Heightfield(true.grid, np.round(true.z / 0.2) * 0.2)
    smooth = rounded.dequantised(0.2)
    assert np.abs(smooth.z - rounded.z).max() <= 0.1 + 1e-5

    def slope_error(z):
        return np.sqrt(np.mean((np.diff(z) - np.diff(true.z)) ** 2))

    assert slope_error(smooth.z) < 0.6 * slope_error(rounded.z)
    with pytest.raises(InputError, match=r"terrain\.height_step_m"):
        rounded.dequantised(0.0)


def test_craters_are_the_same_for_the_same_seed():
    ground = Heightfield(Grid.centred((0.0, 0.0), 50.0, 0.5), np.zeros((100, 100), np.float32))
    first, second = (add_craters(ground, np.random.default_rng(4), minimum=2.0).z for _ in range(2))
    assert np.array_equal(first, second)


def test_bad_laws_are_refused():
    with pytest.raises(InputError, match=r"craters\.density"):
        CraterLaw(density=0.0)
    with pytest.raises(InputError, match=r"craters\.min_diameter_m"):
        CraterLaw().sample(100.0, 5.0, 4.0, np.random.default_rng(0))
