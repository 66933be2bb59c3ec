"""Calibrated probability that a site is safe, and where it is a frequency.

Eqs. 15 to 17 of the Gaussian DEM paper bound the probability by the worst cells of a footprint;
the test by support planes uses the mean and ignores unobserved terrain. A logistic regression on
both, and on the expected unobserved rocks, converts them to a frequency. All features are
dimensionless: heights relative to the lander's limits, distances relative to its legs, rocks per
footprint.

The regression was fitted once to all worlds and once without each of them, and the minimum over
the fits is used (`ensemble`). It is a frequency where all fits agree that a site is
almost certainly safe or almost certainly unsafe, and where few unobserved hazards are expected.
Elsewhere a fit to other worlds cannot predict how often a site is safe. Near that domain the odds
that a site is unsafe are multiplied by twelve. Farther away the result is the minimum of that, of
Eqs. 15 to 17 and of the probability that no unobserved rock is present. With a weight of one in a
thousand the fits are used alone, so that sites of very low probability can still be ranked.
Across all these boundaries, worse evidence never increases the probability. A scenario's own
calibration (`scenario_calibration`) has its own last stage and its own domain.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import expit, ndtri

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.calibration.ensemble import (
    ALMOST_CERTAINLY_SAFE_P,
    Ensemble,
    LogOddsBounds,
    conservative_probability,
    out_of_domain_bound,
)
from lunarsim.onboard.calibration.monotone_splines import MonotoneSplineTerm, spline_features
from lunarsim.onboard.calibration.scenario_calibration import ScenarioCalibration
from lunarsim.safety.conservative import StochasticSafety
from lunarsim.safety.exact import SafetyMap
from lunarsim.safety.rock_effects import footprint_area, pad_ring_area, tilt_limit_rock_height
from lunarsim.safety.undetected_rock_ratio import UndetectedRockRatio
from lunarsim.safety.unseen_rocks import ExceedanceCurve
from lunarsim.typing import Array, BoolArray

FloatMap = NDArray[np.float32]
BoolMap = BoolArray

# Knots of the regression: probits, ratios to the limits, decades of unobserved rocks in the
# footprint, decades of the fraction of terrain above a height.
_PROBITS = np.array([-6.0, -4.0, -2.5, -1.5, -0.7, 0.0, 0.7, 1.5, 2.5, 4.0])
_RATIOS = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 0.95, 1.0, 1.05, 1.15, 1.3, 1.6, 2.2, 3.0])
_ROCKS = np.array([-4.0, -3.0, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
_COVER = np.log10([1e-5, 1e-4, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.016, 0.03, 0.06, 0.12])
# Heights and depths, over the roughness limit, at which the fraction of terrain is a feature.
_HEIGHTS = np.array([0.3, 0.6, 1.0, 1.6])
_DEPTHS = np.array([0.6, 1.0])
# Intercept, noise, spacing and its square: weights of any sign.
UNCONSTRAINED_FEATURES = 4
MONOTONE_FEATURES = 4 * (len(_PROBITS) - 1) + 2 * (len(_RATIOS) - 1) + 3 * (len(_ROCKS) - 1)
MONOTONE_FEATURES += (len(_HEIGHTS) + len(_DEPTHS)) * (len(_COVER) - 1)
COUNT = UNCONSTRAINED_FEATURES + MONOTONE_FEATURES

# Parameters of `observed_terrain_bound` and `p_no_rock_under_pads`.
_MAX_P_FACTOR = 4.0
_SLOPE_CEILING = np.array([[0.94, 0.96], [1.0, 0.85]])
_PAD_ROCK_FACTOR = 2.0
# Maximum probability where rocks too low to be counted would tilt the lander beyond its limit; it
# is below the threshold of claimed safety.
MAX_P_UNCOUNTED_ROCKS = 0.94
# Limits of the domain: expected unobserved hazards in a footprint, and expected unobserved rocks,
# or holes, under the pads that would tilt the lander beyond its limit.
MOST_HAZARDS = 0.003
MOST_TILTING = 0.5
MOST_SINKING = 0.003
# Landers and scans of the fit: noise over the roughness limit, spacing over the legs' radius, and
# slope limits, rad.
NOISE_RATIO_RANGE = (0.0, 0.5)
SPACING_RATIO_RANGE = (0.01, 1.0)
SLOPE_LIMIT_RANGE_RAD = tuple(np.deg2rad((4.5, 22.0)))
PACKAGED_DOMAIN = CalibrationDomain(
    MOST_HAZARDS, MOST_TILTING, NOISE_RATIO_RANGE, SPACING_RATIO_RANGE
)
# Near the domain, fits to all other worlds were conservative enough once the odds that a site is
# unsafe were multiplied by this factor.
NEAR_DOMAIN_LOG_ODDS_MARGIN = float(np.log(12.0))
# Weight of the case that the estimates of unobserved rocks are wrong. Where samples are sparse,
# these estimates leave no site any probability, but the best sites must still be distinguishable.
UNKNOWN_MODEL_WEIGHT = 1e-3
_NEAR_DOMAIN = CalibrationDomain(0.1, 2.0, NOISE_RATIO_RANGE, SPACING_RATIO_RANGE)
_NEAR_DOMAIN_MAX_HOLES = 0.1


@dataclass(frozen=True)
class MapEvidence:
    """Hazard map data from which `calibrated_safety` estimates site safety.

    Attributes
    ----------
    level, planes
        Safety probabilities by a horizontal plane (`stochastic_safety`), and by the support planes
        of the legs (`plane_stochastic_safety`).
    nominal
        Result of `bounded_safety` for the mean elevations.
    lander
        Lander for which `level`, `planes` and `nominal` were computed.
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
    """

    level: StochasticSafety
    planes: StochasticSafety
    nominal: SafetyMap
    lander: Lander
    curve: ExceedanceCurve
    holes: ExceedanceCurve
    density: Array
    noise: float
    spacing: float
    undetected_rock_ratio: UndetectedRockRatio | None = None

    def __post_init__(self) -> None:
        if (
            self.undetected_rock_ratio is not None
            and self.undetected_rock_ratio.shape != self.level.grid.shape
        ):
            shape = self.undetected_rock_ratio.shape
            raise InputError(
                "calibration.undetected_rock_ratio",
                shape,
                f"must have the shape {self.level.grid.shape}",
            )
        for name in ("planes", "nominal"):
            grid = getattr(self, name).grid
            if grid != self.level.grid:
                raise InputError(
                    f"calibration.{name}",
                    grid,
                    "must have the same grid as `level`",
                    show_value=False,
                )
        if np.shape(self.density) != self.level.grid.shape:
            shape = np.shape(self.density)
            raise InputError(
                "calibration.density", shape, f"must have the shape {self.level.grid.shape}"
            )
        for name in ("noise", "spacing"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"calibration.{name}", value, "must be positive and finite")

    @property
    def observed(self) -> BoolMap:
        """Mask of the cells whose complete footprint was observed (rows, cols)."""
        return self.level.observed & self.planes.observed & self.nominal.observed

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
    def noise_ratio(self) -> float:
        """Standard deviation of an elevation sample over the lander's roughness limit."""
        return self.noise / self.lander.roughness_limit

    @property
    def spacing_ratio(self) -> float:
        """Distance between neighbouring elevation samples over the radius of the legs."""
        return self.spacing / self.lander.leg_radius

    def expected_tilt_violations(self) -> Array:
        """Return the expected number of unseen rocks that tilt a lander beyond its limit.

        These rocks lie under the pads and raise the slope above its limit. The result is (rows,
        cols).
        """
        return self._tilting

    @cached_property
    def _tilting_height(self) -> Array:
        return tilt_limit_rock_height(self.slope, self.lander)

    @cached_property
    def _tilting(self) -> Array:
        return self._expected(self.curve, self._tilting_height, pad_ring_area(self.lander))

    def expected_tilt_violations_with_gravel(self) -> Array:
        """Return the expected number of unseen rocks and gravel that tilt the lander.

        Like `expected_tilt_violations`, but the numbers of rocks are from
        `ExceedanceCurve.with_gravel`, which also uses counts at low heights. The result is (rows,
        cols).
        """
        area = pad_ring_area(self.lander)
        return self._expected(self.curve.with_gravel, self._tilting_height, area)

    def expected_hole_violations(self) -> Array:
        """Return the expected number of unseen holes that tilt a lander beyond its limit.

        These holes lie under the pads and raise the slope above its limit. The result is (rows,
        cols).
        """
        return self._sinking

    @cached_property
    def _sinking(self) -> Array:
        width = self.lander.pad_diameter
        found = self.holes.missed_holes(self._tilting_height, self.density, width)
        return np.asarray(pad_ring_area(self.lander) * found)

    def expected_roughness_violations(self) -> Array:
        """Return the expected number of unseen rocks that violate the roughness limit.

        These rocks lie in the footprint and are higher than the roughness limit minus the nominal
        roughness. The result is (rows, cols).
        """
        return self._piercing

    @cached_property
    def _piercing(self) -> Array:
        height = (1.0 - self.roughness) * self.lander.roughness_limit
        return self._expected(self.curve, height, footprint_area(self.lander))

    def expected_hazards(self) -> Array:
        """Return the expected number of unseen rocks higher than the roughness limit.

        The rocks are counted in the footprint of each cell; the nominal roughness is ignored. The
        result is (rows, cols).
        """
        return self._hazards

    @cached_property
    def _hazards(self) -> Array:
        height = np.array(self.lander.roughness_limit)
        return self._expected(self.curve, height, footprint_area(self.lander))

    def _expected(self, curve: ExceedanceCurve, height: Array, area: float) -> Array:
        """Return the expected number of unseen rocks above a height around each site.

        `curve` is the fraction of terrain above each height; `height` (m) is () or one value per
        site (rows, cols); `area` (m^2) is where the rocks are counted. The result is (rows, cols).
        """

        def unseen(above: Array, where: BoolMap | None = None) -> Array:
            if height.ndim:
                at = slice(None) if where is None else where
                return curve.unseen_rocks(above, self.density[at])
            # Average the density-dependent number over the footprint.
            width = max(1, round(np.sqrt(footprint_area(self.lander)) / self.level.grid.posting))
            each = ndimage.uniform_filter(
                curve.unseen_rocks(above, self.density), width, mode="nearest"
            )
            return np.asarray(each if where is None else each[where])

        if self.undetected_rock_ratio is None:
            return np.asarray(area * unseen(height))
        return np.asarray(area * self.undetected_rock_ratio.remaining_rocks(unseen, height))


