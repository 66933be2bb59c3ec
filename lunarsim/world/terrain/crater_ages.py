"""How craters of the Moon age: by diffusion of the ground, from the profile of a new one.

What wears craters down (small impacts, their ejecta) moves soil as diffusion would: the elevation
obeys ``dz/dt = kappa laplace(z)`` (Fassett and Thomson 2014, J. Geophys. Res. Planets 119, 2255).
In radii R of the crater all depends on ``age = kappa t / R^2`` alone, so one table of profiles
serves craters of every size. The mean kappa of 3 Gyr on the maria is 5.5 m^2/Myr; a crater 1 km
across keeps 52 % of its depth then, and one of 300 m 7 %, about where craters are no longer
recognised (ibid.). From the profile of `craters` it is 60 % and 7 %.

Where craters are in equilibrium new ones appear at an even rate, and those that can be counted have
ages spread evenly up to that limit (Minton et al. 2019, Icarus 326, 63). So most are shallow.

New craters below a kilometre are shallower than the fifth of the diameter of larger ones (Pike
1974, Geophys. Res. Lett. 1, 291): from 0.2 down to 0.1 of the diameter (Sun et al. 2018, Icarus
309, 61). Between, the ratio is taken to fall with the logarithm of the diameter, to 0.1 at 10 m and
below.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import i0e

from lunarsim.errors import InputError
from lunarsim.world.terrain._crater_kernels import stamp_profiles
from lunarsim.world.terrain.craters import CraterLaw, crater_profile, sizes_and_places
from lunarsim.world.terrain.heightfield import Heightfield

Array = NDArray[np.float64]

# Depth that is left of a crater at the end of its time, over that of a new one.
LEAST_DEPTH = 0.07
# Profiles end here, in crater radii; at the greatest age 1e-3 of the depth is left outside.
REACH = 5.0
_AGES, _RADII = 33, 251
# Rim to floor over diameter: of craters of a kilometre or more, and of 10 m or less.
_DEEP, _SHALLOW = 0.2, 0.1
_LARGE, _SMALL = 1000.0, 10.0


def fresh_depth(diameter: ArrayLike) -> Array:
    """Return the depth of new craters from rim to floor over their diameter (m)."""
    d = np.asarray(diameter, dtype=np.float64)
    share = np.log(np.clip(d, _SMALL, _LARGE) / _SMALL) / np.log(_LARGE / _SMALL)
    return np.asarray(_SHALLOW + (_DEEP - _SHALLOW) * share)


def diffused(radius: ArrayLike, age: float) -> Array:
    """Return the profile of a crater of a given age, over the fresh depth from rim to floor.

    Parameters
    ----------
    radius
        Distance from the middle (n,), crater radii.
    age
        kappa t / R^2.

    Returns
    -------
    Array
        Elevation over the ground before the impact (n,), over the fresh depth: the profile of a
        new crater under the kernel of radial diffusion,
        ``1/(2 age) exp(-(r^2 + s^2)/(4 age)) I0(r s / (2 age)) s ds``.
    """
    if not (np.isfinite(age) and age >= 0.0):
        raise InputError("age", age, "kappa t / R^2 of at least 0")
    r = np.asarray(radius, dtype=np.float64)
    fresh = crater_profile(r, 2.0, 1.0) / fresh_rim_to_floor()
    if age < 1e-4:
        return np.asarray(fresh)
    # Midpoints, finer than the kernel is wide.
    step = min(0.01, 0.2 * np.sqrt(2.0 * age))
    s = np.arange(0.5 * step, 3.0 + step, step)
    source = crater_profile(s, 2.0, 1.0) / fresh_rim_to_floor() * s * step
    x = r[:, None] * s / (2.0 * age)
    # exp(-(r - s)^2 / 4 age) times I0 scaled by exp(-x): no overflow.
    kernel = np.exp(-((r[:, None] - s) ** 2) / (4.0 * age)) * i0e(x) / (2.0 * age)
    return np.asarray(kernel @ source)


def fresh_rim_to_floor() -> float:
    """Return the depth of `crater_profile` from rim to floor, for a diameter of 2, m."""
    rim, floor = crater_profile(np.array([1.0, 0.0]), 2.0, 1.0)
    return float(rim - floor)


def depth_left(age: float) -> float:
    """Return the depth from rim to floor over that of a new crater."""
    profile = diffused(np.linspace(0.0, REACH, _RADII), age)
    return float(profile.max() - profile[0])


@lru_cache(maxsize=1)
def greatest_age() -> float:
    """Return the age (kappa t / R^2) at which `LEAST_DEPTH` is left."""
    return float(brentq(lambda age: depth_left(age) - LEAST_DEPTH, 0.0, 5.0))


@lru_cache(maxsize=1)
def _profiles() -> Array:
    """Return profiles (ages, radii) at roots of the age from 0 on, and radii from 0 to `REACH`."""
    r = np.linspace(0.0, REACH, _RADII)
    ages = np.linspace(0.0, np.sqrt(greatest_age()), _AGES) ** 2
    return np.stack([diffused(r, age) for age in ages])


@dataclass(frozen=True)
class AgedCraters:
    """Craters in equilibrium.

    Attributes
    ----------
    x, y, diameter
        Middles and diameters (n,), largest first, m.
    age
        Over the greatest age (n,): 0 for a new one, 1 for one that is not counted any more.
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
        """Draw craters by the law, of all ages alike.

        Parameters
        ----------
        relief
            The ground that they are to change.
        rng
            Source of sizes, places and ages.
        minimum, maximum, law
            As for `lunarsim.world.terrain.craters.add_craters`.
        """
        diameter, x, y = sizes_and_places(relief, rng, REACH, minimum, maximum, law)
        return cls(x, y, diameter, rng.random(diameter.size))

    def on(self, relief: Heightfield) -> Heightfield:
        """Return the relief with these craters, worn by diffusion, about a mean of 0."""
        depth = fresh_depth(self.diameter) * self.diameter
        z = relief.z.astype(np.float64)
        g = relief.grid
        stamp_profiles(
            z, g.x0, g.y0, g.posting, self.x, self.y, 0.5 * self.diameter, depth,
            np.sqrt(self.age), _profiles(), REACH,
        )  # fmt: skip
        return Heightfield(g, (z - np.nanmean(z)).astype(np.float32))
