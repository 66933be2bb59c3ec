"""Snapshot of a Gaussian DEM: elevations now, site evaluation on demand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.gaussian_dem import MapEvidence
from lunarsim.onboard.calibration.scenario_calibration import ScenarioCalibration
from lunarsim.onboard.hazards.gaussian_dem.pooled import PooledDem
from lunarsim.onboard.hazards.hazard_map import BoolMap, FloatMap, HazardMap
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import bounded_safety, plane_stochastic_safety, stochastic_safety
from lunarsim.safety.beam_averaging import (
    peak_ratio,
    sharpened_elevation,
    unaveraged_height,
    variogram_ratio,
)
from lunarsim.safety.unseen_rocks import depth_curve, height_curve


@dataclass(frozen=True)
class DemSnapshot:
    """Elevation map at one time, with its landing safety computed on demand.

    Attributes
    ----------
    dem
        Mean and variance of the elevations.
    lander, rocks
        Geometry and limits of the lander; rock population expected by the mission.
    scenario_calibration
        Last stage of the safety calibration, fitted to the scenario; None: the calibration supplied
        with lunarsim.
    beam_ratio
        Standard deviation of the beam's intensity over the spacing of the samples.
    is_consistent
        Whether the scans agree with each other within their stated errors; if not, no site is in
        the calibrated domain.
    """

    dem: PooledDem
    lander: Lander
    rocks: RockExpectation
    scenario_calibration: ScenarioCalibration | None = None
    beam_ratio: float = 0.0
    is_consistent: bool = True

    @property
    def grid(self) -> Grid:
        """Cells of the map."""
        return self.dem.grid

    @property
    def elevation(self) -> FloatMap:
        """Mean elevation (rows, cols), m; NaN where unknown."""
        return self.dem.mean

    @property
    def variance(self) -> FloatMap:
        """Variance of the elevation (rows, cols), m^2."""
        return self.dem.variance

    @property
    def observed(self) -> BoolMap:
        """Where the complete footprint of the lander has been observed (rows, cols)."""
        return self.site_evidence.observed

    @property
    def residual_heights(self) -> NDArray[np.float32]:
        """Height of the sample in each cell above the local terrain plane (rows, cols), m.

        NaN without a sample.
        """
        return self.dem.sampling.residual_raster

    @cached_property
    def site_evidence(self) -> MapEvidence:
        """Inputs of the safety calibration for each site, such as slope and roughness."""
        found = dem_site_evidence(self.dem, self.lander, self.rocks, self.beam_ratio)
        return replace(found, is_consistent=self.is_consistent)

    @cached_property
    def hazard_map(self) -> HazardMap:
        """Hazard map with the calibrated probability of safe terrain."""
        p, known = calibrated_safety(self.site_evidence, refit=self.scenario_calibration)
        return HazardMap(
            self.grid, p, self.observed, self.elevation, self.variance, in_domain=known
        )


def dem_site_evidence(
    dem: PooledDem, lander: Lander, rocks: RockExpectation, beam_ratio: float = 0.0
) -> MapEvidence:
    """Compute the inputs of the safety calibration for each site from elevations.

    They are slope, roughness and their uncertainty, the distributions of heights above and depths
    below the local terrain plane, and the sampling statistics. `lander` gives the limits, and
    `rocks` is the rock population expected by the mission. Heights are corrected for the averaging
    over beams whose standard deviation is `beam_ratio` times the spacing of the samples.
    """
    s = dem.sampling
    beam = beam_ratio * s.spacing
    observed_mean = sharpened_elevation(
        np.where(dem.observed, dem.mean, np.float32(np.nan)), dem.grid.posting, beam
    )
    # What a cell hides is at most as wide as the cell. Squared: few beams hit its centre.
    hidden = (dem.peak - dem.mean) / np.float32(peak_ratio(0.5 * dem.grid.posting, beam) ** 2)
    surface = np.maximum(observed_mean, dem.mean + hidden)
    curve_args = (
        unaveraged_height(s.residual_heights, beam, rocks.height_ratio[0]),
        s.noise,
        lander.roughness_limit,
        rocks.cover,
        rocks.height_ratio[0],
    )
    # Squared: rocks make the variogram rise more steeply at short distances than the linear model.
    loss = variogram_ratio(max(s.spacing, dem.grid.posting), beam) ** 2
    variance = dem.variance / np.float32(loss)
    return MapEvidence(
        stochastic_safety(surface, variance, dem.grid, lander),
        plane_stochastic_safety(surface, variance, dem.grid, lander),
        bounded_safety(surface, dem.grid, lander),
        lander,
        height_curve(*curve_args, rocks.shape),
        depth_curve(*curve_args),
        s.density,
        s.noise,
        s.spacing,
        beam_sigma=beam,
        height_ratio=rocks.height_ratio[0],
    )