def features(evidence: MapEvidence, where: BoolArray) -> Array:
    """Return the regression's input features of sites of a hazard map (n, `COUNT`).

    The first `UNCONSTRAINED_FEATURES` features describe the quality of the measurement. Each of the
    others only increases when slope, roughness, the probability or size of a rock, or the expected
    unobserved rocks decrease; with non-negative weights the probability does the same.

    Parameters
    ----------
    evidence
        Data of the hazard map.
    where
        Mask of the sites (rows, cols).
    """
    terms = _monotone_terms(evidence, where)
    n = int(np.count_nonzero(where))
    return np.column_stack(
        (np.tile(_unconstrained_features(evidence), (n, 1)), spline_features(terms, n))
    )


def log_odds_bounds(evidence: MapEvidence, where: BoolArray, model: Ensemble) -> LogOddsBounds:
    """Return minimum and maximum log odds of site safety over an ensemble (n,).

    `evidence` is the data of the hazard map, `where` the mask of the sites (rows, cols), `model`
    the ensemble of logistic regressions.
    """
    return model.evaluate_log_odds(
        _unconstrained_features(evidence), _monotone_terms(evidence, where)
    )


def _monotone_terms(evidence: MapEvidence, where: BoolArray) -> list[MonotoneSplineTerm]:
    """Return the regression's monotone terms for the sites in the mask `where`."""
    terms = []
    for p in (
        evidence.level.p_slope,
        evidence.level.p_roughness,
        evidence.planes.p_slope,
        evidence.planes.p_roughness,
    ):
        probit = ndtri(np.clip(p[where].astype(np.float64), 1e-12, 1.0 - 1e-9))
        terms.append(MonotoneSplineTerm(probit, _PROBITS, is_decreasing=False))
    terms += [
        MonotoneSplineTerm(share[where], _RATIOS) for share in (evidence.slope, evidence.roughness)
    ]
    for rocks in (
        evidence.expected_tilt_violations(),
        evidence.expected_roughness_violations(),
        evidence.expected_hole_violations(),
    ):
        terms.append(MonotoneSplineTerm(np.log10(rocks[where] + 1e-6), _ROCKS))
    shares = np.log10(evidence.curve.at(_HEIGHTS * evidence.lander.roughness_limit))
    depths = np.log10(evidence.holes.at(_DEPTHS * evidence.lander.roughness_limit))
    return terms + [MonotoneSplineTerm(share, _COVER) for share in (*shares, *depths)]


