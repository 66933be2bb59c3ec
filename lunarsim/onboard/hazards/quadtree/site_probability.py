"""From what a site looks like on the quadtree to how often such sites are safe.

The paper's limits tell which sites are eligible; they are no probability. Here the lander is also
put on the mean ground under its legs, at every heading, and what the points of its footprint and of
the zone tell is added: how far they reach, how they spread, what may stand between them unseen. All
is dimensionless: slopes and heights count by the lander's limits. Weights on all but the first
`FREE` are not negative, so that the probability never rises with slope, roughness, exceptions,
their height, or the rocks that may stand unseen. It is a frequency where fits without one world
agree and few rocks may stand unseen, as on the Gaussian DEM (`lunarsim.safety.calibration`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.quadtree.sites import Selection
from lunarsim.onboard.hazards.quadtree.surface import (
    Sampling,
    rises,
    sampling,
    surface,
    without_holes,
)
from lunarsim.onboard.hazards.quadtree.tree import QuadtreeMap
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import SafetyMap, bounded_safety
from lunarsim.safety.bends import Term, columns
from lunarsim.safety.calibration import STEEPEST, UNCOUNTED
from lunarsim.safety.ensemble import Ensemble, cautious
from lunarsim.safety.exposure import (
    footprint_area,
    least_tilting_height,
    pad_ring_area,
    tilt_of,
    tilting_height,
)
from lunarsim.safety.unseen_rocks import HeightCurve, depth_curve, height_curve

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# See `ceiling`: from a share of the limit on, what chance is left.
_LEFT_OF_SLOPE = np.array(
    [[0.93, 0.96, 1.0, 1.05, 1.15, 1.3, 1.6], [1.0, 0.75, 0.6, 0.4, 0.2, 0.1, 0.0]]
)
_LEFT_OF_PLANE = np.array([[0.91, 0.95, 1.0, 1.05, 1.15], [1.0, 0.4, 0.2, 0.1, 0.0]])
_LEFT_OF_ROUGHNESS = np.array([[0.9, 1.0, 1.3, 1.6, 2.2, 3.0], [1.0, 0.9, 0.6, 0.35, 0.15, 0.0]])
_LEFT_OF_TOP = np.array([[0.9, 1.0, 1.3, 2.2, 4.0], [1.0, 0.94, 0.85, 0.7, 0.4]])
# In the domain at most so many hazards may be expected unseen in a footprint, and so many rocks, or
# holes, under the pads that would tilt the lander over its limit. Counts of rocks are those of
# `HeightCurve.missed`, three times and more those of the Gaussian DEM.
MOST_HAZARDS = 0.1
MOST_TILTING = 0.1
MOST_SINKING = 0.03
# Near it, with up to so many, fits to all other worlds were low enough; see `bound`.
_NEAR = (1.0, 2.0, 1.0)
# Nor is more of the ground deeper than the first of `_DEPTHS`: whether a pad bridges what gapes
# there depends on widths that no share tells.
MOST_SUNK = 0.016
# A zone is 1.35 times as wide as the lander, and all that stands or gapes in it speaks against it:
# what is called surely unsafe may be safe for the lander itself unless it is so by far.
HOPELESS = 0.01
# Of means over cells of a decimetre nothing is surer than this.
MOST = 0.99
# Of the points in the worlds of the fit, over the roughness limit: more noise would excuse more of
# what stands out of the ground.
MOST_NOISE = 0.12
# See `SiteEvidence.clear_of_pads`.
_KNOWN = 1.5
# The smoothest zones of a map are this share of all.
_SMOOTHEST = 0.1
# Cells on which the mean ground is judged, and the largest that count as seen, m.
_GROUND_BAND = (0.4, 1.6)
# Between these the regression may bend: shares of the limits, decades of ratios and of rocks.
_SLOPES = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 0.95, 1.05, 1.15, 1.3, 1.6, 2.2])
_HEIGHTS = np.array([0.0, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.3, 1.6, 2.2, 4.0])
_SPREADS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.5])
_RATIOS = np.array([-4.0, -3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.0])
_TIPS = np.array([-1.7, -1.4, -1.2, -1.0, -0.8, -0.6, -0.45, -0.3, -0.15, 0.0, 0.2, 0.5, 1.0])
_ROCKS = np.array([-5.0, -4.0, -3.0, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
_COVER = np.log10([1e-5, 1e-4, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.016, 0.03, 0.06, 0.12])
_BENDS = (
    _SLOPES, _HEIGHTS, _HEIGHTS, _HEIGHTS, _TIPS, _TIPS, _SLOPES, _SLOPES, _SPREADS, _SPREADS,
    _RATIOS, _RATIOS, _HEIGHTS, _HEIGHTS, _ROCKS, _ROCKS,
    _ROCKS,
)  # fmt: skip
# Heights, over the limit, above which the share of ground counts.
_ABOVE = np.array([0.3, 0.6, 1.0, 1.6])
_DEPTHS = np.array([0.6, 1.0])
# Intercept, noise, density and its square: nothing is claimed for these.
FREE = 4
RISING = sum(len(knots) - 1 for knots in _BENDS) + (len(_ABOVE) + len(_DEPTHS)) * (len(_COVER) - 1)
COUNT = FREE + RISING


@dataclass(frozen=True)
class SiteEvidence:
    """What the quadtree says of sites (n,); NaN where not judged.

    Attributes
    ----------
    slope, roughness
        Of the lander on the mean ground, worst heading: tangent and height over its limits.
    mesh_slope, fitted_slope
        Of the mesh and of the zone's points, tangents over that of the limit.
    mesh_spread, fitted_spread
        Root mean square distance of the zone's points from these planes, over the limit.
    ratio, near
        Greatest exception ratio in the zone and in the footprint.
    relief, top
        How far a point reaches in the zone and in the footprint, over the limit.
    density, thinnest
        Points on a square metre of the zone, and where they are the thinnest in the footprint.
    curve
        How high the ground stands, from the points and the mission's rock law.
    holes
        How deep it lies.
    doomed
        Where the mean ground is over a limit with its holes filled too: whether legs stand in a
        hole, beside it or over it, a decimetre decides, and ground above it does not hang on that.
    lander
        Geometry and limits.
    noise
        Standard deviation of a point's height, m.
    """

    slope: Array
    roughness: Array
    mesh_slope: Array
    fitted_slope: Array
    mesh_spread: Array
    fitted_spread: Array
    ratio: Array
    near: Array
    relief: Array
    top: Array
    density: Array
    thinnest: Array
    curve: HeightCurve
    holes: HeightCurve
    doomed: BoolArray
    lander: Lander
    noise: float

    @property
    def judged(self) -> BoolArray:
        """Where the whole zone and footprint were seen (n,)."""
        needed = (
            self.slope, self.roughness, self.mesh_slope, self.fitted_slope, self.mesh_spread,
            self.fitted_spread, self.ratio, self.near, self.relief, self.top, self.density,
            self.thinnest,
        )  # fmt: skip
        return np.asarray(np.logical_and.reduce([np.isfinite(a) for a in needed]))

    @property
    def in_domain(self) -> BoolArray:
        """Where few enough rocks and holes can be unseen for the regression to hold (n,).

        Noise, the ground's own holes, and the lander's limit of the slope, must be within those of
        the fit.
        """
        return self._within(MOST_HAZARDS, MOST_TILTING, MOST_SINKING)

    @property
    def near_domain(self) -> BoolArray:
        """Where they are few enough for the regression to be no more than cautious (n,)."""
        return self._within(*_NEAR)

    def _within(self, hazards: float, tilting: float, sinking: float) -> BoolArray:
        noise = self.noise / self.lander.roughness_limit
        sunk = self.holes.at(_DEPTHS[0] * self.lander.roughness_limit)
        steep = self.lander.slope_limit
        if not (noise <= MOST_NOISE and sunk < MOST_SUNK and STEEPEST[0] <= steep <= STEEPEST[1]):
            return np.zeros(len(self.slope), np.bool_)
        with np.errstate(invalid="ignore"):
            few = (self.hazards() <= hazards) & (self.tilting() <= tilting)
            few &= self.sinking() <= sinking
        return np.asarray(self.judged & few)

    def highest(self) -> Array:
        """Return what is rough, by the mean ground or by a point (n,), over the limit."""
        return np.maximum(self.roughness, self.top)

    def raised(self) -> tuple[Array, Array]:
        """Return what of the highest point and of the spread is not noise (n,), over the limit."""
        noise = self.noise / self.lander.roughness_limit
        spread = np.sqrt(np.maximum(self.fitted_spread**2 - noise**2, 0.0))
        return np.maximum(self.top - 3.0 * noise, 0.0), spread

    def tipping(self, height: Array) -> Array:
        """Return how far a pad raised by a height (n,), over the limit, tilts the lander (n,).

        Over what is left of the slope.
        """
        left = np.maximum(1.0 - self.slope, 0.02) * np.tan(self.lander.slope_limit)
        tilt = tilt_of(height * self.lander.roughness_limit, self.lander)
        return np.asarray((tilt + 2e-4) / left)

    def tilting(self) -> Array:
        """Return how many unseen rocks under the pads, at any heading, would tilt it too far."""
        height = tilting_height(self.fitted_slope, self.lander)
        return np.asarray(pad_ring_area(self.lander) * self.curve.missed(height, self.thinnest))

    def clear_of_pads(self) -> Array:
        """Return the chance that no gravel tilts the lander too far, however much (n,).

        As `lunarsim.safety.calibration.clear_of_pads`; 1 where only rocks would that are higher by
        `_KNOWN` than the least of which the regression was told.
        """
        height = least_tilting_height(self.fitted_slope, self.lander)
        found = pad_ring_area(self.lander) * self.curve.careful.missed(height, self.thinnest)
        left = np.where(height < self.curve.gravel_counted, UNCOUNTED, 1.0)
        return np.where(height < _KNOWN * self.curve.counted, left * np.exp(-found), 1.0)

    def sinking(self) -> Array:
        """Return how many unseen holes under the pads would tilt the lander too far."""
        height, width = tilting_height(self.fitted_slope, self.lander), self.lander.pad_diameter
        found = self.holes.sunk(height, self.thinnest, width)
        return np.asarray(pad_ring_area(self.lander) * found)

    def piercing(self) -> Array:
        """Return how many unseen rocks in the footprint rise above what roughness is left."""
        height = (1.0 - self.raised()[0]) * self.lander.roughness_limit
        return np.asarray(footprint_area(self.lander) * self.curve.missed(height, self.thinnest))

    def hazards(self) -> Array:
        """Return how many unseen rocks in the footprint alone would be too high."""
        limit = self.lander.roughness_limit
        return np.asarray(footprint_area(self.lander) * self.curve.missed(limit, self.thinnest))


def evidence_of(
    quadtree: QuadtreeMap,
    selection: Selection,
    zone: float,
    noise: float,
    lander: Lander,
    rocks: RockExpectation,
) -> SiteEvidence:
    """Return what a map and its sites say, for a lander on ground with such rocks expected.

    Parameters
    ----------
    quadtree, selection
        The map, and what a thorough selector with the lander's footprint says of its sites.
    zone
        Half side of the landing zones, m.
    noise
        Standard deviation that is stated of a point's height, m. Where the points spread less, they
        have less: noise that is not there would excuse what stands out of the ground.
    lander, rocks
        Geometry and limits, and what the mission expects.
    """
    s = selection
    risen = rises(quadtree)
    steepest, limit = np.tan(lander.slope_limit), lander.roughness_limit
    seen = sampling(quadtree)
    height, grid = surface(quadtree, *_GROUND_BAND, seen)
    xy = s.position[:, :2]
    slope, roughness = _worst_about(bounded_safety(height, grid, lander), xy)
    solid = without_holes(height, grid.posting, lander.leg_radius)
    own_slope, own_roughness = _worst_about(bounded_safety(solid, grid, lander), xy)
    mesh_slope = np.tan(s.slope) / steepest
    # The standard error of the slope over a square tells the spread about the plane. Points that
    # span no plane have the mesh's.
    fitted_spread = s.slope_sigma * np.sqrt(np.maximum(s.points - 3.0, 0.0) / 6.0) * zone
    spans = np.isfinite(s.fitted)
    noise = min(noise, _least_spread(fitted_spread))
    return SiteEvidence(
        np.tan(slope) / steepest,
        roughness / limit,
        mesh_slope,
        np.where(spans, np.tan(s.fitted) / steepest, mesh_slope),
        s.roughness / limit,
        np.where(spans, fitted_spread, s.roughness) / limit,
        s.ratio,
        s.near,
        s.relief / limit,
        s.top / limit,
        np.nan_to_num(s.points, nan=0.0) / (2.0 * zone) ** 2,
        _thinnest(seen, xy, lander),
        height_curve(risen, noise, limit, rocks.cover, rocks.height_ratio[0]),
        depth_curve(risen, noise, limit, rocks.cover, rocks.height_ratio[0]),
        (own_slope >= lander.slope_limit) | (own_roughness >= limit),
        lander,
        noise,
    )


def _least_spread(spread: Array) -> float:
    """Return how the points of a map's smoothest zones spread about their planes (n,), m."""
    spread = spread[np.isfinite(spread)]
    return float(np.quantile(spread, _SMOOTHEST)) if len(spread) else np.inf


