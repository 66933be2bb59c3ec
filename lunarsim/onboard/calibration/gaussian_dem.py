"""Calibrated safety of the Gaussian DEM: its evidence, features and bounds.

Eqs. 15 to 17 of the Gaussian DEM paper bound the probability by the worst cells of a footprint;
the test by support planes uses the mean and ignores unobserved terrain. A logistic regression on
both, and on the expected unobserved rocks, converts them to a frequency.

Near the domain of the fits the odds that a site is unsafe are multiplied by twelve. Farther away
the result is the minimum of that, of Eqs. 15 to 17 and of the probability that no unobserved rock
is present. With a weight of one in a thousand the fits are used alone, so that sites of very low
probability can still be ranked. A scenario's own calibration (`scenario_calibration`) has its own
last stage and its own domain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.special import ndtri

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.conservative_probability import ALMOST_CERTAINLY_UNSAFE_P
from lunarsim.onboard.calibration.evidence import (
    MAX_P_UNCOUNTED_ROCKS,
    CalibrationEvidence,
    ExpectedHazardLimits,
    MapRegression,
)
from lunarsim.safety.beam_averaging import peak_ratio
from lunarsim.safety.conservative import StochasticSafety
from lunarsim.safety.exact import SafetyMap
from lunarsim.safety.rock_effects import footprint_area, pad_ring_area
from lunarsim.safety.undetected_rock_ratio import UndetectedRockRatio
from lunarsim.safety.unseen_rocks import ExceedanceCurve
from lunarsim.typing import Array, BoolArray

# Knots of the regression: probits and ratios to the limits.
_PROBITS = np.array([-6.0, -4.0, -2.5, -1.5, -0.7, 0.0, 0.7, 1.5, 2.5, 4.0])
_RATIOS = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 0.95, 1.0, 1.05, 1.15, 1.3, 1.6, 2.2, 3.0])
# Weight of the case that the estimates of unobserved rocks are wrong. Where samples are sparse,
# these estimates leave no site any probability, but the best sites must still be distinguishable.
UNKNOWN_MODEL_WEIGHT = 1e-3
GAUSSIAN_DEM = MapRegression(
    "gaussian_dem.json",
    knots=(*[_PROBITS] * 4, *[_RATIOS] * 2),
    count_knots=np.array([-4.0, -3.0, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]),
    limits=ExpectedHazardLimits(hazards=0.003, tilting=0.5, holes=0.003),
    near_limits=ExpectedHazardLimits(hazards=0.1, tilting=2.0, holes=0.1),
    # Fits to all other worlds were conservative enough near the domain once the odds that a site is
    # unsafe were multiplied by 12.
    outside_margin=float(np.log(12.0)),
    max_unsafe_p=ALMOST_CERTAINLY_UNSAFE_P,
    rising_terms=4,
    unknown_model_weight=UNKNOWN_MODEL_WEIGHT,
    dtype=np.float32,
)
# Scans of the fit: noise over the roughness limit, and spacing over the legs' radius.
NOISE_RATIO_RANGE = (0.0, 0.5)
SPACING_RATIO_RANGE = (0.01, 1.0)
# Parameters of the bounds.
_MAX_P_FACTOR = 4.0
_SLOPE_CEILING = np.array([[0.94, 0.96], [1.0, 0.85]])
_PAD_ROCK_FACTOR = 2.0
# Exponent of the fraction of samples that show a rock; `scenarios/lidar_maps/beam_width.py` chose
# it: with 2, maps from 200 m with a beam of 1.5 mrad claim more than with a narrower beam.
_RESOLVED_POWER = 3.0


@dataclass(frozen=True)
class MapEvidence(CalibrationEvidence):
    """Hazard map data from which `calibrated_safety` estimates site safety.

    Attributes
    ----------
    horizontal_plane, support_planes
        Safety probabilities by a horizontal plane (`stochastic_safety`), and by the support planes
        of the legs (`plane_stochastic_safety`).
    nominal
        Result of `bounded_safety` for the mean elevations.
    lander
        Lander for which `horizontal_plane`, `support_planes` and `nominal` were computed.
    curve
        Fraction of terrain above each height, from the samples and the mission's rock distribution.
    holes
        Fraction of terrain below each depth.
    density
        Elevation samples per square metre at each cell.
    noise, spacing
        Standard deviation of an elevation sample, and distance between neighbouring samples, m.
    undetected_rock_ratio
        Ratio of unobserved rocks that remain after observation by another sensor, averaged over
        the terrain around each site. None: all of them.
    beam_sigma, height_ratio
        Standard deviation of the beam's intensity on the terrain, m (0: a line), and expected
        height of the rocks over their diameter.
    is_consistent
        Whether the scans of the map agree with each other within their stated errors.
    """

    regression = GAUSSIAN_DEM

    horizontal_plane: StochasticSafety
    support_planes: StochasticSafety
    nominal: SafetyMap
    lander: Lander
    curve: ExceedanceCurve
    holes: ExceedanceCurve
    density: Array
    noise: float
    spacing: float
    undetected_rock_ratio: UndetectedRockRatio | None = None
    beam_sigma: float = 0.0
    height_ratio: float = 0.5
    is_consistent: bool = True

    def __post_init__(self) -> None:
        if (
            self.undetected_rock_ratio is not None
            and self.undetected_rock_ratio.shape != self.horizontal_plane.grid.shape
        ):
            shape = self.undetected_rock_ratio.shape
            raise InputError(
                "calibration.undetected_rock_ratio",
                shape,
                f"must have the shape {self.horizontal_plane.grid.shape}",
            )
        for name in ("support_planes", "nominal"):
            grid = getattr(self, name).grid
            if grid != self.horizontal_plane.grid:
                raise InputError(
                    f"calibration.{name}",
                    grid,
                    "must have the same grid as `horizontal_plane`",
                    show_value=False,
                )
        if np.shape(self.density) != self.horizontal_plane.grid.shape:
            shape = np.shape(self.density)
            raise InputError(
                "calibration.density",
                shape,
                f"must have the shape {self.horizontal_plane.grid.shape}",
            )
        for name in ("noise", "spacing"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"calibration.{name}", value, "must be positive and finite")

    @property
    def observed(self) -> BoolArray:
        """Mask of the cells whose complete footprint was observed (rows, cols)."""
        return self.horizontal_plane.observed & self.support_planes.observed & self.nominal.observed

    @cached_property
    def slope(self) -> Array:
        """Tangent of the nominal slope over the tangent of the slope limit (rows, cols).

        NaN where the terrain is not observed.
        """
        slope = np.tan(self.nominal.slope.astype(np.float64))
        return np.asarray(slope / np.tan(self.lander.slope_limit))

    @cached_property
    def roughness(self) -> Array:
        """Nominal roughness over the roughness limit (rows, cols); NaN if not observed."""
        return np.asarray(self.nominal.roughness / np.float64(self.lander.roughness_limit))

    @property
    def terrain_slope(self) -> Array:
        """Nominal slope over the slope limit, as tangents (rows, cols); same as `slope`."""
        return self.slope

    @property
    def terrain_roughness(self) -> Array:
        """Nominal roughness over the roughness limit (rows, cols); same as `roughness`."""
        return self.roughness

    @property
    def sample_density(self) -> Array:
        """Elevation samples per square metre that may hit a hole (rows, cols)."""
        # A relevant hole is at least as wide as a pad.
        width = np.array(self.lander.pad_diameter)
        return np.asarray(self.density * self._resolved(self.height_ratio * width))

    @property
    def spacing_ratio(self) -> float:
        """Distance between neighbouring elevation samples over the radius of the legs."""
        return self.spacing / self.lander.leg_radius

    @property
    def is_covered_by_fit(self) -> bool:
        """Whether noise and spacing are in the range of the scans of the fit."""
        (n0, n1), (s0, s1) = NOISE_RATIO_RANGE, SPACING_RATIO_RANGE
        return n0 <= self.noise_ratio <= n1 and s0 <= self.spacing_ratio <= s1

    def log_sampling(self, where: BoolArray) -> float:
        """Return the logarithm of the sample spacing over the radius of the legs.

        It is the same for all sites; `where` is not used.
        """
        return float(np.log(self.spacing_ratio))

    def term_values(self, where: BoolArray) -> Sequence[Array]:
        """Return the values of the six terms of the map for the sites in `where` (n,).

        They are probits of slope and roughness safety, by a horizontal plane and by support
        planes, and slope and roughness relative to their limits.
        """
        tests = (
            t
            for s in (self.horizontal_plane, self.support_planes)
            for t in (s.p_slope, s.p_roughness)
        )
        probits = (ndtri(np.clip(p[where].astype(np.float64), 1e-12, 1.0 - 1e-9)) for p in tests)
        return *probits, self.slope[where], self.roughness[where]

    def count_rocks(self, curve: ExceedanceCurve, height: Array, area: float) -> Array:
        """Return the expected number of unseen rocks above a height around each site.

        The fraction of terrain above the height, divided by the top area of such a rock, is the
        number of rocks per m^2; the part that samples of the given density miss, and that another
        sensor leaves, is multiplied by `area` (m^2). `curve` is the fraction of terrain above each
        height; `height` (m) is () or one value per site (rows, cols). The result is (rows, cols).
        """

        def unseen(above: Array, where: BoolArray | None = None) -> Array:
            if height.ndim:
                at = slice(None) if where is None else where
                return curve.unseen_rocks(above, self.density[at] * self._resolved(above))
            # Average the density-dependent number over the footprint.
            width = max(
                1, round(np.sqrt(footprint_area(self.lander)) / self.horizontal_plane.grid.posting)
            )
            each = ndimage.uniform_filter(
                curve.unseen_rocks(above, self.density * self._resolved(above)),
                width,
                mode="nearest",
            )
            return np.asarray(each if where is None else each[where])

        if self.undetected_rock_ratio is None:
            return np.asarray(area * unseen(height))
        return np.asarray(area * self.undetected_rock_ratio.remaining_rocks(unseen, height))

    def _resolved(self, height: Array) -> Array:
        """Return the fraction of the samples on a rock that show it (...).

        `height` (...) is that of the rock, m. A rock that is not wider than the beam is not shown.
        """
        radius = 0.5 * np.maximum(height, 0.0) / self.height_ratio
        return np.asarray(peak_ratio(radius, self.beam_sigma) ** _RESOLVED_POWER)

    def observed_terrain_bound(self) -> Array:
        """Return the upper bound of safety that slope and roughness set (rows, cols).

        In a sum of evidence, much good evidence can outweigh one fatal defect. The probability is
        therefore at most four times the lower of the probabilities that slope and roughness by
        support planes are within their limits. Close to the slope limit, no fit has enough sites
        to claim safety, and the bound is lower.
        """
        p_worst = np.minimum(self.support_planes.p_slope, self.support_planes.p_roughness).astype(
            np.float64
        )
        ceiling = np.interp(self.slope, *_SLOPE_CEILING)
        return np.asarray(np.minimum(ceiling, _MAX_P_FACTOR * p_worst))

    def p_no_rock_under_pads(self) -> Array:
        """Return the probability that no unseen rock tilts the lander beyond its limit.

        Such a rock lies in the ring that the pads may touch and raises the slope above its limit.
        Their expected number includes gravel and is doubled, because on a slope even a low rock
        violates the slope limit. Where a rock below the minimum counted height would violate the
        limit, the number of such rocks comes only from the mission's distribution, and the
        probability stays below the threshold of claimed safety. The result is (rows, cols).
        """
        height = self.tilting_height
        rocks = self.count_rocks(self.curve.with_gravel, height, pad_ring_area(self.lander))
        low = height < self.curve.min_counted_gravel_height
        return np.asarray(
            np.exp(-_PAD_ROCK_FACTOR * rocks) * np.where(low, MAX_P_UNCOUNTED_ROCKS, 1.0)
        )

    def far_bound(self) -> Array:
        """Return the lower of Eqs. 15 to 17 and the probability of no rough rock.

        This bounds the safety probability far from the domain of the fits; the result is (rows,
        cols). The equations are those of the Gaussian DEM paper. A rough rock is unobserved and
        exceeds the roughness margin.
        """
        none = np.exp(-np.nan_to_num(self.expected_roughness_violations, nan=np.inf))
        return np.minimum(self.horizontal_plane.p_safe.astype(np.float64), none)