def _unconstrained_features(evidence: MapEvidence) -> Array:
    """Return the regression's features of a map's measurement quality.

    They are 1, the logarithms of relative noise and spacing, and the square of the latter logarithm
    (`UNCONSTRAINED_FEATURES`,).
    """
    noise = np.log(evidence.noise / evidence.lander.roughness_limit + 1e-3)
    spacing = np.log(evidence.spacing / evidence.lander.leg_radius)
    return np.array([1.0, noise, spacing, spacing**2])


def in_domain(evidence: MapEvidence, domain: CalibrationDomain = PACKAGED_DOMAIN) -> BoolMap:
    """Return which cells of a hazard map are in a calibration's domain (rows, cols).

    In the domain, few unobserved rocks are expected from the map's own samples, and noise and
    spacing are in the range of the fit. The regression supplied with lunarsim also requires few
    holes and a slope limit in the range of its landers; a scenario's own calibration does not.

    Parameters
    ----------
    evidence
        Data of the hazard map.
    domain
        Domain to test; omitted: the domain of the regression supplied with lunarsim.
    """
    e = evidence
    if not domain.is_within_measurements(e.noise_ratio, e.spacing_ratio):
        return np.zeros(e.level.grid.shape, np.bool_)
    if domain is PACKAGED_DOMAIN:
        return _where_few_hazards(e, PACKAGED_DOMAIN, MOST_SINKING)
    return np.asarray(
        e.observed & domain.is_within_counts(e.expected_hazards(), e.expected_tilt_violations())
    )


