"""Laws of reflection against a plain reference, symmetry, and the Moon itself."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.world.light import FULL_EARTH_IRRADIANCE_RATIO, Light
from lunarsim.world.photometry import Hapke, hapke_of_albedo, lunar_lambert
from tests.reference.photometry import chandrasekhar, lunar_if


def law(w=0.23, b=0.26, c=0.08, surge=2.0, width=0.07, theta=0.41):
    return Hapke(w, b, c, surge, width, theta)


def geometries(rng, n):
    i, e = rng.uniform(0.02, 1.5, (2, n))
    psi = rng.uniform(0.0, np.pi - 0.01, n)
    return i, e, psi, np.cos(i) * np.cos(e) + np.sin(i) * np.sin(e) * np.cos(psi)


def test_hapke_is_the_plain_reference_at_random_geometries_and_parameters():
    rng = np.random.default_rng(1)
    for _ in range(40):
        parts = {
            "w": rng.uniform(0.05, 0.9), "b": rng.uniform(0.0, 0.6), "c": rng.uniform(-0.9, 0.9),
            "surge": rng.uniform(0.0, 3.0), "width": rng.uniform(0.02, 0.3),
            "theta": rng.uniform(0.05, 0.7),
        }  # fmt: skip
        i, e, psi, cos_g = geometries(rng, 25)
        ours = law(**parts).radiance_factor(np.cos(i), np.cos(e), cos_g)
        plain = [lunar_if(*one, **parts) for one in zip(i, e, psi, strict=True)]
        assert np.allclose(ours, plain, rtol=1e-6)


@pytest.mark.parametrize("photometry", ["lambert", "lunar-lambert", "hapke"])
def test_sun_and_sensor_may_change_places(photometry):
    """Helmholtz's reciprocity: I/F over the cosine of incidence is symmetric."""
    light = Light(photometry=photometry)
    i, e, _, cos_g = geometries(np.random.default_rng(2), 500)
    there = light.radiance_factor(np.cos(i), np.cos(e), cos_g) / np.cos(i)
    back = light.radiance_factor(np.cos(e), np.cos(i), cos_g) / np.cos(e)
    assert np.allclose(there, back, rtol=1e-9)


@pytest.mark.parametrize("photometry", ["lambert", "lunar-lambert", "hapke"])
@pytest.mark.parametrize("albedo", [0.03, 0.12, 0.3])
def test_albedo_is_the_brightness_from_above_at_full_phase(photometry, albedo):
    light = Light(photometry=photometry, albedo=albedo)
    assert float(light.radiance_factor(1.0, 1.0, 1.0)) == pytest.approx(albedo, rel=1e-6)


def test_surge_is_half_at_its_width():
    g = 2.0 * np.arctan(0.07)
    # Isotropic grains, so that the surge alone depends on the phase angle.
    gain = [
        float(law(b=0.0, surge=2.0).radiance_factor(0.9, 0.9, np.cos(x)))
        / float(law(b=0.0, surge=0.0).radiance_factor(0.9, 0.9, np.cos(x))) - 1.0
        for x in (1e-6, g)
    ]  # fmt: skip
    assert gain[1] == pytest.approx(0.5 * gain[0], rel=1e-4)
    # Twice as bright at full phase as at 15 degrees, as the Moon nearly is (Buratti et al. 1996).
    moon = Light(photometry="hapke")
    bright = moon.radiance_factor(np.cos(0.0), np.cos(np.radians([0.0, 15.0])),
                                  np.cos(np.radians([0.0, 15.0])))  # fmt: skip
    assert 1.4 < bright[0] / bright[1] < 2.2


def test_whole_moon_dims_with_phase_as_it_is_seen_to():
    """Disc-integrated, against the lunar phase law in Allen (Cox 2000, 4th ed.), magnitudes.

    The law leaves the surge out; so magnitudes count from 10 degrees on.
    """
    light = Light(photometry="hapke")
    latitude, longitude = np.meshgrid(
        np.radians(np.arange(-89.5, 90.0, 1.0)), np.radians(np.arange(-89.5, 90.0, 1.0)),
        indexing="ij",
    )  # fmt: skip

    def flux(phase):
        mu = np.cos(latitude) * np.cos(longitude)
        mu0 = np.cos(latitude) * np.cos(longitude - phase)
        return np.sum(light.radiance_factor(mu0, mu, np.cos(phase)) * mu * np.cos(latitude))

    start = flux(np.radians(10.0))
    for degrees in (20.0, 40.0, 60.0, 90.0):
        seen = 0.026 * (degrees - 10.0) + 4e-9 * (degrees**4 - 10.0**4)
        ours = -2.5 * np.log10(flux(np.radians(degrees)) / start)
        assert ours == pytest.approx(seen, abs=0.25)


@pytest.mark.parametrize("w", [0.1, 0.25, 0.5])
def test_h_function_solves_its_integral_equation_nearly(w):
    """Chandrasekhar (1960) for isotropic grains; Hapke's formula is told to be within 1 %."""
    x, weight = np.polynomial.legendre.leggauss(40)
    x, weight = 0.5 * (x + 1.0), 0.5 * weight
    h = np.ones_like(x)
    for _ in range(200):
        h = 1.0 / (np.sqrt(1.0 - w) + 0.5 * w * (weight * x * h / (x[:, None] + x)).sum(1))
    assert np.allclose([chandrasekhar(m, w) for m in x], h, rtol=0.01)


def test_no_grain_is_whiter_than_white():
    with pytest.raises(InputError, match="at most"):
        hapke_of_albedo(0.99, 0.26, -0.9, 0.0, 0.07, 0.4)
    with pytest.raises(InputError, match="albedo"):
        Light(photometry="hapke", albedo=0.99, hapke_c=-0.9, hapke_surge=0.0)


def test_full_earth_is_a_ten_thousandth_of_the_sun():
    assert pytest.approx(1.19e-4, rel=0.01) == FULL_EARTH_IRRADIANCE_RATIO


@pytest.mark.parametrize(
    ("field", "value"),
    [("diameter", -0.1), ("hapke_roughness", 0.0), ("albedo_variation", 0.9), ("earthshine",
    np.nan),
     ("albedo_correlation_length", 0.0), ("photometry", "phong"), ("boulder_albedo", 0.0)],
)  # fmt: skip
def test_light_that_cannot_be_is_refused(field, value):
    with pytest.raises(InputError, match="sun"):
        Light(**{field: value})


@pytest.mark.parametrize("phase", [0.0, 10.0, 40.0, 75.0, 90.0])
def test_lunar_lambert_has_mcewens_share_at_every_phase(phase):
    """Looking along the ground's normal, under a Sun so many degrees off it."""
    share = np.clip(np.polyval([-1.46e-6, 2.42e-4, -0.019, 1.0], phase), 0.0, 1.0)
    sun = np.cos(np.radians(phase))
    expected = 0.12 * (2.0 * share * sun / (1.0 + sun) + (1.0 - share) * sun)
    assert lunar_lambert(0.12, sun, 1.0, sun) == pytest.approx(expected, rel=1e-9)


def test_the_moons_mean_slope_is_as_published():
    """Sato et al. (2014): 23.4 deg."""
    assert np.degrees(Light().hapke_roughness) == pytest.approx(23.4)
