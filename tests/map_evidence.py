"""Evidence of made maps, all of whose sites are alike or as the arrays say."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.gaussian_dem import MapEvidence
from lunarsim.safety import SafetyMap
from lunarsim.safety.conservative import StochasticSafety
from lunarsim.safety.unseen_rocks import ExceedanceCurve, height_curve

LANDER = Lander()
SIDE = 9


def rocky(times: float = 1.0) -> ExceedanceCurve:
    """Return the curve of a mission's law alone, so many times as rocky."""
    curve = height_curve(np.zeros(0), 0.01, LANDER.roughness_limit, 0.05)
    return ExceedanceCurve(curve.height, np.minimum(times * curve.share, 0.5))


def evidence(
    *,
    slope=0.5,
    rough=0.5,
    level=1.0,
    planes=2.0,
    curve=None,
    holes=None,
    density=30.0,
    noise=0.01,
    seen=None,
) -> MapEvidence:
    """Return a map all of whose sites are alike, or as the arrays (SIDE, SIDE) say.

    Slope and roughness are shares of the limits, `level` and `planes` probits of both tests.
    """
    grid = Grid(0.0, 0.0, 0.5, SIDE, SIDE)
    seen = np.ones(grid.shape, bool) if seen is None else seen

    def raster(value):
        return np.broadcast_to(np.asarray(value, np.float32), grid.shape).copy()

    tests = []
    for probit in (level, planes):
        p = ndtr(raster(probit))
        tests.append(StochasticSafety(grid, p, p, p * p, seen))
    tangent = raster(slope) * np.tan(LANDER.slope_limit)
    nominal = SafetyMap(
        grid, np.arctan(tangent), raster(rough) * LANDER.roughness_limit, seen, seen
    )
    return MapEvidence(
        *tests, nominal, LANDER, curve or rocky(), holes or rocky(0.01),
        raster(density).astype(float), noise, 1.0 / np.sqrt(np.mean(density)),
    )  # fmt: skip