def _where_few_hazards(
    evidence: MapEvidence, domain: CalibrationDomain, max_tilting_holes: float
) -> BoolMap:
    """Return where expected rocks and holes are few enough for a domain (rows, cols).

    `max_tilting_holes` is the maximum expected number of holes under the pads that tilt the lander
    too far. The result is False if noise, spacing or slope limit is outside the range of the fit.
    """
    known = domain.is_within_measurements(evidence.noise_ratio, evidence.spacing_ratio)
    if not (
        known
        and SLOPE_LIMIT_RANGE_RAD[0] <= evidence.lander.slope_limit <= SLOPE_LIMIT_RANGE_RAD[1]
    ):
        return np.zeros(evidence.level.grid.shape, np.bool_)
    with np.errstate(invalid="ignore"):
        few = domain.is_within_counts(
            evidence.expected_hazards(), evidence.expected_tilt_violations()
        ) & (evidence.expected_hole_violations() <= max_tilting_holes)
    return np.asarray(evidence.observed & few)


@lru_cache(maxsize=1)
def packaged_ensemble() -> Ensemble:
    """Return the ensemble of regressions supplied with lunarsim.

    The ensemble was fitted by `scenarios/lidar_maps/calibration.py`.
    """
    return Ensemble.packaged("gaussian_dem.json", COUNT, MONOTONE_FEATURES)


def calibrated_safety(
    evidence: MapEvidence,
    model: Ensemble | None = None,
    refit: ScenarioCalibration | None = None,
) -> tuple[FloatMap, BoolMap]:
    """Return the calibrated probability of safety, and where it is a frequency.

    Both results are (rows, cols).

    A frequency means that the fraction of safe sites equals the probability. Elsewhere the
    probability is conservative, and 0 where the terrain is not observed. The probability does not
    increase with slope, roughness, or observed or expected rocks.

    Parameters
    ----------
    evidence
        Data of the hazard map.
    model
        Ensemble of regressions; omitted: the ensemble supplied with lunarsim.
    refit
        Calibration fitted to a scenario, with its own last stage and domain; omitted: none.

    Raises
    ------
    InputError
        If `refit` was fitted for another lander or to other regressions than `model`.
    """
    model = model or packaged_ensemble()
    if refit is not None:
        refit.check(evidence.lander, model)
    seen, known = evidence.observed, in_domain(evidence)
    covered = known if refit is None else in_domain(evidence, refit.domain) & seen
    p, claimed = np.zeros(seen.shape, np.float32), covered.copy()
    if seen.any():
        upper_bound, p_clear = (
            observed_terrain_bound(evidence)[seen],
            p_no_rock_under_pads(evidence)[seen],
        )
        outside_bound, odds_bounds = (
            outside_domain_bound(evidence)[seen],
            log_odds_bounds(evidence, seen, model),
        )
        p[seen] = site_probability(
            odds_bounds.low, upper_bound, p_clear, outside_bound, known[seen], covered[seen], refit
        )
        if refit is None:
            claimed[seen] &= odds_bounds.estimate(np.minimum(upper_bound, p_clear)).agreed
    return p, claimed


