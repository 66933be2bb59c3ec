"""Roughness and craters of procedural relief, by preset or by figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.parts.quantity import quantity
from lunarsim.world.terrain import (
    AgedCraters,
    CraterLaw,
    Heightfield,
    add_craters,
    add_fine_roughness,
    fractal_relief,
)

# Procedural relief is the same ground for all flights of a scenario; only rocks are redrawn.
_RELIEF_SEED = 20260101
# Hurst exponent, slope at 1 m (rad) and crater density. Median Hurst exponents of maria and
# highlands, and their slopes carried to 1 m by them, from Rosenburg et al. (2011), J. Geophys. Res.
# 116, E02001. Those of the polar preset are of the ridge beside Shackleton crater at the south
# pole, which is steeper than most highland: median slope of LOLA elevations 40 m apart, 12.4 deg,
# carried to 1 m by the Hurst exponent of medians over 40 to 160 m
# (tests/world/grounds/test_fractal.py).
_PRESETS: dict[str, tuple[float, float, float]] = {
    "none": (0.85, np.deg2rad(2.5), 0.0),
    "mare": (0.76, np.deg2rad(3.9), 0.079),
    "highland": (0.95, np.deg2rad(8.6), 0.079),
    "polar": (0.983, np.deg2rad(13.2), 0.079),
}

# Craters of fewer posts across are none.
_POSTS_ACROSS = 4.0


@dataclass(frozen=True)
class Roughness:
    """Fractal relief and craters.

    Attributes
    ----------
    preset
        Where what is left out comes from.
    hurst, rms_slope
        Hurst exponent, and slope at 1 m baseline (rad).
    crater_density
        Craters of 1 m or more on a square metre in equilibrium; 0: none.
    crater_saturation, crater_min_diameter
        Diameter where equilibrium ends, and least one drawn, m.
    crater_ageing
        How craters are worn: "even" from a fifth of the diameter to nothing, all depths alike; or
        by "diffusion", small ones shallow from the start (`lunarsim.world.terrain.crater_ages`).
    """

    preset: Literal["none", "mare", "highland", "polar"] = quantity(
        "none", help="kind of ground that gives roughness and craters where they are left out"
    )
    hurst: float | None = quantity(None, gt=0, lt=1, help="Hurst exponent")
    rms_slope: float | None = quantity(None, "deg", ge=0, lt=45, help="at 1 m baseline")
    crater_density: float | None = quantity(
        None, ge=0, le=0.3, help="craters of 1 m or more on 1 m^2 in equilibrium; 0: none"
    )
    crater_saturation: float = quantity(200.0, "m", gt=0, help="diameter where equilibrium ends")
    crater_min_diameter: float = quantity(2.0, "m", gt=0, help="least diameter drawn")
    crater_ageing: Literal["even", "diffusion"] = quantity(
        "even",
        help="all depths alike, or worn by diffusion: most shallow, small ones from the start",
    )

    def procedural(
        self, grid: Grid, largest: float | None = None, *, detail: float | None = None
    ) -> Heightfield:
        """Return fractal relief, with craters (the largest as given, m) if any are asked for.

        With a `detail` it is the same ground at posts so far apart, m, rough down to them, with
        craters from four posts up.
        """
        hurst, slope, density = self._figures()
        rng = np.random.default_rng(_RELIEF_SEED)
        relief = fractal_relief(grid, rng, hurst=hurst, rms_slope=slope)
        if detail is not None:
            fine = np.random.default_rng([_RELIEF_SEED, 2])
            relief = add_fine_roughness(relief, detail, fine, hurst=hurst, rms_slope=slope)
            relief = self._small_craters(relief, fine, density)
        if density == 0.0:
            return relief
        if self.crater_ageing == "diffusion":
            return self.craters(relief, largest).on(relief)
        law = CraterLaw(density, self.crater_saturation)
        return add_craters(relief, rng, minimum=self.crater_min_diameter, maximum=largest, law=law)

    def _small_craters(
        self, relief: Heightfield, rng: np.random.Generator, density: float
    ) -> Heightfield:
        """Return relief with craters too small to be drawn at coarser posts."""
        least, most = _POSTS_ACROSS * relief.grid.posting, self.crater_min_diameter
        if density == 0.0 or least >= most:
            return relief
        law = CraterLaw(density, self.crater_saturation)
        if self.crater_ageing == "even":
            return add_craters(relief, rng, minimum=least, maximum=most, law=law)
        return AgedCraters.draw(relief, rng, minimum=least, maximum=most, law=law).on(relief)

    def craters(self, relief: Heightfield, largest: float | None = None) -> AgedCraters:
        """Return the craters of a relief of this grid that are worn by diffusion.

        Raises
        ------
        InputError
            If there are none, or they age otherwise.
        """
        density = self._figures()[2]
        if density == 0.0 or self.crater_ageing != "diffusion":
            raise InputError(
                "rocks.clustered",
                f"crater_ageing {self.crater_ageing!r}, crater_density {density}",
                '0, or ground with craters that age by "diffusion"',
            )
        law = CraterLaw(density, self.crater_saturation)
        rng = np.random.default_rng([_RELIEF_SEED, 1])
        return AgedCraters.draw(
            relief, rng, minimum=self.crater_min_diameter, maximum=largest, law=law
        )

    def _figures(self) -> tuple[float, float, float]:
        """Return Hurst exponent, slope and crater density, from the preset where left out."""
        own = (self.hurst, self.rms_slope, self.crater_density)
        hurst, slope, density = (
            preset if mine is None else mine
            for mine, preset in zip(own, _PRESETS[self.preset], strict=True)
        )
        return hurst, slope, density