def _thinnest(seen: Sampling, xy: Array, lander: Lander) -> Array:
    """Return the least density of points about places (n, 2), 1/m^2, over the footprint."""
    g = seen.grid
    # What lies in the zone's corners is no part of a round footprint.
    reach = max(1, round(lander.leg_radius / g.posting))
    least = ndimage.minimum_filter(seen.density, 2 * reach + 1, mode="nearest")
    row, col = g.cell(xy)
    return np.asarray(least[np.clip(row, 0, g.rows - 1), np.clip(col, 0, g.cols - 1)])


def _worst_about(safety: SafetyMap, xy: Array) -> tuple[Array, Array]:
    """Return the greatest slope and roughness of the four cells about places (n, 2); or NaN."""
    g = safety.grid
    row, col = g.cell(xy - 0.5 * g.posting)
    slope, rough = np.full(len(xy), -np.inf), np.full(len(xy), -np.inf)
    for i in (0, 1):
        for j in (0, 1):
            at = np.clip(row + i, 0, g.rows - 1), np.clip(col + j, 0, g.cols - 1)
            slope = np.maximum(slope, safety.slope[at])
            rough = np.maximum(rough, safety.roughness[at])
    return slope, rough


def features(evidence: SiteEvidence, where: BoolArray) -> Array:
    """Return what the probability is computed from, at sites chosen by a mask (m, `COUNT`)."""
    n = int(np.count_nonzero(where))
    return np.column_stack((_free(evidence, where), columns(_terms(evidence, where), n)))


