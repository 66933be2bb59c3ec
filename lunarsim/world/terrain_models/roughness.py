"""Roughness and craters of procedural relief, by preset or parameters."""

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

# Hurst exponent, RMS slope at 1 m (rad) and crater density. Mare and highland: median Hurst
# exponents and slopes from Rosenburg et al. (2011), J. Geophys. Res. 116, E02001; the exponents
# extrapolate the slopes to 1 m. Polar: the ridge beside Shackleton crater at the south pole, which
# is steeper than most highland. Its median slope of LOLA elevations 40 m apart, 12.4 deg, is
# extrapolated to 1 m by the Hurst exponent of medians over 40 to 160 m
# (tests/world/grounds/test_fractal.py).
_PRESETS: dict[str, tuple[float, float, float]] = {
    "none": (0.85, np.deg2rad(2.5), 0.0),
    "mare": (0.76, np.deg2rad(3.9), 0.079),
    "highland": (0.95, np.deg2rad(8.6), 0.079),
    "polar": (0.983, np.deg2rad(13.2), 0.079),
}

# Minimum diameter of a crater that the relief resolves, in grid spacings.
_MIN_CRATER_POSTS = 4.0


@dataclass(frozen=True)
class ReliefRoughness:
    """Settings of procedural relief: roughness and craters, by preset or parameters.

    Attributes
    ----------
    crater_degradation
        Wear of the craters. "uniform": depth-diameter ratios are uniform from 0 to a fifth;
        "diffusion": craters degrade by diffusion, so that small ones are shallow
        (`lunarsim.world.terrain.crater_ages`).
    """

    preset: Literal["none", "mare", "highland", "polar"] = quantity(
        "none",
        help="terrain type that sets hurst, rms_slope_deg and crater_density if they are omitted; "
        "with the preset none, the RMS slope is 2.5 deg and there are no craters",
    )
    hurst: float | None = quantity(
        None, gt=0, lt=1, help="Hurst exponent of the relief; omitted: value of the preset"
    )
    rms_slope: float | None = quantity(
        None,
        "deg",
        ge=0,
        lt=45,
        help="RMS slope of the relief over a baseline of 1 m; omitted: value of the preset",
    )
    crater_density: float | None = quantity(
        None,
        ge=0,
        le=0.3,
        help="number per m^2 of craters with a diameter of at least 1 m, as long as this is below "
        "crater_equilibrium_diameter_m; 0: no craters; omitted: value of `preset`",
    )
    crater_equilibrium_diameter: float = quantity(
        200.0,
        "m",
        gt=0,
        help="diameter below which as many craters erode as form (equilibrium); larger values "
        "model older terrain, which has more large craters",
    )
    crater_min_diameter: float = quantity(2.0, "m", gt=0, help="minimum crater diameter")
    crater_degradation: Literal["uniform", "diffusion"] = quantity(
        "uniform",
        help="wear of the craters: uniform (all depths are equally likely) or diffusion (small "
        "craters are shallow)",
    )
    relief_seed: int = quantity(
        20260101, ge=0, le=2**32 - 1,
        help="random seed of relief and craters, which are the same in all flights of a scenario; "
        "rocks are random in every flight",
    )  # fmt: skip

    def procedural_relief(
        self, grid: Grid, largest: float | None = None, *, detail: float | None = None
    ) -> Heightfield:
        """Generate fractal relief with craters on a grid.

        `largest` is the maximum crater diameter, m (None: a quarter of the shorter side). If
        `detail`, a finer grid spacing (m), is given, the same relief is returned at that spacing,
        with short-wavelength roughness and craters of at least four spacings in diameter added.
        """
        hurst, slope, density = self._parameters()
        rng = np.random.default_rng(self.relief_seed)
        relief = fractal_relief(grid, rng, hurst=hurst, rms_slope=slope)
        if detail is not None:
            fine = np.random.default_rng([self.relief_seed, 2])
            relief = add_fine_roughness(relief, detail, fine, hurst=hurst, rms_slope=slope)
            relief = self._add_small_craters(relief, fine, density)
        if density == 0.0:
            return relief
        if self.crater_degradation == "diffusion":
            return self.craters(relief, largest).add_to(relief)
        law = CraterLaw(density, self.crater_equilibrium_diameter)
        return add_craters(relief, rng, minimum=self.crater_min_diameter, maximum=largest, law=law)

    def _add_small_craters(
        self, relief: Heightfield, rng: np.random.Generator, density: float
    ) -> Heightfield:
        """Return refined relief with added craters too small for the coarser grid.

        `density` is the number of craters of 1 m or more per m^2; 0: no craters.
        """
        min_diameter, max_diameter = (
            _MIN_CRATER_POSTS * relief.grid.posting,
            self.crater_min_diameter,
        )
        if density == 0.0 or min_diameter >= max_diameter:
            return relief
        law = CraterLaw(density, self.crater_equilibrium_diameter)
        if self.crater_degradation == "uniform":
            return add_craters(relief, rng, minimum=min_diameter, maximum=max_diameter, law=law)
        return AgedCraters.draw(
            relief, rng, minimum=min_diameter, maximum=max_diameter, law=law
        ).add_to(relief)

    def craters(self, relief: Heightfield, largest: float | None = None) -> AgedCraters:
        """Return the craters of a relief whose craters are degraded by diffusion.

        `largest` is their maximum diameter, m; None: a quarter of the relief's shorter side.

        Raises
        ------
        InputError
            If the settings have no craters or `crater_degradation` is not "diffusion".
        """
        density = self._parameters()[2]
        if density == 0.0 or self.crater_degradation != "diffusion":
            raise InputError(
                "rocks.cluster_fraction",
                self.crater_degradation,
                "must be 0 on terrain without craters that degrade by diffusion",
                'Or set terrain.crater_degradation = "diffusion" and terrain.crater_density > 0.',
                show_value=False,
            )
        law = CraterLaw(density, self.crater_equilibrium_diameter)
        rng = np.random.default_rng([self.relief_seed, 1])
        return AgedCraters.draw(
            relief, rng, minimum=self.crater_min_diameter, maximum=largest, law=law
        )

    def _parameters(self) -> tuple[float, float, float]:
        """Return Hurst exponent, RMS slope (rad) and crater density (per m^2).

        Omitted settings take the values of the preset.
        """
        own = (self.hurst, self.rms_slope, self.crater_density)
        hurst, slope, density = (
            preset if mine is None else mine
            for mine, preset in zip(own, _PRESETS[self.preset], strict=True)
        )
        return hurst, slope, density
