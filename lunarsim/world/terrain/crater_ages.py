"""Degradation of lunar craters by diffusion of the profile of a fresh crater.

Small impacts and their ejecta move soil diffusively: the elevation obeys
``dz/dt = kappa laplace(z)`` (Fassett and Thomson 2014, J. Geophys. Res. Planets 119, 2255). In
units of the crater radius R the profile depends only on ``age = kappa t / R^2``, so that one table
of profiles serves craters of every size. The mean kappa over 3 Gyr on the maria is 5.5 m^2/Myr;
then a crater 1 km across keeps 52 % of its depth and one of 300 m 7 %, about the limit of
recognition (ibid.). With the profile of `craters` the values are 60 % and 7 %.

In equilibrium craters form at a constant rate, and the ages of the countable ones are uniform up to
that limit (Minton et al. 2019, Icarus 326, 63). Most craters are therefore shallow.

Fresh craters below a kilometre are shallower than the 0.2 diameters of larger ones (Pike 1974,
Geophys. Res. Lett. 1, 291): down to 0.1 diameters (Sun et al. 2018, Icarus 309, 61). The ratio is
assumed to fall with the logarithm of the diameter, to 0.1 at 10 m and below.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import i0e

from lunarsim.errors import InputError
from lunarsim.typing import Array
from lunarsim.world.terrain._crater_kernels import add_degraded_profiles
from lunarsim.world.terrain.craters import CraterLaw, crater_profile, draw_sizes_and_positions
from lunarsim.world.terrain.heightfield import Heightfield

# Depth of the oldest counted crater over that of a fresh one.
MIN_RELATIVE_DEPTH = 0.07
# Outer radius of the profiles, crater radii; at the maximum age 1e-3 of the depth remains outside.
PROFILE_RADII = 5.0
_AGES, _RADII = 33, 251
# Depth over diameter of fresh craters of 1 km or more, and of 10 m or less.
_DEEP, _SHALLOW = 0.2, 0.1
_LARGE, _SMALL = 1000.0, 10.0


def fresh_depth_ratio(diameter: ArrayLike) -> Array:
    """Return depth (rim to floor) over diameter of fresh craters of a `diameter` (m)."""
    d = np.asarray(diameter, dtype=np.float64)
    share = np.log(np.clip(d, _SMALL, _LARGE) / _SMALL) / np.log(_LARGE / _SMALL)
    return np.asarray(_SHALLOW + (_DEEP - _SHALLOW) * share)


def diffuse_profile(radius: ArrayLike, age: float) -> Array:
    """Return the height profile of a crater degraded by diffusion, over fresh depth.

    Parameters
    ----------
    radius
        Distance from the centre (n,), crater radii.
    age
        Dimensionless age kappa t / R^2: diffusivity times time over radius squared.

    Returns
    -------
    Array
        Elevation above the terrain before the impact (n,), over the fresh depth: the fresh profile
        convolved with the kernel of radial diffusion,
        ``1/(2 age) exp(-(r^2 + s^2)/(4 age)) I0(r s / (2 age)) s ds``.
    """
    if not (np.isfinite(age) and age >= 0.0):
        raise InputError("age", age, "must be 0 or more and finite")
    r = np.asarray(radius, dtype=np.float64)
    fresh = crater_profile(r, 2.0, 1.0) / fresh_profile_depth()
    if age < 1e-4:
        return np.asarray(fresh)
    # Midpoint rule with steps much smaller than the kernel's width.
    step = min(0.01, 0.2 * np.sqrt(2.0 * age))
    s = np.arange(0.5 * step, 3.0 + step, step)
    source = crater_profile(s, 2.0, 1.0) / fresh_profile_depth() * s * step
    x = r[:, None] * s / (2.0 * age)
    # exp(-(r - s)^2 / 4 age) times I0 scaled by exp(-x) does not overflow.
    kernel = np.exp(-((r[:, None] - s) ** 2) / (4.0 * age)) * i0e(x) / (2.0 * age)
    return np.asarray(kernel @ source)


def fresh_profile_depth() -> float:
    """Return the depth (rim to floor) of a fresh crater with a radius of 1 m, m."""
    rim, floor = crater_profile(np.array([1.0, 0.0]), 2.0, 1.0)
    return float(rim - floor)


def relative_depth(age: float) -> float:
    """Return the depth of a degraded crater over its depth when fresh.

    `age` is dimensionless, kappa t / R^2.
    """
    profile = diffuse_profile(np.linspace(0.0, PROFILE_RADII, _RADII), age)
    return float(profile.max() - profile[0])


@lru_cache(maxsize=1)
def max_crater_age() -> float:
    """Return the age (kappa t / R^2) of the oldest counted craters.

    Their depth is `MIN_RELATIVE_DEPTH` times the depth when fresh.
    """
    return float(brentq(lambda age: relative_depth(age) - MIN_RELATIVE_DEPTH, 0.0, 5.0))


@lru_cache(maxsize=1)
def _profiles() -> Array:
    """Tabulate height profiles (ages, radii) over the fresh depth.

    Rows are at uniform steps of the square root of age, columns at uniform steps of distance.
    """
    r = np.linspace(0.0, PROFILE_RADII, _RADII)
    ages = np.linspace(0.0, np.sqrt(max_crater_age()), _AGES) ** 2
    return np.stack([diffuse_profile(r, age) for age in ages])


@dataclass(frozen=True)
class AgedCraters:
    """Craters in equilibrium, degraded by diffusion.

    Attributes
    ----------
    x, y, diameter
        East and north coordinates of the centres, and diameters (n,), largest first, m.
    age
        Age over the maximum age (n,): 0 for a fresh crater, 1 for one that is barely countable.
    """

    x: Array
    y: Array
    diameter: Array
    age: Array

    @classmethod
    def draw(
        cls,
        relief: Heightfield,
        rng: np.random.Generator,
        *,
        minimum: float,
        maximum: float | None = None,
        law: CraterLaw | None = None,
    ) -> AgedCraters:
        """Sample craters with uniformly distributed ages.

        Parameters
        ----------
        relief
            Relief to which the craters will be added; the craters cover its area.
        rng
            Source of sizes, positions and ages.
        minimum, maximum
            Limits of the diameters, m; the default maximum is a quarter of the shorter side.
        law
            Size-frequency distribution; omitted: mare in equilibrium below 200 m.
        """
        diameter, x, y = draw_sizes_and_positions(relief, rng, PROFILE_RADII, minimum, maximum, law)
        return cls(x, y, diameter, rng.random(diameter.size))

    def add_to(self, relief: Heightfield) -> Heightfield:
        """Return `relief` with these craters added, shifted to zero mean."""
        depth = fresh_depth_ratio(self.diameter) * self.diameter
        z = relief.z.astype(np.float64)
        g = relief.grid
        add_degraded_profiles(
            z, g.x0, g.y0, g.posting, self.x, self.y, 0.5 * self.diameter, depth,
            np.sqrt(self.age), _profiles(), PROFILE_RADII,
        )  # fmt: skip
        return Heightfield(g, (z - np.nanmean(z)).astype(np.float32))