def _terms(e: SiteEvidence, where: BoolArray) -> list[Term]:
    """Return what speaks against sites (n,)."""
    point, spread = e.raised()
    values = (
        e.slope, e.roughness, e.highest(), e.top + 2.0 * spread, np.log10(e.tipping(point)),
        np.log10(e.tipping(spread)), e.mesh_slope, e.fitted_slope, e.mesh_spread, e.fitted_spread,
        np.log10(np.maximum(e.ratio, 1e-4)), np.log10(np.maximum(e.near, 1e-4)), e.relief, e.top,
        np.log10(e.tilting() + 1e-6), np.log10(e.piercing() + 1e-6), np.log10(e.sinking() + 1e-6),
    )  # fmt: skip
    shares = np.log10(e.curve.at(_ABOVE * e.lander.roughness_limit))
    own = [Term(v[where], knots) for v, knots in zip(values, _BENDS, strict=True)]
    depths = np.log10(e.holes.at(_DEPTHS * e.lander.roughness_limit))
    return own + [Term(share, _COVER) for share in (*shares, *depths)]


def _free(e: SiteEvidence, where: BoolArray) -> Array:
    """Return what says how well was measured (m, `FREE`)."""
    density = np.log(np.maximum(e.density[where], 0.1) * e.lander.leg_radius**2)
    noise = np.full(len(density), np.log(e.noise / e.lander.roughness_limit + 1e-3))
    return np.column_stack([np.ones(len(density)), noise, density, density**2])


