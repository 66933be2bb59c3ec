"""From what a map says of a site to how often such sites are safe, and where that is known.

Eqs. 15 to 17 of the Gaussian DEM paper bound the probability for the worst of what a footprint may
hold; what the support planes say of the mean knows nothing of what was not seen. A logistic
regression on both, and on the rocks that no sample has met, turns them into a frequency. All is
dimensionless: heights count by the lander's limits, distances by its legs, rocks by footprint.

The regression was fitted once to all worlds and once without each of them, and the lowest counts
(`lunarsim.safety.ensemble`). It is a frequency where these fits agree that a site is surely safe or
surely not, and few hazards stand or gape unseen. Elsewhere no fit to other worlds can know how
often a site is safe: near that domain the map takes the odds that it is unsafe twelve times, and
farther off it gives the lowest of that, Eqs. 15 to 17, and the chance that no unseen rock stands
there, but for one case in a thousand, in which the fits are believed: so the best of sites that are
all but hopeless can be told. All edges are crossed one way only as the evidence gets worse. A
calibration of a scenario's own (`lunarsim.safety.refit`) brings its own last stage and its own
domain.
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
from lunarsim.safety.bends import Term, columns
from lunarsim.safety.conservative import StochasticSafety
from lunarsim.safety.domain import Domain
from lunarsim.safety.ensemble import SURE, Ensemble, Odds, cautious, doubted
from lunarsim.safety.exact import SafetyMap
from lunarsim.safety.exposure import footprint_area, pad_ring_area, tilting_height
from lunarsim.safety.refit import ScenarioCalibration
from lunarsim.safety.thinning import Thinning
from lunarsim.safety.unseen_rocks import HeightCurve

Array = NDArray[np.float64]
FloatMap = NDArray[np.float32]
BoolMap = NDArray[np.bool_]

# Between these the regression may bend: probits, shares of the limits, decades of unseen rocks in
# the footprint, decades of the share of ground above a height.
_PROBITS = np.array([-6.0, -4.0, -2.5, -1.5, -0.7, 0.0, 0.7, 1.5, 2.5, 4.0])
_SHARES = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 0.95, 1.0, 1.05, 1.15, 1.3, 1.6, 2.2, 3.0])
_ROCKS = np.array([-4.0, -3.0, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
_COVER = np.log10([1e-5, 1e-4, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.016, 0.03, 0.06, 0.12])
# Heights, over the limit, above which the share of ground counts.
_HEIGHTS = np.array([0.3, 0.6, 1.0, 1.6])
_DEPTHS = np.array([0.6, 1.0])
# Intercept, noise, spacing and its square: nothing is claimed for these.
FREE = 4
RISING = 4 * (len(_PROBITS) - 1) + 2 * (len(_SHARES) - 1) + 3 * (len(_ROCKS) - 1)
RISING += (len(_HEIGHTS) + len(_DEPTHS)) * (len(_COVER) - 1)
COUNT = FREE + RISING

# See `ceiling`.
_ODDS = 4.0
_LEFT_OF_SLOPE = np.array([[0.94, 0.96], [1.0, 0.85]])
_UNDER_PADS = 2.0
# Chance that is left where rocks too low to be counted would tilt the lander too far: less than is
# surely safe.
UNCOUNTED = 0.94
# In the domain at most so many hazards stand unseen in a footprint, and so many rocks, or holes,
# under the pads that would tilt the lander over its limit.
MOST_HAZARDS = 0.003
MOST_TILTING = 0.5
MOST_SINKING = 0.003
# Landers and scans of the fit: noise over the roughness limit, spacing over the legs' radius, and
# limits of slope, rad.
NOISES = (0.0, 0.5)
SPACINGS = (0.01, 1.0)
STEEPEST = tuple(np.deg2rad((4.5, 22.0)))
PACKAGED = Domain(MOST_HAZARDS, MOST_TILTING, NOISES, SPACINGS)
# Near the domain fits to all other worlds were still low enough once they took the odds that a site
# is unsafe so many times.
FARTHER = float(np.log(12.0))
# So often what is said of rocks that nobody has seen is taken to be wrong. Where samples are sparse
# they are so many that no site is left any chance, and the best of them must still be told.
UNSURE = 1e-3
_NEAR = Domain(0.1, 2.0, NOISES, SPACINGS)
_NEAR_SINKING = 0.1


@dataclass(frozen=True)
class Evidence:
    """What a map says of its sites, for `calibrated_safety`; rasters are (rows, cols).

    Attributes
    ----------
    level, planes
        Of `stochastic_safety` and `plane_stochastic_safety`.
    nominal
        Of `bounded_safety` on the mean elevations.
    lander
        Of all three.
    curve
        How high the ground stands, from the samples and the mission's rock law.
    holes
        How deep it lies.
    density
        Samples on a square metre.
    noise, spacing
        Standard deviation of a sample, and distance of neighbouring ones, m.
    thinning
        What another eye leaves of the rocks that no sample has met, over the ground about each
        site. None: all of them.
    """

    level: StochasticSafety
    planes: StochasticSafety
    nominal: SafetyMap
    lander: Lander
    curve: HeightCurve
    holes: HeightCurve
    density: Array
    noise: float
    spacing: float
    thinning: Thinning | None = None

    def __post_init__(self) -> None:
        if self.thinning is not None and self.thinning.shape != self.level.grid.shape:
            shape = self.thinning.shape
            raise InputError("calibration.thinning", shape, f"a raster {self.level.grid.shape}")
        for name in ("planes", "nominal"):
            grid = getattr(self, name).grid
            if grid != self.level.grid:
                raise InputError(f"calibration.{name}", grid, f"a map on {self.level.grid}")
        if np.shape(self.density) != self.level.grid.shape:
            shape = np.shape(self.density)
            raise InputError("calibration.density", shape, f"a raster {self.level.grid.shape}")
        for name in ("noise", "spacing"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"calibration.{name}", value, "a positive length in metres")

    @property
    def observed(self) -> BoolMap:
        """Where the whole footprint was seen."""
        return self.level.observed & self.planes.observed & self.nominal.observed

    @cached_property
    def slope(self) -> Array:
        """Tangent of the nominal slope over that of the limit; NaN where not observed."""
        slope = np.tan(self.nominal.slope.astype(np.float64))
        return np.asarray(slope / np.tan(self.lander.slope_limit))

    @cached_property
    def roughness(self) -> Array:
        """Nominal roughness over the limit; NaN where not observed."""
        return np.asarray(self.nominal.roughness / np.float64(self.lander.roughness_limit))

    @property
    def noise_ratio(self) -> float:
        """Noise of a sample over the roughness limit."""
        return self.noise / self.lander.roughness_limit

    @property
    def spacing_ratio(self) -> float:
        """Distance of neighbouring samples over the radius of the legs."""
        return self.spacing / self.lander.leg_radius

    def tilting(self) -> Array:
        """Return how many unseen rocks under the pads, at any heading, would tilt it too far."""
        return self._tilting

    @cached_property
    def _tilting_height(self) -> Array:
        return tilting_height(self.slope, self.lander)

    @cached_property
    def _tilting(self) -> Array:
        return self._expected(self.curve, self._tilting_height, pad_ring_area(self.lander))

    def expected_under_pads(self) -> Array:
        """Return the same with gravel as it was counted; see `HeightCurve.careful`."""
        area = pad_ring_area(self.lander)
        return self._expected(self.curve.careful, self._tilting_height, area)

    def sinking(self) -> Array:
        """Return how many unseen holes under the pads would tilt the lander too far."""
        return self._sinking

    @cached_property
    def _sinking(self) -> Array:
        width = self.lander.pad_diameter
        found = self.holes.sunk(self._tilting_height, self.density, width)
        return np.asarray(pad_ring_area(self.lander) * found)

    def piercing(self) -> Array:
        """Return how many unseen rocks in the footprint rise above what roughness is left."""
        return self._piercing

    @cached_property
    def _piercing(self) -> Array:
        height = (1.0 - self.roughness) * self.lander.roughness_limit
        return self._expected(self.curve, height, footprint_area(self.lander))

    def hazards(self) -> Array:
        """Return how many unseen rocks in the footprint alone would be too high."""
        return self._hazards

    @cached_property
    def _hazards(self) -> Array:
        height = np.array(self.lander.roughness_limit)
        return self._expected(self.curve, height, footprint_area(self.lander))

    def _expected(self, curve: HeightCurve, height: Array, area: float) -> Array:
        """Return rocks above a height (rows, cols) or () in an area about each site."""

        def unseen(above: Array, where: BoolMap | None = None) -> Array:
            if height.ndim:
                at = slice(None) if where is None else where
                return curve.unseen(above, self.density[at])
            # The density may change under the footprint.
            width = max(1, round(np.sqrt(footprint_area(self.lander)) / self.level.grid.posting))
            each = ndimage.uniform_filter(curve.unseen(above, self.density), width, mode="nearest")
            return np.asarray(each if where is None else each[where])

        if self.thinning is None:
            return np.asarray(area * unseen(height))
        return np.asarray(area * self.thinning.left(unseen, height))


def features(evidence: Evidence, where: NDArray[np.bool_]) -> Array:
    """Return what the probability is computed from, at sites (n, `COUNT`).

    The first `FREE` say how well was measured. Each of the others only rises when slope,
    roughness, the chance or size of a rock, or the expected unseen rocks fall; weights that are not
    negative make the probability do so.

    Parameters
    ----------
    evidence
        Of the map.
    where
        The sites (rows, cols).
    """
    terms = _terms(evidence, where)
    n = int(np.count_nonzero(where))
    return np.column_stack((np.tile(_free(evidence), (n, 1)), columns(terms, n)))


def odds_of(evidence: Evidence, where: NDArray[np.bool_], model: Ensemble) -> Odds:
    """Return what the regressions say of sites (n,), chosen by a mask (rows, cols)."""
    return model.judge(_free(evidence), _terms(evidence, where))


def _terms(e: Evidence, where: NDArray[np.bool_]) -> list[Term]:
    """Return what speaks for and against sites (rows, cols)."""
    terms = []
    for p in (e.level.p_slope, e.level.p_roughness, e.planes.p_slope, e.planes.p_roughness):
        probit = ndtri(np.clip(p[where].astype(np.float64), 1e-12, 1.0 - 1e-9))
        terms.append(Term(probit, _PROBITS, falls=False))
    terms += [Term(share[where], _SHARES) for share in (e.slope, e.roughness)]
    for rocks in (e.tilting(), e.piercing(), e.sinking()):
        terms.append(Term(np.log10(rocks[where] + 1e-6), _ROCKS))
    shares = np.log10(e.curve.at(_HEIGHTS * e.lander.roughness_limit))
    depths = np.log10(e.holes.at(_DEPTHS * e.lander.roughness_limit))
    return terms + [Term(share, _COVER) for share in (*shares, *depths)]


def _free(e: Evidence) -> Array:
    """Return what says how well was measured (`FREE`,)."""
    noise = np.log(e.noise / e.lander.roughness_limit + 1e-3)
    spacing = np.log(e.spacing / e.lander.leg_radius)
    return np.array([1.0, noise, spacing, spacing**2])


def in_domain(evidence: Evidence, domain: Domain = PACKAGED) -> BoolMap:
    """Tell where few enough rocks can stand unseen for the regression to hold (rows, cols).

    It does so by the map's own samples; noise and spacing must be within those of the fit. The
    packaged regression also asks for few holes, and for a lander with a limit of the slope like
    those that it was fitted for; a scenario's own has seen its own.

    Parameters
    ----------
    evidence
        Of the map.
    domain
        Left out: that of the packaged regression.
    """
    e = evidence
    if not domain.measured(e.noise_ratio, e.spacing_ratio):
        return np.zeros(e.level.grid.shape, np.bool_)
    if domain is PACKAGED:
        return _within(e, PACKAGED, MOST_SINKING)
    return np.asarray(e.observed & domain.few(e.hazards(), e.tilting()))


def _within(e: Evidence, domain: Domain, sinking: float) -> BoolMap:
    """Tell where rocks and holes are few enough (rows, cols), for landers like those of the fit."""
    known = domain.measured(e.noise_ratio, e.spacing_ratio)
    if not (known and STEEPEST[0] <= e.lander.slope_limit <= STEEPEST[1]):
        return np.zeros(e.level.grid.shape, np.bool_)
    with np.errstate(invalid="ignore"):
        few = domain.few(e.hazards(), e.tilting()) & (e.sinking() <= sinking)
    return np.asarray(e.observed & few)


@lru_cache(maxsize=1)
def measured() -> Ensemble:
    """Return the weights measured by `scenarios/lidar_maps/calibration.py`."""
    return Ensemble.packaged("lunarsim.safety", "calibration.json", COUNT, RISING)


def calibrated_safety(
    evidence: Evidence,
    model: Ensemble | None = None,
    refit: ScenarioCalibration | None = None,
) -> tuple[FloatMap, BoolMap]:
    """Return the probability that a site is safe (rows, cols), and where it is a frequency.

    It never rises with slope, roughness, or rocks, seen or expected. Where it is no frequency it is
    low, see the head of this module; where not observed it is 0.

    Parameters
    ----------
    evidence
        Of the map.
    model
        Left out: the packaged one.
    refit
        Last stage and domain of a scenario's own; left out: those of the packaged regression.

    Raises
    ------
    InputError
        If `refit` was fitted for another lander or to another regression.
    """
    model = model or measured()
    if refit is not None:
        refit.check(evidence.lander, model)
    seen, known = evidence.observed, in_domain(evidence)
    covered = known if refit is None else in_domain(evidence, refit.domain) & seen
    p, claimed = np.zeros(seen.shape, np.float32), covered.copy()
    if seen.any():
        most, clear = ceiling(evidence)[seen], clear_of_pads(evidence)[seen]
        least, said = bound(evidence)[seen], odds_of(evidence, seen, model)
        p[seen] = judged(said.low, most, clear, least, known[seen], covered[seen], refit)
        if refit is None:
            claimed[seen] &= said.verdict(np.minimum(most, clear)).agreed
    return p, claimed


def judged(
    odds: Array,
    most: Array,
    clear: Array,
    least: Array,
    known: BoolMap,
    covered: BoolMap,
    refit: ScenarioCalibration | None = None,
) -> Array:
    """Return the probability of sites (n,).

    Where a fit has not seen their like, or does not call them surely safe, it is the fits' with a
    wider margin, and at most the bound. In its domain a refit knows by its scenario's own sites
    what rocks under the pads do; elsewhere the chance that there is none holds. In `UNSURE` of all
    cases it does not, nor does the bound.

    Parameters
    ----------
    odds
        Lowest log odds of the sites (n,).
    most, clear, least
        `ceiling`, `clear_of_pads` and `bound` of the sites (n,).
    known, covered
        Which of them lie in the domain of the regression, and in that of the refit (n,); the same
        without one.
    refit
        As for `calibrated_safety`.
    """
    both = np.minimum(most, clear)
    unbound = SURE * np.minimum(expit(odds), most)
    if refit is None:
        p = cautious(odds, both, least, covered, FARTHER)
        whole = p >= SURE
    else:
        inside = np.minimum(refit.probability(odds, known), most)
        unbound = np.minimum(unbound, inside)
        lowest = doubted(odds, both, least, FARTHER)
        p = np.where(covered, inside, np.minimum(inside, lowest))
        whole = covered
    return np.asarray(np.where(whole, p, (1.0 - UNSURE) * p + UNSURE * unbound))


def ceiling(evidence: Evidence) -> Array:
    """Return what the probability cannot exceed, by what was seen (rows, cols).

    Sums of evidence let much that is good make up for one thing that is fatal. Where the support
    planes give slope or roughness less than one chance in so many, that is all there is. Just under
    the limit of the slope no fit has seen enough ground to call any surely safe.
    """
    e = evidence
    least = np.minimum(e.planes.p_slope, e.planes.p_roughness).astype(np.float64)
    return np.asarray(np.minimum(np.interp(e.slope, *_LEFT_OF_SLOPE), _ODDS * least))


def clear_of_pads(evidence: Evidence) -> Array:
    """Return the chance that no unseen rock tilts the lander too far, however many (rows, cols).

    On a slope a rock under a pad need not be high for that: twice as many count as may be there.
    Where one that is lower than any that was counted would do it, the mission's law says how many
    there are, and no site is surely safe.
    """
    e = evidence
    rocks = e.expected_under_pads()
    low = e._tilting_height < e.curve.gravel_counted
    return np.asarray(np.exp(-_UNDER_PADS * rocks) * np.where(low, UNCOUNTED, 1.0))


def bound(evidence: Evidence) -> Array:
    """Return what the probability cannot exceed outside the domain (rows, cols).

    The lower of Eqs. 15 to 17 and the chance that no unseen rock stands there; near the domain,
    where the fits still tell enough, 1.
    """
    none = np.exp(-np.nan_to_num(evidence.piercing(), nan=np.inf))
    far = np.minimum(evidence.level.p_safe.astype(np.float64), none)
    return np.asarray(np.where(_within(evidence, _NEAR, _NEAR_SINKING), 1.0, far))
