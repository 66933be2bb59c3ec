"""Calibrated probability of safe terrain at sites of the quadtree.

The limits of the paper decide which sites are eligible; they are not a probability. The probability
uses two kinds of features. The lander is placed on the mean terrain under its legs at every
heading. The points of its footprint and of the zone add their distances from the planes, their
spread and the rocks that may stand undetected between them. All features are dimensionless: slopes
and heights are relative to the limits of the lander. All weights except the first
`UNCONSTRAINED_FEATURES` are non-negative, so that the probability never increases with slope,
roughness, exceptions, their height, or the number of undetected rocks. It is a calibrated frequency
where the leave-one-world-out fits agree and few rocks may be undetected, as on the Gaussian DEM
(`lunarsim.onboard.calibration.gaussian_dem`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.ensemble import Ensemble, conservative_probability
from lunarsim.onboard.calibration.gaussian_dem import MAX_P_UNCOUNTED_ROCKS, SLOPE_LIMIT_RANGE_RAD
from lunarsim.onboard.calibration.monotone_splines import MonotoneSplineTerm, spline_features
from lunarsim.safety.rock_effects import (
    footprint_area,
    min_tilt_limit_rock_height,
    pad_ring_area,
    tilt_limit_rock_height,
    tilt_of,
)
from lunarsim.safety.unseen_rocks import ExceedanceCurve
from lunarsim.typing import Array, BoolArray

# Upper bounds of the probability, see `ceiling`: value relative to the limit, and factor.
_SLOPE_CEILING = np.array(
    [[0.93, 0.96, 1.0, 1.05, 1.15, 1.3, 1.6], [1.0, 0.75, 0.6, 0.4, 0.2, 0.1, 0.0]]
)
_PLANE_SLOPE_CEILING = np.array([[0.91, 0.95, 1.0, 1.05, 1.15], [1.0, 0.4, 0.2, 0.1, 0.0]])
_ROUGHNESS_CEILING = np.array([[0.9, 1.0, 1.3, 1.6, 2.2, 3.0], [1.0, 0.9, 0.6, 0.35, 0.15, 0.0]])
_RELIEF_CEILING = np.array([[0.9, 1.0, 1.3, 2.2, 4.0], [1.0, 0.94, 0.85, 0.7, 0.4]])
# Limits of the domain: expected undetected hazards in a footprint, and expected undetected rocks
# and holes under the pads that tilt the lander over its limit. Rocks are counted by
# `ExceedanceCurve.missed`, at least three times the count of the Gaussian DEM.
MAX_EXPECTED_HAZARDS = 0.1
MAX_EXPECTED_TILTING_ROCKS = 0.1
MAX_EXPECTED_HOLES = 0.03
# Limits near the domain, for the same numbers: there the fits to all other worlds were low enough,
# see `bound`.
_NEAR_DOMAIN_LIMITS = (1.0, 2.0, 1.0)
# Maximum share of terrain deeper than the first of `_RELATIVE_DEPTHS`: whether a pad bridges a hole
# depends on widths, which the share does not contain.
MAX_DEEP_SHARE = 0.016
# Threshold for claiming a site unsafe. The zone is 1.35 times as wide as the lander and counts all
# hazards in it, so only very low probabilities are unsafe for the lander itself.
MAX_CLAIMED_UNSAFE = 0.01
# Maximum probability: means over cells of a decimetre do not support more.
MAX_PROBABILITY = 0.99
# Maximum noise of the points in the fitted worlds, relative to the roughness limit: more noise
# would explain more of the residual heights.
MAX_NOISE_RATIO = 0.12
# Factor on the minimum counted height in `SiteEvidence.clear_of_pads`.
_COUNTED_HEIGHT_FACTOR = 1.5
# Knots of the regression: values relative to the limits, and log10 of ratios and of rock numbers.
_SLOPE_KNOTS = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 0.95, 1.05, 1.15, 1.3, 1.6, 2.2])
_HEIGHT_KNOTS = np.array(
    [0.0, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.3, 1.6, 2.2, 4.0]
)
_SPREAD_KNOTS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.5])
_RATIO_KNOTS = np.array([-4.0, -3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.0])
_TILT_KNOTS = np.array([-1.7, -1.4, -1.2, -1.0, -0.8, -0.6, -0.45, -0.3, -0.15, 0.0, 0.2, 0.5, 1.0])
_ROCK_KNOTS = np.array([-5.0, -4.0, -3.0, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
_SHARE_KNOTS = np.log10([1e-5, 1e-4, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.016, 0.03, 0.06, 0.12])
_KNOTS = (
    _SLOPE_KNOTS,
    _HEIGHT_KNOTS,
    _HEIGHT_KNOTS,
    _HEIGHT_KNOTS,
    _TILT_KNOTS,
    _TILT_KNOTS,
    _SLOPE_KNOTS,
    _SLOPE_KNOTS,
    _SPREAD_KNOTS,
    _SPREAD_KNOTS,
    _RATIO_KNOTS,
    _RATIO_KNOTS,
    _HEIGHT_KNOTS,
    _HEIGHT_KNOTS,
    _ROCK_KNOTS,
    _ROCK_KNOTS,
    _ROCK_KNOTS,
)
# Heights and depths, relative to the limit, at which the share of terrain is a feature.
_RELATIVE_HEIGHTS = np.array([0.3, 0.6, 1.0, 1.6])
_RELATIVE_DEPTHS = np.array([0.6, 1.0])
# Intercept, noise, density and its square: their weights may have either sign.
UNCONSTRAINED_FEATURES = 4
MONOTONE_FEATURES = sum(len(knots) - 1 for knots in _KNOTS) + (
    len(_RELATIVE_HEIGHTS) + len(_RELATIVE_DEPTHS)
) * (len(_SHARE_KNOTS) - 1)
COUNT = UNCONSTRAINED_FEATURES + MONOTONE_FEATURES


@dataclass(frozen=True)
class SiteEvidence:
    """Inputs of the regression for the safety of quadtree sites (n,).

    All are NaN where not evaluated. An exception is a point that is too far from the terrain plane.

    Attributes
    ----------
    slope, roughness
        Slope (tangent) and roughness under the lander on the mean terrain, at the worst heading,
        relative to its limits.
    mesh_slope, fitted_slope
        Slopes (tangent) of the terrain mesh and of the least-squares plane of the zone, relative to
        the limit.
    mesh_spread, fitted_spread
        Root mean square distance of the points of the zone from these two planes, relative to the
        roughness limit.
    ratio, footprint_ratio
        Maximum fraction of exceptions in the landing zone and in the footprint of the lander.
    relief, footprint_relief
        Maximum distance of a point from its plane in the zone and in the footprint, relative to the
        roughness limit.
    density, min_density
        Points per square metre in the zone, and their minimum density in the footprint.
    curve
        Distribution of heights above the terrain, from the points and the size distribution of
        rocks expected by the mission.
    holes
        Distribution of depths below the terrain.
    may_be_unsafe
        True where the mean terrain exceeds a limit even with its holes filled. Holes are filled,
        because a leg may stand beside or over them.
    lander
        Geometry and limits.
    noise
        Standard deviation of the height of a point, m.
    """

    slope: Array
    roughness: Array
    mesh_slope: Array
    fitted_slope: Array
    mesh_spread: Array
    fitted_spread: Array
    ratio: Array
    footprint_ratio: Array
    relief: Array
    footprint_relief: Array
    density: Array
    min_density: Array
    curve: ExceedanceCurve
    holes: ExceedanceCurve
    may_be_unsafe: BoolArray
    lander: Lander
    noise: float

    @property
    def is_evaluated(self) -> BoolArray:
        """Whether the complete landing zone and footprint were observed (n,)."""
        needed = (
            self.slope,
            self.roughness,
            self.mesh_slope,
            self.fitted_slope,
            self.mesh_spread,
            self.fitted_spread,
            self.ratio,
            self.footprint_ratio,
            self.relief,
            self.footprint_relief,
            self.density,
            self.min_density,
        )
        return np.asarray(np.logical_and.reduce([np.isfinite(a) for a in needed]))

    @property
    def in_domain(self) -> BoolArray:
        """Whether the regression is calibrated for each site (n,).

        It is calibrated where few rocks and holes can be undetected, and where noise, holes in the
        terrain and the slope limit of the lander are within the range of the fitted data.
        """
        return self._is_within_limits(
            MAX_EXPECTED_HAZARDS, MAX_EXPECTED_TILTING_ROCKS, MAX_EXPECTED_HOLES
        )

    @property
    def near_domain(self) -> BoolArray:
        """Whether the regression is calibrated or conservative for each site (n,).

        More undetected rocks and holes are permitted than for `in_domain`.
        """
        return self._is_within_limits(*_NEAR_DOMAIN_LIMITS)

    def _is_within_limits(
        self, max_hazards: float, max_tilt_violations: float, max_hole_violations: float
    ) -> BoolArray:
        """Return which sites have few undetected rocks and holes, within limits (n,).

        `max_hazards` limits the expected number of undetected rocks above the roughness limit;
        `max_tilt_violations` and `max_hole_violations` limit those of rocks and holes that tilt the
        lander too far. Noise, deep terrain and the slope limit must also be within the range of the
        fitted data.
        """
        noise = self.noise / self.lander.roughness_limit
        sunk = self.holes.at(_RELATIVE_DEPTHS[0] * self.lander.roughness_limit)
        steep = self.lander.slope_limit
        if not (
            noise <= MAX_NOISE_RATIO
            and sunk < MAX_DEEP_SHARE
            and SLOPE_LIMIT_RANGE_RAD[0] <= steep <= SLOPE_LIMIT_RANGE_RAD[1]
        ):
            return np.zeros(len(self.slope), np.bool_)
        with np.errstate(invalid="ignore"):
            few = (self.hazards() <= max_hazards) & (
                self.expected_tilt_violations() <= max_tilt_violations
            )
            few &= self.expected_hole_violations() <= max_hole_violations
        return np.asarray(self.is_evaluated & few)

    def max_roughness(self) -> Array:
        """Return the larger of roughness and highest point, relative to the limit (n,)."""
        return np.maximum(self.roughness, self.footprint_relief)

    def denoised_relief(self) -> tuple[Array, Array]:
        """Return highest point and spread of points without noise, relative to the limit.

        Both (n,). Three standard deviations of noise are subtracted from the highest point, and the
        noise variance from that of the spread.
        """
        noise = self.noise / self.lander.roughness_limit
        spread = np.sqrt(np.maximum(self.fitted_spread**2 - noise**2, 0.0))
        return np.maximum(self.footprint_relief - 3.0 * noise, 0.0), spread

    def relative_tilt(self, height: Array) -> Array:
        """Return the tilt due to a raised pad, relative to the slope margin (n,).

        The margin is the slope limit minus the terrain slope. Both are tangents.

        Parameters
        ----------
        height
            Height of the object under the pad (n,), relative to the roughness limit.
        """
        left = np.maximum(1.0 - self.slope, 0.02) * np.tan(self.lander.slope_limit)
        tilt = tilt_of(height * self.lander.roughness_limit, self.lander)
        return np.asarray((tilt + 2e-4) / left)

    def expected_tilt_violations(self) -> Array:
        """Return the expected number of undetected rocks that tilt the lander too far.

        The result (n,) counts rocks where the pads may stand at any heading.
        """
        height = tilt_limit_rock_height(self.fitted_slope, self.lander)
        return np.asarray(
            pad_ring_area(self.lander) * self.curve.missed_rocks(height, self.min_density)
        )

    def clear_of_pads(self) -> Array:
        """Return the probability that no undetected gravel tilts the lander too far (n,).

        Gravel is counted conservatively, as for the Gaussian DEM
        (`gaussian_dem.p_no_rock_under_pads`). The result is 1 where only rocks
        higher than `_COUNTED_HEIGHT_FACTOR` times the minimum counted height could tilt the lander.
        """
        height = min_tilt_limit_rock_height(self.fitted_slope, self.lander)
        found = pad_ring_area(self.lander) * self.curve.with_gravel.missed_rocks(
            height, self.min_density
        )
        left = np.where(height < self.curve.min_counted_gravel_height, MAX_P_UNCOUNTED_ROCKS, 1.0)
        return np.where(
            height < _COUNTED_HEIGHT_FACTOR * self.curve.min_counted_height,
            left * np.exp(-found),
            1.0,
        )

    def expected_hole_violations(self) -> Array:
        """Return the expected number of undetected holes that tilt the lander too far.

        The result (n,) counts holes where the pads may stand at any heading.
        """
        height, width = (
            tilt_limit_rock_height(self.fitted_slope, self.lander),
            self.lander.pad_diameter,
        )
        found = self.holes.missed_holes(height, self.min_density, width)
        return np.asarray(pad_ring_area(self.lander) * found)

    def expected_roughness_violations(self) -> Array:
        """Return the expected number of undetected rocks above the roughness margin (n,).

        The margin is the roughness limit minus the height of the highest point. The rocks are
        counted in the footprint of the lander.
        """
        height = (1.0 - self.denoised_relief()[0]) * self.lander.roughness_limit
        return np.asarray(
            footprint_area(self.lander) * self.curve.missed_rocks(height, self.min_density)
        )

    def hazards(self) -> Array:
        """Return the expected number of undetected rocks above the roughness limit (n,).

        The rocks are counted in the footprint of the lander.
        """
        limit = self.lander.roughness_limit
        return np.asarray(
            footprint_area(self.lander) * self.curve.missed_rocks(limit, self.min_density)
        )


def features(evidence: SiteEvidence, mask: BoolArray) -> Array:
    """Return the regression inputs (m, `COUNT`) of the sites that `mask` (n,) selects."""
    n = int(np.count_nonzero(mask))
    return np.column_stack(
        (
            _unconstrained_inputs(evidence, mask),
            spline_features(_monotone_inputs(evidence, mask), n),
        )
    )


def _monotone_inputs(evidence: SiteEvidence, mask: BoolArray) -> list[MonotoneSplineTerm]:
    """Return the regression inputs that indicate danger, for sites selected by a mask.

    Their weights are non-negative, so the probability of safety never increases with them. `mask`
    (n,) selects the sites.
    """
    point, spread = evidence.denoised_relief()
    values = (
        evidence.slope,
        evidence.roughness,
        evidence.max_roughness(),
        evidence.footprint_relief + 2.0 * spread,
        np.log10(evidence.relative_tilt(point)),
        np.log10(evidence.relative_tilt(spread)),
        evidence.mesh_slope,
        evidence.fitted_slope,
        evidence.mesh_spread,
        evidence.fitted_spread,
        np.log10(np.maximum(evidence.ratio, 1e-4)),
        np.log10(np.maximum(evidence.footprint_ratio, 1e-4)),
        evidence.relief,
        evidence.footprint_relief,
        np.log10(evidence.expected_tilt_violations() + 1e-6),
        np.log10(evidence.expected_roughness_violations() + 1e-6),
        np.log10(evidence.expected_hole_violations() + 1e-6),
    )
    shares = np.log10(evidence.curve.at(_RELATIVE_HEIGHTS * evidence.lander.roughness_limit))
    own = [MonotoneSplineTerm(v[mask], knots) for v, knots in zip(values, _KNOTS, strict=True)]
    depths = np.log10(evidence.holes.at(_RELATIVE_DEPTHS * evidence.lander.roughness_limit))
    return own + [MonotoneSplineTerm(share, _SHARE_KNOTS) for share in (*shares, *depths)]


def _unconstrained_inputs(evidence: SiteEvidence, mask: BoolArray) -> Array:
    """Return the regression inputs whose weights may have either sign.

    `mask` (n,) selects the sites. The result (m, `UNCONSTRAINED_FEATURES`) holds a constant, the
    noise, and the point density with its square.
    """
    density = np.log(np.maximum(evidence.density[mask], 0.1) * evidence.lander.leg_radius**2)
    noise = np.full(len(density), np.log(evidence.noise / evidence.lander.roughness_limit + 1e-3))
    return np.column_stack([np.ones(len(density)), noise, density, density**2])


@lru_cache(maxsize=1)
def packaged_ensemble() -> Ensemble:
    """Load the regression weights that are supplied with lunarsim.

    They were fitted by `scenarios/lidar_maps/quadtree_calibration.py`.
    """
    return Ensemble.packaged("quadtree.json", COUNT, MONOTONE_FEATURES)


def site_safety(evidence: SiteEvidence, model: Ensemble | None = None) -> tuple[Array, BoolArray]:
    """Return the probability that quadtree sites are safe, and where it is calibrated.

    Both (n,). Where the regression is not calibrated, or where it is below the threshold for
    claimed safety, the probability is at most `bound`. It is 0 where the site was not evaluated.

    Parameters
    ----------
    evidence
        Inputs of the regression, from `quadtree_site_evidence`.
    model
        Regression weights; default: the weights supplied with lunarsim.
    """
    e, in_domain = evidence, evidence.in_domain
    p, is_calibrated = np.zeros(len(e.slope)), in_domain.copy()
    if e.is_evaluated.any():
        evaluated, upper = e.is_evaluated, ceiling(e)[e.is_evaluated]
        odds = (model or packaged_ensemble()).evaluate_log_odds(
            _unconstrained_inputs(e, evaluated), _monotone_inputs(e, evaluated)
        )
        p[evaluated] = conservative_probability(
            odds.low, upper, bound(e)[evaluated], in_domain[evaluated]
        )
        is_calibrated[evaluated] &= odds.estimate(
            upper, MAX_CLAIMED_UNSAFE, e.may_be_unsafe[evaluated]
        ).agreed
    return p, is_calibrated


def ceiling(evidence: SiteEvidence) -> Array:
    """Return an upper limit of the probability of safety from single inputs (n,).

    In a weighted sum, many favourable inputs can outweigh one that is fatal. For slopes or
    roughness near or beyond the limit of the lander, the upper limits are the fraction of safe
    sites in the simulated terrain used for the fit, at most `MAX_PROBABILITY`.
    """
    e = evidence
    factors = (
        np.interp(e.slope, *_SLOPE_CEILING),
        np.interp(np.maximum(e.mesh_slope, e.fitted_slope), *_PLANE_SLOPE_CEILING),
        np.interp(np.maximum(e.roughness, e.mesh_spread), *_ROUGHNESS_CEILING),
        np.interp(e.footprint_relief, *_RELIEF_CEILING),
        e.clear_of_pads(),
    )
    return np.asarray(MAX_PROBABILITY * np.nan_to_num(np.minimum.reduce(factors), nan=0.0))


def bound(evidence: SiteEvidence) -> Array:
    """Return an upper limit of the probability outside the calibrated domain (n,).

    The limit is the probability of no undetected rock. Near the domain, where the regression is
    still informative, it is 1.
    """
    none = np.nan_to_num(
        np.exp(-evidence.expected_roughness_violations() - evidence.expected_tilt_violations()),
        nan=0.0,
    )
    return np.asarray(np.where(evidence.near_domain, 1.0, none))