@lru_cache(maxsize=1)
def measured() -> Ensemble:
    """Return the weights measured by `scenarios/lidar_maps/quadtree_calibration.py`."""
    return Ensemble.packaged("lunarsim.onboard.hazards.quadtree", "calibration.json", COUNT, RISING)


def site_safety(evidence: SiteEvidence, model: Ensemble | None = None) -> tuple[Array, BoolArray]:
    """Return the probability that sites are safe (n,), and where it is a frequency (n,).

    Where too many rocks may stand unseen, or it is not surely safe, no more than `bound`; 0 where
    not judged.

    Parameters
    ----------
    evidence
        Of the sites.
    model
        Left out: the packaged one.
    """
    e, known = evidence, evidence.in_domain
    p, claimed = np.zeros(len(e.slope)), known.copy()
    if e.judged.any():
        seen, most = e.judged, ceiling(e)[e.judged]
        odds = (model or measured()).judge(_free(e, seen), _terms(e, seen))
        p[seen] = cautious(odds.low, most, bound(e)[seen], known[seen])
        claimed[seen] &= odds.verdict(most, HOPELESS, e.doomed[seen]).agreed
    return p, claimed


def ceiling(evidence: SiteEvidence) -> Array:
    """Return what the probability cannot exceed, by what was seen (n,).

    Sums of evidence let much that is good make up for one thing that is fatal. Of sites with a
    slope or roughness near the limit or beyond it so few were safe in the worlds of the fit,
    whatever else. Of none more than `MOST`.
    """
    e = evidence
    left = (
        np.interp(e.slope, *_LEFT_OF_SLOPE),
        np.interp(np.maximum(e.mesh_slope, e.fitted_slope), *_LEFT_OF_PLANE),
        np.interp(np.maximum(e.roughness, e.mesh_spread), *_LEFT_OF_ROUGHNESS),
        np.interp(e.top, *_LEFT_OF_TOP),
        e.clear_of_pads(),
    )
    return np.asarray(MOST * np.nan_to_num(np.minimum.reduce(left), nan=0.0))


def bound(evidence: SiteEvidence) -> Array:
    """Return what the probability cannot exceed outside the domain (n,).

    The chance that no unseen rock stands there; near the domain, where the regression still tells
    enough, 1.
    """
    none = np.nan_to_num(np.exp(-evidence.piercing() - evidence.tilting()), nan=0.0)
    return np.asarray(np.where(evidence.near_domain, 1.0, none))
