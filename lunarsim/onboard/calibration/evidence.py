"""Evidence of a calibrated map: features, domain and bounds of its sites.

Each kind of map declares its `MapRegression` and derives its evidence from `CalibrationEvidence`:
the values of its terms, its upper bounds, and how its samples miss rocks. Everything else is the
same for all maps. All features are dimensionless: heights are relative to the lander's limits,
distances relative to its legs, rocks counted per footprint.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.ensemble import Ensemble, LogOddsBounds
from lunarsim.onboard.calibration.monotone_splines import MonotoneSplineTerm, spline_features
from lunarsim.safety.rock_effects import footprint_area, pad_ring_area, tilt_limit_rock_height
from lunarsim.safety.unseen_rocks import ExceedanceCurve
from lunarsim.typing import Array, BoolArray

# Intercept, noise, sampling and its square: weights of any sign.
UNCONSTRAINED_FEATURES = 4
# Slope limits of the landers of the fits, rad.
SLOPE_LIMIT_RANGE_RAD = tuple(np.deg2rad((4.5, 22.0)))
# Maximum probability where rocks too low to be counted would tilt the lander beyond its limit; it
# is below the threshold of claimed safety.
MAX_P_UNCOUNTED_ROCKS = 0.94
# Heights and depths, over the roughness limit, at which the fraction of terrain is a feature, and
# its knots, decades.
RELATIVE_HEIGHTS = np.array([0.3, 0.6, 1.0, 1.6])
RELATIVE_DEPTHS = np.array([0.6, 1.0])
_SHARE_KNOTS = np.log10([1e-5, 1e-4, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.016, 0.03, 0.06, 0.12])
# Expected numbers with a feature each: rocks that tilt the lander, that are too rough, and holes.
_COUNTS = 3


@dataclass(frozen=True)
class ExpectedHazardLimits:
    """Maximum expected numbers of undetected hazards at a site of a domain.

    Attributes
    ----------
    hazards
        Rocks in the footprint above the roughness limit.
    tilting, holes
        Rocks, and holes in the terrain, that would tilt the lander too far under a pad, counted in
        the ring that the pads may touch at any heading.
    """

    hazards: float
    tilting: float
    holes: float


@dataclass(frozen=True, eq=False)
class MapRegression:
    """Declaration of the calibrated probability of one kind of map.

    Attributes
    ----------
    file
        Name of the file with the weights supplied with lunarsim, in this package.
    knots
        Knots of the splines of the map's own terms, one array per term.
    count_knots
        Knots of the splines of the expected numbers of undetected rocks and holes, log10.
    rising_terms
        Number of terms, counted from the first, with whose values the probability of safety
        increases; it decreases with the values of all other terms.
    limits, near_limits
        Maximum expected numbers of undetected rocks and holes in the domain, and near it, where the
        fits to all other worlds were conservative enough.
    outside_margin
        Margin on the log odds of sites outside the domain, or not almost certainly safe.
    max_unsafe_p
        Probability up to which sites count as almost certainly unsafe.
    unknown_model_weight
        Weight of the case that the estimates of undetected rocks are wrong.
    dtype
        Type of the probabilities.
    """

    file: str
    knots: tuple[Array, ...]
    count_knots: Array
    limits: ExpectedHazardLimits
    near_limits: ExpectedHazardLimits
    outside_margin: float
    max_unsafe_p: float
    rising_terms: int = 0
    unknown_model_weight: float = 0.0
    dtype: type[np.floating] = np.float64

    @property
    def monotone_count(self) -> int:
        """Number of last features, whose weights are non-negative."""
        shares = len(RELATIVE_HEIGHTS) + len(RELATIVE_DEPTHS)
        knots = (*self.knots, *[self.count_knots] * _COUNTS, *[_SHARE_KNOTS] * shares)
        return sum(len(k) - 1 for k in knots)

    @property
    def count(self) -> int:
        """Number of features."""
        return UNCONSTRAINED_FEATURES + self.monotone_count

    @cached_property
    def packaged(self) -> Ensemble:
        """Ensemble of regressions supplied with lunarsim."""
        return Ensemble.packaged(self.file, self.count, self.monotone_count)


class CalibrationEvidence(ABC):
    """Evidence of the sites of a map, from which their calibrated safety follows.

    Arrays have one value per site, in the shape of `observed`.

    Attributes
    ----------
    regression
        Declaration of this kind of map.
    lander
        Lander for which the evidence was computed.
    curve, holes
        Fraction of terrain above each height, and below each depth.
    noise
        Standard deviation of the height of a sample, m.
    is_consistent
        Whether the measurements agree with each other; if not, no site is in a domain.
    """

    regression: ClassVar[MapRegression]
    lander: Lander
    curve: ExceedanceCurve
    holes: ExceedanceCurve
    noise: float
    is_consistent: bool = True

    # --- declared by each kind of map -----------------------------------------------------

    @property
    @abstractmethod
    def observed(self) -> BoolArray:
        """Mask of the sites whose complete footprint was observed."""

    @property
    @abstractmethod
    def spacing_ratio(self) -> float | Array:
        """Distance between neighbouring samples over the radius of the legs.

        One value for all sites or per site.
        """

    @property
    @abstractmethod
    def is_covered_by_fit(self) -> bool:
        """Whether noise and similar properties of the map are in the range of the fit.

        If not, no site is in the domain.
        """

    @property
    @abstractmethod
    def terrain_slope(self) -> Array:
        """Terrain slope to which the tilt by a rock adds, relative to the slope limit.

        Ratio of the two tangents, one value per site.
        """

    @property
    @abstractmethod
    def terrain_roughness(self) -> Array:
        """Terrain roughness to which the height of a rock adds, over the roughness limit.

        One value per site.
        """

    @property
    @abstractmethod
    def sample_density(self) -> Array:
        """Samples per square metre that may hit a rock or a hole, one value per site."""

    @property
    def may_be_claimed_unsafe(self) -> BoolArray:
        """Mask of the sites that may count as almost certainly unsafe."""
        return np.ones(self.observed.shape, np.bool_)

    @abstractmethod
    def log_sampling(self, where: BoolArray) -> float | Array:
        """Return the logarithm of relative sample spacing or density, () or (n,).

        Each kind of map uses one of them as a feature: spacing over the radius of the legs, or
        samples per squared radius. `where` is the mask of the n sites; () is one value for all.
        """

    @abstractmethod
    def term_values(self, where: BoolArray) -> Sequence[Array]:
        """Return the values of the map's own terms for n sites, one array (n,) per term.

        The terms are in the order of `MapRegression.knots`; `where` is the mask of the sites.
        """

    @abstractmethod
    def count_rocks(self, curve: ExceedanceCurve, height: Array, area: float) -> Array:
        """Return the expected number of undetected rocks above a height at each site.

        It is the number per square metre that follows from `curve` and that the samples miss,
        times `area` (m^2), in which the rocks are counted. `curve` is the fraction of terrain
        above each height; `height` (m) is () or one value per site.
        """

    @abstractmethod
    def observed_terrain_bound(self) -> Array:
        """Return the upper bound of the safety probability that measured values set.

        One value per site. In a sum of evidence, much good evidence can outweigh one fatal defect,
        so single measured values such as the slope limit the probability.
        """

    @abstractmethod
    def p_no_rock_under_pads(self) -> Array:
        """Return the probability that no unseen rock tilts the lander beyond its limit.

        One value per site, for rocks in the ring that the pads may touch at any heading.
        """

    @abstractmethod
    def far_bound(self) -> Array:
        """Return the upper bound of safety probability far from the domain of the fits.

        One value per site.
        """

    # --- expected undetected hazards ------------------------------------------------------

    @property
    def noise_ratio(self) -> float:
        """Standard deviation of an elevation sample over the lander's roughness limit."""
        return self.noise / self.lander.roughness_limit

    @cached_property
    def tilting_height(self) -> Array:
        """Height of a rock under a pad that tilts the lander to its limit, m.

        One value per site: the terrain slope adds to the tilt.
        """
        return tilt_limit_rock_height(self.terrain_slope, self.lander)

    @cached_property
    def expected_tilt_violations(self) -> Array:
        """Expected number of unseen rocks that would tilt the lander too far under a pad.

        One value per site, counted in the ring that the pads may touch at any heading.
        """
        return self.count_rocks(self.curve, self.tilting_height, pad_ring_area(self.lander))

    @cached_property
    def expected_hole_violations(self) -> Array:
        """Expected number of unseen holes that would tilt the lander too far under a pad.

        One value per site, counted in the ring that the pads may touch at any heading. Holes are
        depressions at least as wide as a pad.
        """
        width = self.lander.pad_diameter
        found = self.holes.missed_holes(self.tilting_height, self.sample_density, width)
        return np.asarray(pad_ring_area(self.lander) * found)

    @cached_property
    def expected_roughness_violations(self) -> Array:
        """Expected number of unseen rocks in the footprint above the roughness margin.

        One value per site. The margin is the roughness limit minus the measured roughness.
        """
        height = (1.0 - self.terrain_roughness) * self.lander.roughness_limit
        return self.count_rocks(self.curve, height, footprint_area(self.lander))

    @cached_property
    def expected_hazards(self) -> Array:
        """Expected number of unseen rocks in the footprint above the roughness limit.

        One value per site. The measured roughness is ignored.
        """
        height = np.array(self.lander.roughness_limit)
        return self.count_rocks(self.curve, height, footprint_area(self.lander))

    # --- domain and bounds ----------------------------------------------------------------

    @cached_property
    def in_domain(self) -> BoolArray:
        """Mask of the sites for which the regression is calibrated.

        Few unobserved rocks and holes are expected there, and the measurements and the slope limit
        are in the range of the fit.
        """
        return self._is_within(self.regression.limits)

    @property
    def near_domain(self) -> BoolArray:
        """Mask of the sites for which the regression is calibrated or conservative.

        It includes the sites in `in_domain`, and others with more expected undetected rocks and
        holes, where fits to other worlds still gave low enough probabilities.
        """
        return self._is_within(self.regression.near_limits)

    def _is_within(self, limits: ExpectedHazardLimits) -> BoolArray:
        """Return which sites are observed and within the limits of a domain.

        `limits` are the maximum expected numbers of rocks and holes. No site is within them if the
        measurements contradict each other, or if they or the lander's slope limit are outside the
        range of the fit.
        """
        low, high = SLOPE_LIMIT_RANGE_RAD
        if not (
            self.is_consistent and self.is_covered_by_fit and low <= self.lander.slope_limit <= high
        ):
            return np.zeros(self.observed.shape, np.bool_)
        with np.errstate(invalid="ignore"):
            few = (self.expected_hazards <= limits.hazards) & (
                self.expected_tilt_violations <= limits.tilting
            )
            few &= self.expected_hole_violations <= limits.holes
        return np.asarray(self.observed & few)

    def outside_domain_bound(self) -> Array:
        """Return the upper bound of safety probability outside the domain of the fits.

        Near the domain (`near_domain`), where the fits are still accurate enough, it is 1,
        elsewhere `far_bound`. One value per site.
        """
        return np.where(self.near_domain, 1.0, self.far_bound())

    # --- features -------------------------------------------------------------------------

    def features(self, where: BoolArray) -> Array:
        """Return the regression's input features of n sites (n, `MapRegression.count`).

        The first `UNCONSTRAINED_FEATURES` features describe the quality of the measurement. With
        non-negative weights for the others, safety never increases with worse evidence. `where` is
        the mask of the sites.
        """
        n = int(np.count_nonzero(where))
        free = np.broadcast_to(self._unconstrained(where), (n, UNCONSTRAINED_FEATURES))
        return np.column_stack((free, spline_features(self._terms(where), n)))

    def log_odds_bounds(self, where: BoolArray, model: Ensemble) -> LogOddsBounds:
        """Return minimum and maximum log odds of site safety over an ensemble (n,).

        `where` is the mask of the sites, `model` the ensemble of logistic regressions.
        """
        return model.evaluate_log_odds(self._unconstrained(where), self._terms(where))

    def _unconstrained(self, where: BoolArray) -> Array:
        """Return the features with weights of any sign, (4,) or (n, 4).

        They are 1, log noise, log sampling (`log_sampling`) and its square; equal for all sites or
        for each of the n sites in the mask `where`.
        """
        s, noise = self.log_sampling(where), np.log(self.noise_ratio + 1e-3)
        return np.stack(np.broadcast_arrays(1.0, noise, s, s**2), axis=-1)

    def _terms(self, where: BoolArray) -> list[MonotoneSplineTerm]:
        """Return the regression's monotone terms for the sites in the mask `where`.

        They are the terms of the map, the expected numbers of rocks and holes, and the fractions
        of terrain above heights and below depths.
        """
        r, limit = self.regression, self.lander.roughness_limit
        terms = [
            MonotoneSplineTerm(values, knots, is_decreasing=n >= r.rising_terms)
            for n, (values, knots) in enumerate(zip(self.term_values(where), r.knots, strict=True))
        ]
        for number in (
            self.expected_tilt_violations,
            self.expected_roughness_violations,
            self.expected_hole_violations,
        ):
            terms.append(MonotoneSplineTerm(np.log10(number[where] + 1e-6), r.count_knots))
        shares = (
            *np.log10(self.curve.at(RELATIVE_HEIGHTS * limit)),
            *np.log10(self.holes.at(RELATIVE_DEPTHS * limit)),
        )
        return terms + [MonotoneSplineTerm(share, _SHARE_KNOTS) for share in shares]
