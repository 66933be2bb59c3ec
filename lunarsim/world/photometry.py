"""Reflection of sunlight by terrain: radiance factors I/F of three models.

Angles are given as cosines: of incidence `mu0`, of emission `mu` and of the phase angle. I/F is pi
times the radiance divided by the solar irradiance on a surface that faces the Sun.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from lunarsim.errors import InputError
from lunarsim.typing import Array

_MIN_COSINE = 1e-6


def lambert(albedo: float, mu0: ArrayLike) -> Array:
    """Return the radiance factor I/F = albedo * mu0 of a Lambert surface.

    `mu0` is the cosine of the incidence angle; a negative cosine gives 0.

    Examples
    --------
    >>> round(float(lambert(0.12, np.cos(np.radians(60.0)))), 4)
    0.06
    """
    return np.asarray(albedo * np.maximum(mu0, 0.0))


def lunar_lambert(albedo: float, mu0: ArrayLike, mu: ArrayLike, cos_phase: ArrayLike) -> Array:
    """Return the radiance factor I/F of the lunar-Lambert model.

    `albedo` is the normal albedo; `mu0`, `mu` and `cos_phase` are the cosines of the incidence,
    emission and phase angles. The weight of the lunar term is McEwen's polynomial of the phase
    angle.

    Source: McEwen (1991), Icarus 92, 298-311.

    Examples
    --------
    >>> round(float(lunar_lambert(0.12, 0.5, 1.0, 0.5)), 4)
    0.0683
    """
    mu0, mu = np.maximum(mu0, 0.0), np.maximum(mu, 1e-4)
    phase = np.degrees(np.arccos(np.clip(cos_phase, -1.0, 1.0)))
    share = np.clip(1.0 + phase * (-0.019 + phase * (2.42e-4 - 1.46e-6 * phase)), 0.0, 1.0)
    return np.asarray(albedo * mu0 * (2.0 * share / (mu0 + mu) + 1.0 - share))


@dataclass(frozen=True)
class Hapke:
    """Hapke's model with shadow-hiding opposition surge and macroscopic roughness.

    I/F = w/4 mu0e / (mu0e + mue) [p(g) (1 + B(g)) + H(mu0e) H(mue) - 1] S(i, e, psi): Hapke (2012),
    Theory of Reflectance and Emittance Spectroscopy, 2nd ed.; H as in Hapke (2002), Icarus 157,
    523-534, Eq. 13; roughness as in Hapke (1984), Icarus 59, 41-59. Coherent backscatter is not
    modelled, and the porosity factor is 1, as in Sato et al. (2014), JGR Planets 119, 1775-1805.

    Attributes
    ----------
    w
        Single-scattering albedo.
    b, c
        Asymmetry of the lobes of the double Henyey-Greenstein phase function (larger values
        give narrower lobes), and excess of the backward lobe over the forward lobe: their
        weights are (1 + c) / 2 and (1 - c) / 2.
    surge, surge_width
        Amplitude B0 and width h of the surge; h is the tangent of half the phase angle at which
        the surge is B0 / 2.
    roughness
        Mean slope below the image resolution, rad; more than 0.
    """

    w: float
    b: float
    c: float
    surge: float
    surge_width: float
    roughness: float

    def radiance_factor(self, mu0: ArrayLike, mu: ArrayLike, cos_phase: ArrayLike) -> Array:
        """Return the radiance factor I/F; 0 where the surface faces away from the Sun.

        `mu0`, `mu` and `cos_phase` are the cosines of the incidence, emission and phase angles.
        """
        mu0, mu, cos_g = np.broadcast_arrays(
            np.asarray(mu0, float), np.asarray(mu, float), np.asarray(cos_phase, float)
        )
        lit = mu0 > 0.0
        low, mu_clipped = np.asarray(np.maximum(mu0, _MIN_COSINE)), np.asarray(np.maximum(mu, 1e-4))
        mu0_rough, mu_rough, shadow = self._roughness_correction(low, mu_clipped, cos_g)
        single = self._phase_function(cos_g) * (1.0 + self._surge(cos_g))
        several = self._h(mu0_rough) * self._h(mu_rough) - 1.0
        out = 0.25 * self.w * mu0_rough / (mu0_rough + mu_rough) * (single + several) * shadow
        return np.asarray(np.where(lit, out, 0.0))

    def _phase_function(self, cos_g: Array) -> Array:
        b2 = self.b**2
        back = (1.0 - b2) / (1.0 + b2 - 2.0 * self.b * cos_g) ** 1.5
        forth = (1.0 - b2) / (1.0 + b2 + 2.0 * self.b * cos_g) ** 1.5
        return np.asarray(0.5 * ((1.0 + self.c) * back + (1.0 - self.c) * forth))

    def _surge(self, cos_g: Array) -> Array:
        half = np.sqrt((1.0 - np.minimum(cos_g, 1.0)) / np.maximum(1.0 + cos_g, _MIN_COSINE))
        return np.asarray(self.surge / (1.0 + half / self.surge_width))

    def _h(self, x: Array) -> Array:
        gamma = np.sqrt(1.0 - self.w)
        r = (1.0 - gamma) / (1.0 + gamma)
        return np.asarray(
            1.0 / (1.0 - self.w * x * (r + 0.5 * (1.0 - 2.0 * r * x) * np.log((1.0 + x) / x)))
        )

    def _roughness_correction(
        self, mu0: Array, mu: Array, cos_g: Array
    ) -> tuple[Array, Array, Array]:
        """Return effective cosines of incidence and emission, and the shadowing factor S.

        The arguments are the cosines of the incidence, emission and phase angles (Hapke 1984).
        """
        tangent = np.tan(self.roughness)
        chi = 1.0 / np.sqrt(1.0 + np.pi * tangent**2)
        sin0, sin = (np.sqrt(np.maximum(1.0 - m * m, 1e-9)) for m in (mu0, mu))
        cos_psi = np.clip((cos_g - mu0 * mu) / (sin0 * sin), -1.0, 1.0)
        psi = np.arccos(cos_psi)
        half = 0.5 * (1.0 - cos_psi)  # sin^2(psi / 2)
        f = np.exp(-2.0 * np.sqrt(half / np.maximum(1.0 - half, 1e-9)))
        first0, first = (
            np.exp(-2.0 / np.pi * m / (s * tangent)) for m, s in ((mu0, sin0), (mu, sin))
        )
        second0, second = (
            np.exp(-((m / (s * tangent)) ** 2) / np.pi) for m, s in ((mu0, sin0), (mu, sin))
        )
        low = mu0 >= mu  # the Sun is higher than the viewer
        # The lower of the two directions determines both corrections.
        e1_far, e1_near = np.where(low, first, first0), np.where(low, first0, first)
        e2_far, e2_near = np.where(low, second, second0), np.where(low, second0, second)
        below = 2.0 - e1_far - psi / np.pi * e1_near
        near_term = (cos_psi * e2_far + half * e2_near) / below
        far_term = (e2_far - half * e2_near) / below
        mu0_rough = chi * (mu0 + sin0 * tangent * np.where(low, near_term, far_term))
        mu_rough = chi * (mu + sin * tangent * np.where(low, far_term, near_term))
        eta0 = chi * (mu0 + sin0 * tangent * second0 / (2.0 - first0))
        eta = chi * (mu + sin * tangent * second / (2.0 - first))
        near = np.where(low, mu0 / eta0, mu / eta)
        shadow = mu_rough / eta * mu0 / eta0 * chi / (1.0 - f + f * chi * near)
        return mu0_rough, mu_rough, shadow


@lru_cache(maxsize=32)
def hapke_of_albedo(
    albedo: float, b: float, c: float, surge: float, surge_width: float, roughness: float
) -> Hapke:
    """Return Hapke's model with a given normal albedo.

    The single-scattering albedo w is solved for; the other arguments are the fields of `Hapke`.

    Raises
    ------
    InputError
        If no single-scattering albedo w gives the normal albedo.
    """
    if not 0.0 <= albedo <= 1.0:
        raise InputError("sun.albedo", albedo, "must be between 0 and 1")

    def excess(w: float) -> float:
        law = Hapke(w, b, c, surge, surge_width, roughness)
        return float(law.radiance_factor(1.0, 1.0, 1.0)) - albedo

    if excess(1.0 - 1e-9) < 0.0:
        max_albedo = albedo + excess(1.0 - 1e-9)
        raise InputError(
            "sun.albedo", albedo, f"must be at most {max_albedo:.3f} with these Hapke parameters"
        )
    w = brentq(excess, 0.0, 1.0 - 1e-9, xtol=1e-12)
    return Hapke(float(w), b, c, surge, surge_width, roughness)
