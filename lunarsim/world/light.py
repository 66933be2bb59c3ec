"""The Sun and the Earth, and how the ground reflects their light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.frames import direction_from_angles
from lunarsim.parts.quantity import check_bounds, hidden, quantity
from lunarsim.world.photometry import Hapke, hapke_of_albedo, lambert, lunar_lambert

Array = NDArray[np.float64]


# The Sun as it is seen from one astronomical unit, rad.
SUN_DIAMETER = float(np.radians(0.533))
# Full Earth: geometric albedo 0.434 (NASA's Earth fact sheet) times (6371 km / 384,400 km)^2.
FULL_EARTH = 0.434 * (6371.0 / 384_400.0) ** 2


@dataclass(frozen=True)
class Light:
    """The Sun, the Earth, and how the ground reflects them.

    With the defaults the Sun is a point, the ground of one brightness, and a shadow black.

    Attributes
    ----------
    azimuth, elevation
        Of the Sun, rad; below the horizon nothing but `ambient` and Earthshine are left.
    albedo
        Normal albedo: I/F when lit and seen from above. 0.12 is a bright mare.
    ambient
        Radiance factor of a shadowed surface over its albedo, the same everywhere.
    photometry
        "lambert", "lunar-lambert" (McEwen 1991) or "hapke" (`lunarsim.world.photometry.Hapke`).
    hapke_b, hapke_c, hapke_surge, hapke_surge_width, hapke_roughness
        What Hapke's law takes besides the albedo. b and c of the maria and the roughness after Sato
        et al. (2014); the surge is the whole Moon's after Helfenstein and Veverka (1987), Icarus
        72, 342-357.
    diameter
        Apparent, of the Sun, rad; 0: a point. From the Moon it is `SUN_DIAMETER`, 0.533 deg.
    scattered
        Whether the lit ground lights what it sees of the rest, once.
    earthshine
        The Earth's irradiance over the Sun's; `FULL_EARTH`, 1.2e-4, is a full Earth.
    earth_azimuth, earth_elevation
        Of the Earth, rad.
    mottle
        Standard deviation of the ground's albedo over its mean.
    mottle_length
        Distance at which the correlation of two places is exp(-1), m.
    boulder_albedo, boulder_mottle
        Mean albedo of rocks over the ground's, and its standard deviation over that mean.
    mottle_seed
        Of the field of mottles; drawn anew for every flight.
    """

    azimuth: float = quantity(270.0, "deg", help="of the Sun, clockwise from north")
    elevation: float = quantity(20.0, "deg", ge=-90, le=90, help="of the Sun above the horizon")
    albedo: float = quantity(0.12, gt=0, le=1, help="normal albedo")
    ambient: float = quantity(0.0, ge=0, le=1, help="I/F of shadows over the albedo")
    photometry: Literal["lambert", "lunar-lambert", "hapke"] = quantity(
        "lunar-lambert", help="how the ground reflects"
    )
    hapke_b: float = quantity(0.26, ge=0, le=0.9, help="width of the phase function's lobes")
    hapke_c: float = quantity(0.08, ge=-1, le=1, help="backward lobe over the forward one")
    hapke_surge: float = quantity(2.01, ge=0, le=5, help="opposition surge B0")
    hapke_surge_width: float = quantity(0.07, gt=0, le=1, help="its angular width h")
    hapke_roughness: float = quantity(23.4, "deg", ge=1, le=45, help="mean slope below a pixel")
    diameter: float = quantity(0.0, "deg", ge=0, le=2, help="of the Sun's disc; 0: a point")
    scattered: bool = quantity(False, help="whether lit ground lights the rest")
    earthshine: float = quantity(0.0, ge=0, le=1e-3, help="Earth's light over the Sun's")
    earth_azimuth: float = quantity(0.0, "deg", help="of the Earth, clockwise from north")
    earth_elevation: float = quantity(60.0, "deg", ge=-90, le=90, help="of the Earth")
    mottle: float = quantity(0.0, ge=0, le=0.3, help="spread of the ground's albedo, 1 sigma")
    mottle_length: float = quantity(5.0, "m", ge=0.1, le=100, help="its correlation length")
    boulder_albedo: float = quantity(1.0, ge=0.2, le=4, help="of rocks over the ground's")
    boulder_mottle: float = quantity(0.0, ge=0, le=0.5, help="spread among rocks, 1 sigma")
    mottle_seed: int = hidden(0)

    def __post_init__(self) -> None:
        check_bounds(self, "sun")
        if self.photometry not in ("lambert", "lunar-lambert", "hapke"):
            raise InputError("sun.photometry", self.photometry, "lambert, lunar-lambert or hapke")
        if self.photometry == "hapke":
            self.hapke()

    @property
    def direction(self) -> Array:
        """Unit vector towards the Sun (3,), ENU."""
        return direction_from_angles(self.azimuth, self.elevation)

    @property
    def earth(self) -> Array:
        """Unit vector towards the Earth (3,), ENU."""
        return direction_from_angles(self.earth_azimuth, self.earth_elevation)

    def hapke(self) -> Hapke:
        """Return Hapke's law for this ground.

        Raises
        ------
        InputError
            If no grain is white enough for the albedo.
        """
        return hapke_of_albedo(
            self.albedo, self.hapke_b, self.hapke_c, self.hapke_surge, self.hapke_surge_width,
            self.hapke_roughness,
        )  # fmt: skip

    @property
    def diffuse_albedo(self) -> float:
        """I/F of ground that is lit evenly from all sides, over that light's irradiance."""
        return float(_hemispheric(self._law)[1])

    def hemispheric_albedo(self, mu0: ArrayLike) -> Array:
        """Return the share of light at cosines of incidence `mu0` that leaves the ground."""
        return np.asarray(np.interp(np.asarray(mu0, float), _COSINES, _hemispheric(self._law)[0]))

    @property
    def _law(self) -> Light:
        """The same ground under a Sun of no matter where: the key to what hangs on the law."""
        return Light(
            0.0, 0.5, self.albedo, 0.0, self.photometry, self.hapke_b, self.hapke_c,
            self.hapke_surge, self.hapke_surge_width, self.hapke_roughness,
        )  # fmt: skip

    def radiance_factor(self, mu0: ArrayLike, mu: ArrayLike, cos_phase: ArrayLike) -> Array:
        """Return I/F of sunlit ground of mean albedo; see `lunarsim.world.photometry`."""
        if self.photometry == "lambert":
            return lambert(self.albedo, mu0) + 0.0 * np.asarray(mu)
        if self.photometry == "lunar-lambert":
            return lunar_lambert(self.albedo, mu0, mu, cos_phase)
        return self.hapke().radiance_factor(mu0, mu, cos_phase)


# Cosines of incidence at which hemispherical albedos are kept.
_COSINES = np.linspace(0.01, 1.0, 34)


@lru_cache(maxsize=16)
def _hemispheric(law: Light) -> tuple[Array, float]:
    """Return the hemispherical albedo at `_COSINES`, and its mean under light from all sides."""
    mu, weight = np.polynomial.legendre.leggauss(24)
    mu, weight = 0.5 * (mu + 1.0), 0.5 * weight
    psi = np.pi * (np.arange(24) + 0.5) / 24
    mu0 = _COSINES[:, None, None]
    cos_g = mu0 * mu[:, None] + np.sqrt((1.0 - mu0**2) * (1.0 - mu[:, None] ** 2)) * np.cos(psi)
    factor = law.radiance_factor(mu0, mu[:, None], cos_g).mean(-1)
    albedo = 2.0 * (factor * mu * weight).sum(-1) / _COSINES
    return albedo, 2.0 * float(np.trapezoid(albedo * _COSINES, _COSINES))
