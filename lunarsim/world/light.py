"""Illumination by Sun and Earth, and reflection by the terrain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.frames import direction_from_angles
from lunarsim.parts.quantity import check_bounds, hidden, quantity
from lunarsim.typing import Array
from lunarsim.world.photometry import Hapke, hapke_of_albedo, lambert, lunar_lambert

# Apparent diameter at one astronomical unit, rad.
SUN_DIAMETER_RAD = float(np.radians(0.533))
# Full Earth: geometric albedo 0.434 (NASA Earth fact sheet) times (6371 km / 384,400 km)^2.
FULL_EARTH_IRRADIANCE_RATIO = 0.434 * (6371.0 / 384_400.0) ** 2


@dataclass(frozen=True)
class Light:
    """Sun, Earth and the photometry of the terrain.

    With the defaults the Sun is a point, the albedo is uniform, and shadows are black.

    Attributes
    ----------
    azimuth, elevation
        Direction of the Sun, rad; below the horizon only `ambient` and earthshine remain.
    albedo
        Normal albedo: radiance factor I/F when lit and viewed from above. 0.12 is a bright mare.
    ambient
        I/F of a shadowed surface over its albedo, uniform.
    photometry
        "lambert", "lunar-lambert" (McEwen 1991) or "hapke" (`lunarsim.world.photometry.Hapke`).
    hapke_b, hapke_c, hapke_surge, hapke_surge_width, hapke_roughness
        Parameters of Hapke's model except the albedo, explained in
        `lunarsim.world.photometry.Hapke`. b and c of the maria and the roughness are
        from Sato et al. (2014); the surge is the mean of the Moon, from Helfenstein and Veverka
        (1987), Icarus 72, 342-357.
    diameter
        Apparent diameter of the Sun, rad; 0: a point. From the Moon: `SUN_DIAMETER_RAD`, 0.533 deg.
    scattered_light
        Whether lit terrain illuminates other terrain (one reflection).
    earthshine
        Irradiance from the Earth over that from the Sun; `FULL_EARTH_IRRADIANCE_RATIO`, 1.2e-4, for
        a full Earth.
    earth_azimuth, earth_elevation
        Direction of the Earth, rad.
    albedo_variation
        Standard deviation of the terrain's albedo over its mean.
    albedo_correlation_length
        Distance at which the correlation of the albedo is exp(-1), m.
    boulder_albedo, boulder_albedo_variation
        Mean albedo of rocks over that of the terrain, and its standard deviation over that mean.
    albedo_seed
        Seed of the albedo variation; sampled at random for every flight.
    """

    azimuth: float = quantity(270.0, "deg", help="azimuth of the Sun, clockwise from north")
    elevation: float = quantity(
        20.0, "deg", ge=-90, le=90, help="elevation of the Sun above the horizon"
    )
    albedo: float = quantity(
        0.12,
        gt=0,
        le=1,
        help="mean normal albedo of the terrain: radiance factor I/F if lit and viewed from above",
    )
    ambient: float = quantity(
        0.0,
        ge=0,
        le=1,
        help="brightness of shadows: radiance factor I/F of shadowed terrain, as a fraction of the "
        "albedo; 0: black shadows",
    )
    photometry: Literal["lambert", "lunar-lambert", "hapke"] = quantity(
        "lunar-lambert",
        help="reflection model of the terrain: lambert, lunar-lambert (McEwen 1991) or hapke (set "
        "by the keys that begin with hapke)",
    )
    hapke_b: float = quantity(
        0.26,
        ge=0,
        le=0.9,
        help="Hapke parameter b, the asymmetry of the forward and backward lobes of the phase "
        "function: larger values give narrower lobes",
    )
    hapke_c: float = quantity(
        0.08,
        ge=-1,
        le=1,
        help="Hapke parameter c: weight of the backward lobe minus weight of the forward lobe of "
        "the phase function",
    )
    hapke_surge: float = quantity(
        2.01, ge=0, le=5, help="Hapke parameter B0: amplitude of the opposition surge"
    )
    hapke_surge_width: float = quantity(
        0.07,
        gt=0,
        le=1,
        help="Hapke parameter h: angular width of the opposition surge (tangent of half the phase "
        "angle at half amplitude)",
    )
    hapke_roughness: float = quantity(
        23.4,
        "deg",
        ge=1,
        le=45,
        help="Hapke parameter for roughness: mean slope of relief that is too small for an image "
        "to resolve",
    )
    diameter: float = quantity(
        0.0,
        "deg",
        ge=0,
        le=2,
        help="apparent diameter of the Sun, 0.533 deg in reality; 0: a point source with sharp "
        "shadows",
    )
    scattered_light: bool = quantity(
        False, help="whether lit terrain illuminates other terrain by one reflection"
    )
    earthshine: float = quantity(
        0.0,
        ge=0,
        le=1e-3,
        help="irradiance from the Earth divided by irradiance from the Sun; 0: no earthshine; "
        "1.2e-4: full Earth",
    )
    earth_azimuth: float = quantity(0.0, "deg", help="azimuth of the Earth, clockwise from north")
    earth_elevation: float = quantity(
        60.0, "deg", ge=-90, le=90, help="elevation of the Earth above the horizon"
    )
    albedo_variation: float = quantity(
        0.0,
        ge=0,
        le=0.3,
        help="standard deviation of the terrain's albedo, divided by its mean; 0: uniform albedo",
    )
    albedo_correlation_length: float = quantity(
        5.0,
        "m",
        ge=0.1,
        le=100,
        help="distance at which the correlation of the terrain's albedo falls to exp(-1)",
    )
    boulder_albedo: float = quantity(
        1.0, ge=0.2, le=4, help="mean albedo of rocks divided by the mean albedo of the terrain"
    )
    boulder_albedo_variation: float = quantity(
        0.0,
        ge=0,
        le=0.5,
        help="standard deviation of the albedo among rocks, divided by its mean; 0: all rocks have "
        "the same albedo",
    )
    albedo_seed: int = hidden(0)

    def __post_init__(self) -> None:
        check_bounds(self, "sun")
        if self.photometry not in ("lambert", "lunar-lambert", "hapke"):
            raise InputError(
                "sun.photometry", self.photometry, "must be lambert, lunar-lambert or hapke"
            )
        if self.photometry == "hapke":
            self.hapke()

    @property
    def direction(self) -> Array:
        """Unit vector to the Sun (3,), ENU."""
        return direction_from_angles(self.azimuth, self.elevation)

    @property
    def earth(self) -> Array:
        """Unit vector to the Earth (3,), ENU."""
        return direction_from_angles(self.earth_azimuth, self.earth_elevation)

    def hapke(self) -> Hapke:
        """Return Hapke's reflection model, scaled to the normal albedo of this terrain.

        Raises
        ------
        InputError
            If no single-scattering albedo gives the normal albedo.
        """
        return hapke_of_albedo(
            self.albedo, self.hapke_b, self.hapke_c, self.hapke_surge, self.hapke_surge_width,
            self.hapke_roughness,
        )  # fmt: skip

    @property
    def diffuse_albedo(self) -> float:
        """Albedo under uniform diffuse light: reflected over incident irradiance."""
        return float(_hemispherical_albedos(self._photometry_key)[1])

    def hemispheric_albedo(self, mu0: ArrayLike) -> Array:
        """Return the hemispherical albedo (reflected over incident irradiance).

        `mu0` are the cosines of the incidence angle; the result has the same shape.
        """
        return np.asarray(
            np.interp(
                np.asarray(mu0, float), _COSINES, _hemispherical_albedos(self._photometry_key)[0]
            )
        )

    @property
    def _photometry_key(self) -> Light:
        """Copy of the photometric settings with a fixed Sun direction, as a cache key."""
        return Light(
            0.0, 0.5, self.albedo, 0.0, self.photometry, self.hapke_b, self.hapke_c,
            self.hapke_surge, self.hapke_surge_width, self.hapke_roughness,
        )  # fmt: skip

    def radiance_factor(self, mu0: ArrayLike, mu: ArrayLike, cos_phase: ArrayLike) -> Array:
        """Return the radiance factor I/F of sunlit terrain of mean albedo.

        `mu0`, `mu` and `cos_phase` are the cosines of the incidence, emission and phase angles.
        """
        if self.photometry == "lambert":
            return lambert(self.albedo, mu0) + 0.0 * np.asarray(mu)
        if self.photometry == "lunar-lambert":
            return lunar_lambert(self.albedo, mu0, mu, cos_phase)
        return self.hapke().radiance_factor(mu0, mu, cos_phase)


# Cosines of incidence at which hemispherical albedos are tabulated.
_COSINES = np.linspace(0.01, 1.0, 34)


@lru_cache(maxsize=16)
def _hemispherical_albedos(light: Light) -> tuple[Array, float]:
    """Return hemispherical albedos (34,) and the diffuse albedo of a light's terrain.

    The hemispherical albedos are those at the incidence cosines `_COSINES`: the reflection model of
    `light` is integrated over all emission directions. The diffuse albedo is that under uniform
    light.
    """
    mu, weight = np.polynomial.legendre.leggauss(24)
    mu, weight = 0.5 * (mu + 1.0), 0.5 * weight
    psi = np.pi * (np.arange(24) + 0.5) / 24
    mu0 = _COSINES[:, None, None]
    cos_g = mu0 * mu[:, None] + np.sqrt((1.0 - mu0**2) * (1.0 - mu[:, None] ** 2)) * np.cos(psi)
    factor = light.radiance_factor(mu0, mu[:, None], cos_g).mean(-1)
    albedo = 2.0 * (factor * mu * weight).sum(-1) / _COSINES
    return albedo, 2.0 * float(np.trapezoid(albedo * _COSINES, _COSINES))
