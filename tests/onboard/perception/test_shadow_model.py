"""What rocks show under a Sun: whether anything dark, and how long they may be."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.perception.shadow_model import ShadowModel, faceted_shadowless_fraction
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.field import RockModel


def test_rocks_that_show_nothing_dark_are_the_faceted_ones_under_a_high_sun():
    """A face is dark where it turns away from the Sun; of a convex rock all may be lit."""
    shares = [faceted_shadowless_fraction(np.radians(e)) for e in (10.0, 30.0, 50.0, 60.0, 70.0)]
    assert shares[:2] == [0.0, 0.0]
    assert (np.diff(shares[1:]) > 0.0).all()
    high = np.radians(60.0)
    assert ShadowModel(high, RockModel("cube")).shadowless_fraction == 0.0
    assert ShadowModel(high, RockModel("irregular")).shadowless_fraction == shares[3]
    mixture = ShapeMixture(high, "cube")
    assert 0.0 < mixture.shadowless_fraction < shares[3]


def test_rocks_are_as_long_as_their_axes_make_them():
    """Longest half axis over the radius of the disc of the same area."""
    sun = np.radians(20.0)
    assert ShadowModel(sun).elongation == 1.0
    assert ShadowModel(sun, RockModel("cube")).elongation == 1.0
    model = RockModel("ellipsoid", axis_ratio=(0.5, 1.0), burial=(0.0, 0.0))
    drawn = model.draw(np.full(500, 2.0), np.random.default_rng(2))
    longest = ShadowModel(sun, model).elongation
    assert longest == pytest.approx(np.sqrt(2.0))
    assert 0.97 * longest < drawn.a.max() <= longest


@pytest.mark.parametrize("shape", ["hemisphere", "cube", "ellipsoid", "irregular"])
def test_rocks_are_so_long_as_often_as_is_said(shape):
    """Of drawn rocks, their discs known but for a tenth; against counting them."""
    rng = np.random.default_rng(4)
    rocks = RockModel(shape, burial=(0.0, 0.0))
    drawn = rocks.draw(np.full(20_000, 2.0), rng)
    seen = 1.0 + 0.1 * rng.standard_normal(len(drawn.a))
    model = ShadowModel(np.radians(20.0), rocks)
    for limit in (0.8, 1.0, 1.1, 1.2, 1.35):
        told = model.probability_longer_than(limit, np.ones(1), np.full(1, 0.1))
        assert told == pytest.approx(np.mean(drawn.a * seen >= limit), abs=0.02), limit
    # Axes of one ratio are of one length.
    one = RockModel("ellipsoid", axis_ratio=(0.64, 0.64))
    assert ShadowModel(np.radians(20.0), one).longer_axis == (pytest.approx(1.25), 0.0)
    # Of a population, by the shares of its shapes.
    mixture = ShapeMixture(np.radians(20.0), "cube")
    by_shape = [
        m.probability_longer_than(1.1, np.ones(1), np.full(1, 0.1))[0] for m in mixture.models
    ]
    told = mixture.probability_longer_than(1.1, np.ones(1), np.full(1, 0.1))
    assert told == pytest.approx(mixture.shape_fractions @ by_shape)
    assert by_shape[0] > 2.0 * by_shape[3]


def test_a_patch_may_be_that_of_a_longer_rock_where_rocks_are_long():
    """Each hypothesis counts with its own length: a cube's half axis is its radius."""
    sun, high = np.radians(20.0), np.radians(80.0)
    for shape in ("cube", "ellipsoid"):
        rocks = RockModel(shape, burial=(0.0, 0.0))
        one = ShapeMixture.known(ShadowModel(sun, rocks))
        unit = one.patch(1.0, high)
        read = one.estimate_radius(
            unit.length[None], unit.width[None], np.array([1.0]), np.array([high]),
            np.array([0.02]), np.array([0.02]), 0.4,
        )  # fmt: skip
        assert read.radius == pytest.approx(1.0)
        assert read.largest == pytest.approx(one.models[0].elongation * (1.0 + 2.0 * read.sigma))
