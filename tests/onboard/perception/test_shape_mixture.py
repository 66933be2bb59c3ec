"""Shapes that are not known: patches of drawn rocks, read without being told what they are."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import SHAPES, ShapeMixture

SUN = np.radians(20.0)
HALF_SPHERES = ShadowModel(SUN)
NAMES = ("low", "round", "tall", "sunk", "cube")


@pytest.fixture(scope="module")
def models():
    return {name: ShadowModel(SUN, shape) for name, shape in zip(NAMES, SHAPES, strict=True)}


def patches(model, rng, count=400, slope=0.0, radius=None):
    """Patches of rocks of a shape, seen steeply, of 0.05 m a pixel; lengths stretched by slopes."""
    r = rng.uniform(0.3, 0.8, count) if radius is None else np.full(count, radius)
    azimuth, depression = rng.uniform(-3.0, 3.0, count), rng.uniform(0.7, 1.5, count)
    unit = model.patch(azimuth, depression)
    pixel = np.full(count, 0.05)
    noise = 0.4 * np.sqrt(2.0) * 0.05 * rng.standard_normal((2, count))
    length = r * (unit.length + unit.length_sigma * rng.standard_normal(count)) + noise[0]
    length *= 1.0 + slope / np.tan(SUN) * rng.standard_normal(count)
    width = r * (unit.width + unit.width_sigma * rng.standard_normal(count)) + noise[1]
    return r, (length, width, azimuth, depression, pixel, pixel, 0.4)


def taught(model, rng, expected_shape=None, slope=0.0):
    mixture = ShapeMixture(SUN, expected_shape)
    for _ in range(12):
        _, seen = patches(model, rng, slope=slope)
        mixture.update_fractions(mixture.estimate_radius(*seen).weight, np.full(400, 8.0))
    return mixture


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("model", [HALF_SPHERES, ShapeMixture(SUN)], ids=["one", "mixture"])
def test_of_terrain_above_the_camera_no_pixel_is_seen(model):
    q = model.visible_q(np.ones(3), 0.3, np.array([-0.04, 0.0, 0.5]), 0.05)
    assert q[0] == q[1] == 0.0
    assert q[2] > 1.0


def test_one_known_shape_is_the_mean_by_inverse_variances():
    """Against a loop over patches."""
    rng = np.random.default_rng(1)
    mixture = ShapeMixture.known(HALF_SPHERES)
    _, seen = patches(HALF_SPHERES, rng, 30)
    length, width, azimuth, depression, _, _, _ = seen
    read = mixture.estimate_radius(*seen)
    for k in range(30):
        unit = HALF_SPHERES.patch(azimuth[k], depression[k])
        by = np.array([length[k] / unit.length, width[k] / unit.width])
        ends = 2.0 * (0.4 * 0.05) ** 2
        spread = by * np.array([unit.length_sigma, unit.width_sigma])
        variance = (ends + spread**2) / np.array([unit.length, unit.width]) ** 2
        expected = np.sum(by / variance) / np.sum(1.0 / variance)
        assert read.radius[k] == pytest.approx(expected, rel=1e-9)
        assert read.sigma[k] == pytest.approx(np.sum(1.0 / variance) ** -0.5, rel=1e-9)
    assert read.weight == pytest.approx(1.0)
    assert mixture.patch(0.3, 1.0).area == pytest.approx(HALF_SPHERES.patch(0.3, 1.0).area)


@pytest.mark.parametrize(
    ("name", "expected_shape", "off"),
    # A cube throws nearly the shadow of a rounded rock as high as wide, whose disc is larger.
    [("cube", "mixed", 0.12), ("low", "cube", 0.06), ("cube", None, 0.12)],
)
def test_shapes_are_estimated_from_the_shadows_whatever_the_mission_expects(
    models, name, expected_shape, off
):
    rng = np.random.default_rng(2)
    mixture = taught(models[name], rng, expected_shape)
    assert mixture.shape_fractions.argmax() == NAMES.index(name)
    assert mixture.shape_fractions[NAMES.index(name)] > 0.6
    r, seen = patches(models[name], rng)
    read = mixture.estimate_radius(*seen)
    assert np.median(read.radius / r) == pytest.approx(1.0, abs=off)
    z = (read.radius - r) / read.sigma
    # Where two shapes stay possible what they differ by errs alike in all rocks.
    assert z.std() > 0.5 if name == "low" else np.sqrt(np.mean(z**2)) > 0.4
    assert max(z.std(), np.sqrt(np.mean(z**2))) < 1.3


@pytest.mark.parametrize("name", NAMES)
def test_no_rock_is_larger_than_the_largest_that_a_patch_may_stand_for(models, name):
    rng = np.random.default_rng(3)
    mixture = taught(models[name], rng, "cube")
    r, seen = patches(models[name], rng, 2000)
    assert np.mean(mixture.estimate_radius(*seen).largest < r) < 0.05


def mostly_cubes(models):
    """One rock in eight is round among cubes, on slopes."""
    rng = np.random.default_rng(8)
    mixture = ShapeMixture(SUN, "cube")
    for _ in range(12):
        for name, count in (("cube", 350), ("round", 50)):
            _, seen = patches(models[name], rng, count, 0.07)
            mixture.update_fractions(mixture.estimate_radius(*seen).weight, np.full(count, 8.0))
    return mixture, rng


def test_few_rocks_are_longer_than_their_patches_may_be(models):
    mixture, rng = mostly_cubes(models)
    r, seen = patches(models["round"], rng, 4000, 0.07)
    ratio = rng.uniform(*models["round"].shapes.axis_ratio, 4000)
    assert np.mean(mixture.estimate_radius(*seen).largest < r * ratio**-0.5) < 0.05


def test_a_shape_is_possible_into_however_many_slopes_its_weight_is_divided(models):
    """Against a loop over patches, shapes and slopes: one shape on one slope read by itself."""
    mixture, rng = mostly_cubes(models)
    _, seen = patches(models["round"], rng, 300, 0.07)
    read = mixture.estimate_radius(*seen)
    of_shape = np.zeros(300, np.int64)
    for k in range(300):
        weight = read.weight[k].reshape(5, 3)
        largest = 0.0
        for m, of_slopes in enumerate(weight):
            of_shape[k] += of_slopes.sum() > 0.03
            for slope, mine in zip(mixture.slopes, of_slopes, strict=True):
                one = ShapeMixture.known(mixture.models[m])
                one.slopes = np.array([slope])
                alone = one.estimate_radius(*(a[k : k + 1] for a in seen[:-1]), seen[-1])
                if of_slopes.sum() > 0.03 and mine > 0.01:
                    reach = alone.radius[0] + 2.0 * alone.sigma[0]
                    largest = max(largest, mixture.models[m].elongation * reach)
        assert read.largest[k] == pytest.approx(largest, rel=1e-9), k
    # Some patches rule shapes out, some none.
    assert of_shape.min() < of_shape.max()


@pytest.mark.parametrize("expected_shape", ["cube", "mixed"])
def test_rounded_rocks_nearly_as_high_as_wide_are_not_taken_for_small_cubes(models, expected_shape):
    """Of 0.27 m, their longer half axes are 0.30 m in the mean; read as cubes, 0.18 m."""
    rng = np.random.default_rng(9)
    mixture = taught(models["tall"], rng, expected_shape)
    r, seen = patches(models["tall"], rng, 1000, radius=0.27)
    read = mixture.estimate_radius(*seen)
    chance = mixture.probability_longer_than(0.25, read.radius, read.sigma)
    assert np.mean(chance < 0.0025) < 0.01
    assert np.mean(read.largest < 0.25) < 0.02


def test_slopes_show_in_how_lengths_scatter(models):
    rng = np.random.default_rng(4)
    level = taught(models["cube"], rng, "cube")
    rough = taught(models["cube"], rng, "cube", slope=0.15)
    assert level.slope < 0.04
    assert rough.slope > 0.08
    _, seen = patches(models["cube"], rng, 200, radius=0.5)
    assert np.median(rough.estimate_radius(*seen).sigma) > 1.15 * np.median(
        level.estimate_radius(*seen).sigma
    )


def test_the_given_shape_is_its_start():
    cube, round_ = ShapeMixture(SUN, "cube"), ShapeMixture(SUN, "mixed")
    assert cube.shape_fractions[4] > 1.5 * cube.shape_fractions[1]
    assert round_.shape_fractions[1] > 1.5 * round_.shape_fractions[4]
    # Patches of too few pixels teach nothing.
    before = cube.hypothesis_fractions
    cube.update_fractions(np.eye(15)[:5], np.full(5, 3.0))
    assert cube.hypothesis_fractions == pytest.approx(before)
    assert cube.height == pytest.approx(
        cube.shape_fractions @ [m.height for m in cube.models], rel=1e-9
    )


def test_what_was_learnt_of_shapes_holds_under_another_sun(models):
    rng = np.random.default_rng(6)
    mixture = taught(models["cube"], rng)
    other = mixture.under(np.radians(13.0))
    assert np.degrees(other.elevation) == pytest.approx(13.0, rel=0.05)
    np.testing.assert_array_equal(other.hypothesis_fractions, mixture.hypothesis_fractions)
    assert (other.patch(1.0, 1.0).length > 1.2 * mixture.patch(1.0, 1.0).length).all()
    assert mixture.under(SUN) is mixture


def test_half_spheres_are_distinguished_from_cubes_sunk_in_where_the_mission_expects_them(models):
    """Shadows of both are as long over as wide; told nothing, radii are a sixth too small."""
    rng = np.random.default_rng(12)
    r, seen = patches(HALF_SPHERES, rng, 1000)
    ratio = {
        expected_shape: np.median(
            taught(HALF_SPHERES, rng, expected_shape).estimate_radius(*seen).radius / r
        )
        for expected_shape in ("hemisphere", None)
    }
    assert ratio["hemisphere"] == pytest.approx(1.0, abs=0.06)
    assert ratio[None] < 0.85
    # What is told in vain costs no rock: cubes sunk in are read as no smaller than they are.
    r, seen = patches(models["sunk"], rng, 1000)
    assert (
        np.median(taught(models["sunk"], rng, "hemisphere").estimate_radius(*seen).radius / r)
        > 0.95
    )
    r, seen = patches(models["cube"], rng, 1000)
    read = taught(models["cube"], rng, "hemisphere").estimate_radius(*seen)
    assert np.median(read.radius / r) == pytest.approx(1.0, abs=0.15)
