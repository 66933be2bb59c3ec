from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.scenario import Scenario
from lunarsim.world.terrain.dtm import load_terrain
from lunarsim.world.terrain_models.fractal import FractalTerrain
from tests.conftest import ROOT

# Rosenburg et al. (2011): Hurst exponents, and slopes (deg) carried to 1 m; measured: polar.
PRESETS = {"mare": (0.76, 3.9), "highland": (0.95, 8.6), "polar": (0.983, 13.2)}


def slope_at_a_metre(relief):
    """Return the rms slope (deg) of posts 1 m apart, from those a quarter of a metre apart."""
    step = np.diff(relief.z.astype(float)[::4, ::4])
    return np.degrees(np.arctan(np.sqrt(2.0 * np.mean(step**2))))


@pytest.mark.parametrize("preset", list(PRESETS))
def test_presets_fill_what_is_left_out(preset):
    table = {"preset": preset, "size_m": 100.0, "hurst": 0.5, "detail_m": 0.0}
    ground = Scenario.from_dict({"terrain": table}).terrain.make()
    hurst, slope = PRESETS[preset]
    cratered, bare = ground.relief(), replace(ground, crater_density=0.0).relief()
    assert slope_at_a_metre(bare) == pytest.approx(slope, rel=0.25)
    assert np.std(cratered.z - bare.z) > 0.02
    # What is given stands, what is not is the preset's.
    filled = replace(ground, hurst=hurst, rms_slope=np.deg2rad(slope), crater_density=0.079)
    left_out = replace(ground, hurst=None)
    assert np.array_equal(filled.relief().z, left_out.relief().z)
    assert not np.array_equal(cratered.z, left_out.relief().z)


def test_polar_terrain_is_as_rough_as_the_ridge_beside_shackleton():
    """Median slopes of posts 40 to 160 m apart, and what they come to at 1 m."""
    file = ROOT / "scenarios" / "data" / "moon_shackleton_ridge_lola_40m.tif"
    z = load_terrain(file, posting=40.0).z.astype(float)
    steps = np.array([1, 2, 3, 4])
    slopes = [
        np.median(np.hypot(z[:-k, k:] - z[:-k, :-k], z[k:, :-k] - z[:-k, :-k])) / (40.0 * k)
        for k in steps
    ]
    assert np.degrees(np.arctan(slopes[0])) == pytest.approx(12.4, abs=0.1)
    fall, at_a_metre = np.polyfit(np.log(40.0 * steps), np.log(slopes), 1)
    hurst, slope = PRESETS["polar"]
    assert 1.0 + fall == pytest.approx(hurst, abs=0.001)
    assert np.degrees(np.arctan(np.exp(at_a_metre))) == pytest.approx(slope, abs=0.1)


def test_terrain_without_a_preset_has_no_craters():
    plain = FractalTerrain(size=40.0)
    assert np.array_equal(plain.relief().z, replace(plain, crater_density=0.0).relief().z)
    assert slope_at_a_metre(plain.relief()) == pytest.approx(2.5, rel=0.25)


def test_terrain_of_a_preset_has_posts_that_do_not_show_unless_asked_otherwise():
    kind = {"preset": "mare", "crater_density": 0.0, "size": 40.0}
    near, bare = FractalTerrain(**kind), FractalTerrain(**kind, detail=0.0)
    assert near.detail_posting == pytest.approx(0.05)
    assert near.relief().grid.posting == pytest.approx(0.05)
    assert bare.relief().grid.posting == 0.25
    # The same ground, with some millimetres of roughness on it.
    assert 0.0005 < np.std(near.relief().z[::5, ::5] - bare.relief().z) < 0.01
    asked = FractalTerrain(**kind, detail=0.0625)
    assert asked.relief().grid.posting == 0.0625
    assert FractalTerrain(size=40.0).detail_posting is None


@pytest.mark.parametrize("posting", [0.07, 0.09, 0.25, 1.3, 20.0, 23.9, 30.0])
@pytest.mark.parametrize("size", [100.0, 300.0, 1234.5])
def test_detail_that_nobody_asked_for_fits_posts_and_memory(size, posting):
    ground = FractalTerrain(preset="mare", size=size, posting=posting)
    found = ground.detail_posting
    least = max(0.05, size / 4000.0)
    if posting < 2.0 * least or posting > 24.0:
        assert found is None
        return
    assert least * (1.0 - 1e-9) <= found <= 2.0 * least
    assert posting / found == pytest.approx(round(posting / found))
    if size == 100.0:
        kind = replace(ground, crater_density=0.0)
        plain = replace(kind, detail=0.0)
        assert kind.relief().bounds == pytest.approx(plain.relief().bounds)


@pytest.mark.parametrize("degradation", ["uniform", "diffusion"])
def test_the_relief_seed_selects_relief_and_craters(degradation):
    ground = FractalTerrain(
        size=40.0, crater_density=0.079, crater_degradation=degradation, detail=0.125
    )
    first, same, other = (
        replace(ground, relief_seed=seed).relief().z for seed in (20260101, 20260101, 7)
    )
    assert np.array_equal(first, ground.relief().z) and np.array_equal(first, same)
    assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.9
    assert other.std() == pytest.approx(first.std(), rel=0.7)
    if degradation == "diffusion":
        sites = [replace(ground, relief_seed=s).craters(ground.relief()).x for s in (1, 2)]
        assert sites[0].shape != sites[1].shape or not np.array_equal(*sites)
