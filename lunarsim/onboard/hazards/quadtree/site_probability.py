"""From what a site looks like on the quadtree to how often such sites are safe.

All is dimensionless: slopes and heights count by the lander's limits. Weights on all but the
intercept and the number of points are not negative, so that the probability never rises with slope,
roughness, exceptions, their height, or the rocks that may stand unseen. Where too many of these
are to be expected it is a bound and no frequency. It is one on worlds like those of the fit only:
kept out of it, rock laws, slopes near the limit and other landers are misjudged by up to 0.2, so
that the map does not claim a domain.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.quadtree.settings import SiteSettings
from lunarsim.onboard.hazards.quadtree.sites import Selection
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety.calibration import MOST_HAZARDS
from lunarsim.safety.logistic import Logistic
from lunarsim.safety.unseen_rocks import HeightCurve, law_share

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Between these the regression may bend: shares of the limits, decades of ratios and of rocks.
_SLOPES = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 1.0, 1.15, 1.5, 2.5])
_ROUGH = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.5])
_RATIOS = np.array([-4.0, -3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.0])
_RELIEF = np.array([0.0, 0.5, 0.8, 1.0, 1.25, 1.6, 2.2, 4.0])
_ROCKS = np.array([-5.0, -4.0, -3.0, -2.0, -1.5, -1.0, 0.0, 1.0])
FREE = 2
RISING = sum(
    len(knots) - 1 for knots in (_SLOPES, _SLOPES, _ROUGH, _RATIOS, _RATIOS, _RELIEF, _ROCKS)
)
COUNT = FREE + RISING
# The mission's rock law counts as much as this many points.
_PRIOR_POINTS = 60.0


@dataclass(frozen=True)
class SiteEvidence:
    """What the quadtree says of sites (n,); all but `unseen` and `density` NaN where not judged.

    Attributes
    ----------
    slope, fitted
        Of the mesh and of the zone's points, tangents over that of the lander's limit.
    roughness, relief
        Root mean square distance from the plane, and the highest exception, over its limit.
    ratio, near
        Greatest exception ratio in the zone and in its middle.
    unseen
        Rocks over the limit that stand in the lander's footprint without a point on them.
    density
        Points on a square metre.
    """

    slope: Array
    fitted: Array
    roughness: Array
    relief: Array
    ratio: Array
    near: Array
    unseen: Array
    density: Array

    @classmethod
    def of(
        cls,
        selection: Selection,
        settings: SiteSettings,
        lander: Lander,
        rocks: RockExpectation,
    ) -> SiteEvidence:
        """Return what a selection says, for a lander on ground with such rocks expected."""
        s = selection
        steepest = np.tan(lander.slope_limit)
        density = np.nan_to_num(s.points, nan=0.0) / (2.0 * settings.zone) ** 2
        curve = _curve(s, settings, lander, rocks)
        unseen = curve.unseen(lander.roughness_limit, density) * np.pi * lander.leg_radius**2
        return cls(
            np.tan(s.slope) / steepest,
            np.tan(s.fitted) / steepest,
            s.roughness / lander.roughness_limit,
            s.relief / lander.roughness_limit,
            s.ratio,
            s.near,
            unseen,
            density,
        )

    @property
    def judged(self) -> BoolArray:
        """Where the whole zone was seen (n,)."""
        judged = np.isfinite(self.slope) & np.isfinite(self.roughness) & np.isfinite(self.ratio)
        return np.asarray(judged & np.isfinite(self.near))

    @property
    def in_domain(self) -> BoolArray:
        """Where few enough hazards stand unseen for the regression to be asked (n,)."""
        return np.asarray(self.judged & (self.unseen <= MOST_HAZARDS))


def _curve(
    selection: Selection, settings: SiteSettings, lander: Lander, rocks: RockExpectation
) -> HeightCurve:
    """Return how high the ground stands: the law's shape, as much of it as points are exceptions.

    An exception lies farther than the settings' roughness limit from its plane.
    """
    height = lander.roughness_limit * np.geomspace(0.08, 8.0, 40)
    law = law_share(height, rocks.cover, rocks.height_ratio[0])
    at = law_share([settings.roughness_limit], rocks.cover, rocks.height_ratio[0])[0]
    near = selection.near[np.isfinite(selection.near)]
    points = float(np.nansum(selection.points))
    share = float(near.mean()) if near.size else 0.0
    found = (share * points + _PRIOR_POINTS * at) / (points + _PRIOR_POINTS)
    return HeightCurve(height, np.minimum(law * found / at, 0.5))


def _left(values: Array, knots: Array) -> Array:
    """Return how much of each interval between knots values (n,) leave (n, k)."""
    return np.column_stack(
        [np.clip((high - values) / (high - low), 0.0, 1.0) for low, high in pairwise(knots)]
    )


def features(evidence: SiteEvidence, where: BoolArray) -> Array:
    """Return what the probability is computed from, at sites chosen by a mask (m, `COUNT`)."""
    e = evidence
    # Without a plane of its own points the mesh's slope stands for it; without an exception 0.
    fitted = np.where(np.isfinite(e.fitted), e.fitted, e.slope)[where]
    relief = np.nan_to_num(e.relief, nan=0.0)[where]
    columns = [
        _left(e.slope[where], _SLOPES),
        _left(fitted, _SLOPES),
        _left(e.roughness[where], _ROUGH),
        _left(np.log10(np.maximum(e.ratio[where], 1e-4)), _RATIOS),
        _left(np.log10(np.maximum(e.near[where], 1e-4)), _RATIOS),
        _left(relief, _RELIEF),
        _left(np.log10(e.unseen[where] + 1e-6), _ROCKS),
    ]
    density = np.log(np.maximum(e.density[where], 0.1))
    return np.column_stack([np.ones(len(density)), density, *columns])


@lru_cache(maxsize=1)
def measured() -> Logistic:
    """Return the weights measured by `scenarios/lidar_maps/quadtree_calibration.py`."""
    return Logistic.packaged("lunarsim.onboard.hazards.quadtree", "calibration.json", COUNT)


def site_safety(evidence: SiteEvidence, model: Logistic | None = None) -> Array:
    """Return the probability that sites are safe (n,); 0 where not judged.

    Outside the domain no more than `bound`.

    Parameters
    ----------
    evidence
        Of the sites.
    model
        Left out: the packaged one.
    """
    e = evidence
    p = np.zeros(len(e.slope))
    if e.judged.any():
        weights = np.array((model or measured()).weights)
        p[e.judged] = expit(features(e, e.judged) @ weights)
    p = np.minimum(p, ceiling(e))
    return np.where(e.in_domain, p, np.minimum(p, bound(e)))


def ceiling(evidence: SiteEvidence) -> Array:
    """Return what the probability cannot exceed, by what was seen (n,).

    Sums of evidence let much that is good make up for one thing that is fatal: from a slope at the
    limit on, none is left 15 % above it, and from roughness at the limit on, none at twice.
    """
    e = evidence
    steep = np.maximum(e.slope, np.nan_to_num(e.fitted, nan=0.0))
    left = np.minimum(1.0, np.minimum((1.15 - steep) / 0.15, 2.0 - e.roughness))
    return np.asarray(np.maximum(np.nan_to_num(left, nan=0.0), 0.0), dtype=np.float64)


def bound(evidence: SiteEvidence) -> Array:
    """Return a bound where no fit to other worlds tells how often sites are safe (n,).

    As many unseen rocks as the domain allows are taken for two in three.
    """
    return np.asarray(np.exp(-evidence.unseen / MOST_HAZARDS))
