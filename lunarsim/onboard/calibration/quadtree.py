"""Calibrated safety of quadtree sites: their evidence, features and bounds.

The limits of the paper decide which sites are eligible; they are not a probability. The probability
uses two kinds of features. The lander is placed on the mean terrain under its legs at every
heading. The points of its footprint and of the zone add their distances from the planes, their
spread and the rocks that may stand undetected between them. Rocks are counted by
`ExceedanceCurve.missed_rocks`, at least three times the count of the Gaussian DEM.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.conservative_probability import LOG_ODDS_MARGIN
from lunarsim.onboard.calibration.evidence import (
    MAX_P_UNCOUNTED_ROCKS,
    RELATIVE_DEPTHS,
    CalibrationEvidence,
    ExpectedHazardLimits,
    MapRegression,
)
from lunarsim.safety.rock_effects import min_tilt_limit_rock_height, pad_ring_area, tilt_tangent
from lunarsim.safety.unseen_rocks import ExceedanceCurve
from lunarsim.typing import Array, BoolArray

# Upper bounds of the probability in `observed_terrain_bound`: value over the limit, and factor.
_SLOPE_CEILING = np.array(
    [[0.93, 0.96, 1.0, 1.05, 1.15, 1.3, 1.6], [1.0, 0.75, 0.6, 0.4, 0.2, 0.1, 0.0]]
)
_PLANE_SLOPE_CEILING = np.array([[0.91, 0.95, 1.0, 1.05, 1.15], [1.0, 0.4, 0.2, 0.1, 0.0]])
_ROUGHNESS_CEILING = np.array([[0.9, 1.0, 1.3, 1.6, 2.2, 3.0], [1.0, 0.9, 0.6, 0.35, 0.15, 0.0]])
_RELIEF_CEILING = np.array([[0.9, 1.0, 1.3, 2.2, 4.0], [1.0, 0.94, 0.85, 0.7, 0.4]])
# Maximum share of terrain deeper than the first of `RELATIVE_DEPTHS`: whether a pad bridges a hole
# depends on widths, which the share does not contain.
MAX_DEEP_SHARE = 0.016
# Maximum probability: means over cells of a decimetre do not support more.
MAX_PROBABILITY = 0.99
# Maximum noise of the points in the fitted worlds, relative to the roughness limit: more noise
# would explain more of the residual heights.
MAX_NOISE_RATIO = 0.12
# Factor on the minimum counted height in `SiteEvidence.p_no_rock_under_pads`.
_COUNTED_HEIGHT_FACTOR = 1.5
# Knots of the regression: values relative to the limits, and log10 of ratios and of rock numbers.
_SLOPE_KNOTS = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 0.95, 1.05, 1.15, 1.3, 1.6, 2.2])
_HEIGHT_KNOTS = np.array(
    [0.0, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.3, 1.6, 2.2, 4.0]
)
_SPREAD_KNOTS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.5])
_RATIO_KNOTS = np.array([-4.0, -3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.0])
_TILT_KNOTS = np.array([-1.7, -1.4, -1.2, -1.0, -0.8, -0.6, -0.45, -0.3, -0.15, 0.0, 0.2, 0.5, 1.0])
QUADTREE = MapRegression(
    "quadtree.json",
    knots=(
        _SLOPE_KNOTS,
        *[_HEIGHT_KNOTS] * 3,
        *[_TILT_KNOTS] * 2,
        *[_SLOPE_KNOTS] * 2,
        *[_SPREAD_KNOTS] * 2,
        *[_RATIO_KNOTS] * 2,
        *[_HEIGHT_KNOTS] * 2,
    ),
    count_knots=np.array([-5.0, -4.0, -3.0, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0]),
    limits=ExpectedHazardLimits(hazards=0.1, tilting=0.1, holes=0.03),
    near_limits=ExpectedHazardLimits(hazards=1.0, tilting=2.0, holes=1.0),
    outside_margin=LOG_ODDS_MARGIN,
    # The zone is 1.35 times as wide as the lander and counts all hazards in it, so only very low
    # probabilities are unsafe for the lander itself.
    max_unsafe_p=0.01,
)


@dataclass(frozen=True)
class SiteEvidence(CalibrationEvidence):
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

    regression = QUADTREE

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
    def observed(self) -> BoolArray:
        """Mask of the sites whose complete landing zone and footprint were observed (n,)."""
        needed = (
            self.slope, self.roughness, self.mesh_slope, self.fitted_slope, self.mesh_spread,
            self.fitted_spread, self.ratio, self.footprint_ratio, self.relief,
            self.footprint_relief, self.density, self.min_density,
        )  # fmt: skip
        return np.asarray(np.logical_and.reduce([np.isfinite(a) for a in needed]))

    @property
    def terrain_slope(self) -> Array:
        """Slope of the zone's least-squares plane over the slope limit (n,), tangents.

        Same as `fitted_slope`.
        """
        return self.fitted_slope

    @property
    def terrain_roughness(self) -> Array:
        """Height of the highest point of the footprint over the roughness limit (n,).

        It is the distance from the terrain plane minus three standard deviations of noise, not
        below 0.
        """
        return self.denoised_relief()[0]

    @property
    def sample_density(self) -> Array:
        """Minimum density of points in the footprint (n,), 1/m^2; same as `min_density`."""
        return self.min_density

    @property
    def spacing_ratio(self) -> Array:
        """Distance between neighbouring points over the radius of the legs (n,)."""
        return np.asarray(1.0 / (np.sqrt(self.density) * self.lander.leg_radius))

    @property
    def is_covered_by_fit(self) -> bool:
        """Whether noise and deep terrain are in the range of the worlds of the fit."""
        deep = self.holes.at(RELATIVE_DEPTHS[0] * self.lander.roughness_limit)
        return bool(self.noise_ratio <= MAX_NOISE_RATIO and deep < MAX_DEEP_SHARE)

    @property
    def may_be_claimed_unsafe(self) -> BoolArray:
        """Mask of the sites that may count as almost certainly unsafe (n,).

        Same as `may_be_unsafe`: the mean terrain exceeds a limit even with its holes filled.
        """
        return self.may_be_unsafe

    def log_sampling(self, where: BoolArray) -> Array:
        """Return the logarithm of the relative point density of m sites (m,).

        It is the number of points per squared radius of the legs. `where` is the mask of the
        sites.
        """
        density = np.maximum(self.density[where], 0.1)
        return np.asarray(np.log(density * self.lander.leg_radius**2))

    def term_values(self, where: BoolArray) -> Sequence[Array]:
        """Return the values of the map's 14 terms for the m sites in `where`, each (m,).

        They are slopes, distances and fractions that indicate danger, in the order of the knots of
        `QUADTREE`.
        """
        point, spread = self.denoised_relief()
        values = (
            self.slope,
            self.roughness,
            np.maximum(self.roughness, self.footprint_relief),
            self.footprint_relief + 2.0 * spread,
            np.log10(self.relative_tilt(point)),
            np.log10(self.relative_tilt(spread)),
            self.mesh_slope,
            self.fitted_slope,
            self.mesh_spread,
            self.fitted_spread,
            np.log10(np.maximum(self.ratio, 1e-4)),
            np.log10(np.maximum(self.footprint_ratio, 1e-4)),
            self.relief,
            self.footprint_relief,
        )
        return [v[where] for v in values]

    def count_rocks(self, curve: ExceedanceCurve, height: Array, area: float) -> Array:
        """Return an upper estimate of undetected rocks above a height at each site (n,).

        It is `ExceedanceCurve.missed_rocks` of `curve` at `height` (m) and the minimum point
        density in the footprint, times `area`, m^2.
        """
        return np.asarray(area * curve.missed_rocks(height, self.min_density))

    def denoised_relief(self) -> tuple[Array, Array]:
        """Return highest point and spread of points without noise, relative to the limit.

        Both are (n,), over the roughness limit. The first is the maximum distance of a point of
        the footprint from its plane minus three standard deviations of noise; the second is the
        spread of the zone's points about the fitted plane, from whose variance the noise variance
        is subtracted.
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
        tilt = tilt_tangent(height * self.lander.roughness_limit, self.lander)
        return np.asarray((tilt + 2e-4) / left)

    def observed_terrain_bound(self) -> Array:
        """Return an upper limit of the probability of safety from single inputs (n,).

        In a weighted sum, many favourable inputs can outweigh one that is fatal. For slopes or
        roughness near or beyond the limit of the lander, the upper limits are the fraction of safe
        sites in the simulated terrain used for the fit, at most `MAX_PROBABILITY`. For sites that
        were not evaluated, the limit is 0.
        """
        factors = (
            np.interp(self.slope, *_SLOPE_CEILING),
            np.interp(np.maximum(self.mesh_slope, self.fitted_slope), *_PLANE_SLOPE_CEILING),
            np.interp(np.maximum(self.roughness, self.mesh_spread), *_ROUGHNESS_CEILING),
            np.interp(self.footprint_relief, *_RELIEF_CEILING),
        )
        return np.asarray(MAX_PROBABILITY * np.nan_to_num(np.minimum.reduce(factors), nan=0.0))

    def p_no_rock_under_pads(self) -> Array:
        """Return the probability that no undetected gravel tilts the lander too far (n,).

        Gravel is counted conservatively, as for the Gaussian DEM. The result is `MAX_PROBABILITY`
        where only rocks higher than `_COUNTED_HEIGHT_FACTOR` times the minimum counted height could
        tilt the lander.
        """
        height = min_tilt_limit_rock_height(self.fitted_slope, self.lander)
        rocks = self.count_rocks(self.curve.with_gravel, height, pad_ring_area(self.lander))
        low = height < self.curve.min_counted_gravel_height
        clear = np.where(low, MAX_P_UNCOUNTED_ROCKS, 1.0) * np.exp(-rocks)
        matters = height < _COUNTED_HEIGHT_FACTOR * self.curve.min_counted_height
        return np.asarray(MAX_PROBABILITY * np.nan_to_num(np.where(matters, clear, 1.0), nan=0.0))

    def far_bound(self) -> Array:
        """Return the probability that no undetected rock violates a limit (n,).

        Rocks above the roughness margin and rocks that tilt the lander too far count; 0 where a
        site was not evaluated. It bounds the safety probability far from the domain of the fits.
        """
        rocks = -self.expected_roughness_violations - self.expected_tilt_violations
        return np.nan_to_num(np.exp(rocks), nan=0.0)
