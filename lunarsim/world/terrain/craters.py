"""Size-frequency distribution and profile of craters.

Small craters on old terrain are in equilibrium: new craters erase as many as they add, and
``N(D) = 0.079 D**-2`` craters of diameter D (m) or more exist per square metre (Trask 1966; Xiao
and Werner 2015). Larger craters follow the production function, which is steeper by one power of
D. A fresh simple crater is 0.2 D deep from rim to floor, with a rim 0.036 D high (Pike 1977) and an
ejecta apron that thins with the cube of the distance (McGetchin, Settle and Head 1973).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.typing import Array
from lunarsim.world.terrain._crater_kernels import add_crater_profiles
from lunarsim.world.terrain.heightfield import Heightfield

# Depth from rim to floor and rim height of a fresh crater, over its diameter.
DEPTH_RATIO = 0.2
RIM_HEIGHT_RATIO = 0.036
# Outer radius of the ejecta apron, in crater radii.
APRON_RADII = 3.0


@dataclass(frozen=True)
class CraterLaw:
    """Cumulative size-frequency distribution of craters: N(D) per square metre.

    Attributes
    ----------
    density
        Craters of 1 m or more per square metre in equilibrium.
    saturation
        Diameter below which the surface is in equilibrium, m: about 200 m on a mare of 3.5 Gyr.
    """

    density: float = 0.079
    saturation: float = 200.0

    def __post_init__(self) -> None:
        if not 0.0 < self.density <= 0.3:
            raise InputError("craters.density", self.density, "must be more than 0 and at most 0.3")
        if not self.saturation > 0.0:
            raise InputError("craters.saturation", self.saturation, "must be positive")

    def number(self, diameter: ArrayLike) -> Array:
        """Return the number per square metre of craters of `diameter` (m) or more."""
        d = np.asarray(diameter, dtype=np.float64)
        return np.asarray(self.density * d**-2.0 * np.minimum(1.0, self.saturation / d))

    def sample(
        self, area: float, minimum: float, maximum: float, rng: np.random.Generator
    ) -> Array:
        """Sample the diameters (m) of the craters on `area` (m^2), largest first.

        `minimum` and `maximum` are the limits of the diameters, m.
        """
        if not 0.0 < minimum < maximum:
            raise InputError(
                "craters.min_diameter_m",
                minimum,
                f"must be positive and less than the maximum diameter, {maximum:g} m",
            )
        max_number, min_number = float(self.number(minimum)), float(self.number(maximum))
        count = int(rng.poisson(area * (max_number - min_number)))
        n = min_number + rng.random(count) * (max_number - min_number)
        equilibrium = np.sqrt(self.density / n)
        production = np.cbrt(self.density * self.saturation / n)
        diameter = np.where(equilibrium < self.saturation, equilibrium, production)
        return np.sort(diameter)[::-1].copy()


def crater_profile(r: ArrayLike, diameter: float, freshness: float) -> Array:
    """Return the height, m, that a crater adds at distance `r` (m) from its centre.

    `diameter` is that of the rim, m.
    The profile is a paraboloid inside the rim; outside, an apron falls with the cube of the
    distance and ends smoothly at three radii. `freshness` runs from 0 (erased) to 1 (new): the
    depth is proportional to it, the height of the rim, which erodes faster, to its square.
    """
    x = np.asarray(r, dtype=np.float64) / (0.5 * diameter)
    rim = RIM_HEIGHT_RATIO * diameter * freshness**2
    bowl = rim + DEPTH_RATIO * diameter * freshness * (x**2 - 1.0)
    safe = np.maximum(x, 1.0)
    fade = np.clip((APRON_RADII - safe) / (APRON_RADII - 1.0), 0.0, 1.0)
    apron = rim * safe**-3.0 * fade * fade * (3.0 - 2.0 * fade)
    return np.asarray(np.where(x < 1.0, bowl, apron))


def add_craters(
    relief: Heightfield,
    rng: np.random.Generator,
    *,
    minimum: float,
    maximum: float | None = None,
    law: CraterLaw | None = None,
) -> Heightfield:
    """Add random craters, whose freshness is uniform from 0 to 1, to a relief.

    Parameters
    ----------
    relief
        Relief without the craters.
    rng
        Source of sizes, positions and freshness.
    minimum, maximum
        Limits of the diameters, m; the default maximum is a quarter of the shorter side.
    law
        Size-frequency distribution; omitted: mare in equilibrium below 200 m.

    Returns
    -------
    Heightfield
        Relief with the craters, shifted to zero mean.
    """
    diameter, x, y = draw_sizes_and_positions(relief, rng, APRON_RADII, minimum, maximum, law)
    freshness = rng.random(diameter.size)
    z = relief.z.astype(np.float64)
    g = relief.grid
    add_crater_profiles(
        z,
        g.x0,
        g.y0,
        g.posting,
        x,
        y,
        diameter,
        freshness,
        DEPTH_RATIO,
        RIM_HEIGHT_RATIO,
        APRON_RADII,
    )
    return Heightfield(g, (z - np.nanmean(z)).astype(np.float32))


def draw_sizes_and_positions(
    relief: Heightfield,
    rng: np.random.Generator,
    reach: float,
    minimum: float,
    maximum: float | None,
    law: CraterLaw | None,
) -> tuple[Array, Array, Array]:
    """Sample diameters (n,), largest first, and centres x, y (n,) of craters, m.

    Parameters
    ----------
    relief
        Relief of the map.
    rng
        Source of sizes and positions.
    reach
        Outer radius of a crater's profile, crater radii; centres lie up to this far off the map.
    minimum, maximum
        Limits of the diameters, m; None: the maximum is a quarter of the shorter side.
    law
        Size-frequency distribution; None: mare in equilibrium below 200 m.
    """
    west, east, south, north = relief.bounds
    if maximum is None:
        maximum = 0.25 * min(east - west, north - south)
    edge = 0.5 * reach * maximum
    area = (east - west + 2.0 * edge) * (north - south + 2.0 * edge)
    diameter = (law or CraterLaw()).sample(area, minimum, maximum, rng)
    x = rng.uniform(west - edge, east + edge, diameter.size)
    y = rng.uniform(south - edge, north + edge, diameter.size)
    return diameter, x, y
