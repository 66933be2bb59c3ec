"""Gaussian digital elevation map (DEM): mean and variance of each cell's height.

Tomita and Ho, "Real-Time Stochastic Terrain Mapping and Processing for Autonomous Safe Landing".
"""

from lunarsim.onboard.hazards.gaussian_dem.conventional import ConventionalDem, conventional_dem
from lunarsim.onboard.hazards.gaussian_dem.full_regression import full_regression
from lunarsim.onboard.hazards.gaussian_dem.gaussian import GaussianDem, gaussian_dem
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapper
from lunarsim.onboard.hazards.gaussian_dem.pooled import pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.samples import SamplePool
from lunarsim.onboard.hazards.gaussian_dem.variogram_fit import FieldFit, fit_hyperparameters

__all__ = [
    "ConventionalDem",
    "FieldFit",
    "GaussianDem",
    "GaussianDemMapper",
    "SamplePool",
    "conventional_dem",
    "fit_hyperparameters",
    "full_regression",
    "gaussian_dem",
    "pooled_dem",
]