def site_probability(
    odds: Array,
    upper_bound: Array,
    p_clear: Array,
    outside_bound: Array,
    in_model_domain: BoolMap,
    in_refit_domain: BoolMap,
    refit: ScenarioCalibration | None = None,
) -> Array:
    """Return the safety probability of sites from log odds and upper bounds (n,).

    Outside the domain of the fits, or below the threshold of claimed safety, the log odds are
    reduced by a wider margin, and the probability is at most `outside_bound`. In the domain of a
    refit, its scenario's own sites account for rocks under the pads; elsewhere `p_clear` limits the
    probability. A mixture with the weight `UNKNOWN_MODEL_WEIGHT` ignores `p_clear` and
    `outside_bound`, so that sites of very low probability can still be ranked.

    Parameters
    ----------
    odds
        Minimum log odds of the sites over the ensemble (n,).
    upper_bound, p_clear, outside_bound
        Results of `observed_terrain_bound`, `p_no_rock_under_pads` and `outside_domain_bound` for
        the sites (n,).
    in_model_domain, in_refit_domain
        Whether each site is in the domain of the ensemble, and in that of the refit (n,); equal
        without a refit.
    refit
        Calibration fitted to a scenario; None: none.
    """
    both = np.minimum(upper_bound, p_clear)
    unbound = ALMOST_CERTAINLY_SAFE_P * np.minimum(expit(odds), upper_bound)
    if refit is None:
        p = conservative_probability(
            odds, both, outside_bound, in_refit_domain, NEAR_DOMAIN_LOG_ODDS_MARGIN
        )
        is_final = p >= ALMOST_CERTAINLY_SAFE_P
    else:
        inside = np.minimum(refit.probability(odds, in_model_domain), upper_bound)
        unbound = np.minimum(unbound, inside)
        lowest = out_of_domain_bound(odds, both, outside_bound, NEAR_DOMAIN_LOG_ODDS_MARGIN)
        p = np.where(in_refit_domain, inside, np.minimum(inside, lowest))
        is_final = in_refit_domain
    return np.asarray(
        np.where(is_final, p, (1.0 - UNKNOWN_MODEL_WEIGHT) * p + UNKNOWN_MODEL_WEIGHT * unbound)
    )


def observed_terrain_bound(evidence: MapEvidence) -> Array:
    """Return the upper bound of safety that slope and roughness set (rows, cols).

    In a sum of evidence, much good evidence can outweigh one fatal defect. The probability is
    therefore at most `_MAX_P_FACTOR` times the lower of slope and roughness safety by support
    planes. Close to the slope limit, no fit has enough sites to claim safety.
    """
    e = evidence
    p_worst = np.minimum(e.planes.p_slope, e.planes.p_roughness).astype(np.float64)
    return np.asarray(np.minimum(np.interp(e.slope, *_SLOPE_CEILING), _MAX_P_FACTOR * p_worst))


def p_no_rock_under_pads(evidence: MapEvidence) -> Array:
    """Return the probability that no unseen rock tilts the lander beyond its limit.

    The result is (rows, cols).

    Such a rock lies under a pad and raises the slope above its limit. On a slope even a low rock
    violates the slope limit: twice the expected number is used. Where a rock below the minimum
    counted height would violate the limit, the number of such rocks comes only from the mission's
    distribution, and the probability stays below the threshold of claimed safety.
    """
    e = evidence
    rocks = e.expected_tilt_violations_with_gravel()
    low = e._tilting_height < e.curve.min_counted_gravel_height
    return np.asarray(np.exp(-_PAD_ROCK_FACTOR * rocks) * np.where(low, MAX_P_UNCOUNTED_ROCKS, 1.0))


def outside_domain_bound(evidence: MapEvidence) -> Array:
    """Return the upper bound of safety outside the domain of the fits (rows, cols).

    The bound is the lower of Eqs. 15 to 17 of the Gaussian DEM paper and the probability that no
    unobserved rock exceeds the roughness margin; near the domain, where the fits are still accurate
    enough, it is 1.
    """
    none = np.exp(-np.nan_to_num(evidence.expected_roughness_violations(), nan=np.inf))
    far = np.minimum(evidence.level.p_safe.astype(np.float64), none)
    return np.asarray(
        np.where(_where_few_hazards(evidence, _NEAR_DOMAIN, _NEAR_DOMAIN_MAX_HOLES), 1.0, far)
    )
