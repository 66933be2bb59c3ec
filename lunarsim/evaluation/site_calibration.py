"""Refit the last calibration stage to a scenario's sites, and cross-validate it.

Cross-validation is by flight.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.evaluation.reliability import EDGES, reliability
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.calibrated_safety import site_probability
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM, MapEvidence
from lunarsim.onboard.calibration.scenario_calibration import (
    MIN_SITES_PER_CLASS,
    ScenarioCalibration,
    has_enough_sites,
)
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.world.truth import TerrainTruth

_CONFIDENT_P = 0.95
_RESAMPLES = 2000


@dataclass(frozen=True)
class SiteSamples:
    """Random sites of hazard maps with features and true safety (n,), for calibration.

    Attributes
    ----------
    flight
        Index of the flight of each site.
    log_odds
        Minimum log odds of safety over the ensemble of regressions supplied with lunarsim.
    agreed
        Whether these regressions agree that the site is almost certainly safe or unsafe.
    ceiling
        Upper bound of the probability of safety from observed slope and roughness.
    clear
        Probability that no undetected rock lies under the pads.
    bound
        Upper bound of the probability of safety outside the domain of the regressions.
    known
        Whether the site is inside that domain.
    hazards, tilting
        Expected numbers of undetected rocks above the roughness limit and of undetected rocks that
        tilt the lander too far.
    noise, spacing
        Noise divided by the roughness limit, and sample spacing divided by the leg radius.
    safe
        Whether the site is safe according to the exact terrain.
    """

    flight: IntArray
    log_odds: Array
    agreed: BoolArray
    ceiling: Array
    clear: Array
    bound: Array
    known: BoolArray
    hazards: Array
    tilting: Array
    noise: Array
    spacing: Array
    safe: BoolArray

    def __len__(self) -> int:
        """Return the number of sites."""
        return len(self.safe)

    @classmethod
    def of(
        cls, evidence: MapEvidence, mask: BoolArray, safe: BoolArray, flight: int
    ) -> SiteSamples:
        """Collect the calibration data of selected sites of one hazard map.

        Parameters
        ----------
        evidence
            Inputs of the safety calibration at each cell of the map.
        mask, safe
            Which cells to take as sites, and whether each cell is safe (rows, cols).
        flight
            Index of the flight.
        """
        n = int(mask.sum())
        e = evidence
        odds = e.log_odds_bounds(mask, GAUSSIAN_DEM.packaged)
        most, clear = e.observed_terrain_bound()[mask], e.p_no_rock_under_pads()[mask]
        return cls(
            np.full(n, flight, np.int64),
            odds.low,
            odds.estimate(np.minimum(most, clear)).agreed,
            most,
            clear,
            e.outside_domain_bound()[mask],
            e.in_domain[mask],
            e.expected_hazards[mask],
            e.expected_tilt_violations[mask],
            np.full(n, e.noise_ratio),
            np.full(n, e.spacing_ratio),
            safe[mask],
        )

    @classmethod
    def joined(cls, parts: list[SiteSamples]) -> SiteSamples:
        """Concatenate the sites of several samples (at least one)."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))

    def at(self, mask: BoolArray) -> SiteSamples:
        """Return the sites that a mask (n,) selects."""
        return SiteSamples(*(getattr(self, f.name)[mask] for f in fields(self)))

    def domain(self) -> CalibrationDomain:
        """Return the calibration domain: the range of site features of these sites.

        Sites outside the domain of the regressions supplied with lunarsim are included only if
        there are enough of them for a fit.
        """
        s = self if has_enough_sites(self.safe[~self.known]) else self.at(self.known)
        return CalibrationDomain.of(s.hazards, s.tilting, s.noise, s.spacing)

    def inside(self, domain: CalibrationDomain) -> BoolArray:
        """Return which sites lie in a domain of a calibration (n,).

        The features are expected undetected rocks, noise and sample spacing.
        """
        few = domain.is_within_counts(self.hazards, self.tilting)
        return np.asarray(few & domain.is_within_measurements(self.noise, self.spacing))

    def probability(self, refit: ScenarioCalibration | None = None) -> Array:
        """Return p_safe of the sites (n,) by the calibration supplied with lunarsim.

        With `refit`, a calibration fitted to a scenario, this calibration is used.
        """
        covered = self.known if refit is None else self.inside(refit.domain)
        return site_probability(
            GAUSSIAN_DEM, self.log_odds, self.ceiling, self.clear, self.bound, self.known, covered,
            refit,
        )  # fmt: skip

    def fitted(self, lander: Lander) -> ScenarioCalibration:
        """Return a calibration whose last stage is fitted to these sites.

        Only sites in the domain that `domain` returns are used.

        Raises
        ------
        InputError
            If there are not enough safe and unsafe sites.
        """
        check_site_counts(self)
        domain = self.domain()
        s = self.at(self.inside(domain))
        return ScenarioCalibration.fit(
            s.log_odds, s.safe, s.known, domain, lander, GAUSSIAN_DEM.packaged
        )


def sample_sites(
    evidence: MapEvidence,
    truth: TerrainTruth,
    error: ArrayLike,
    count: int,
    flight: int,
    rng: np.random.Generator,
) -> SiteSamples:
    """Sample sites of a hazard map at random, where observed and with known truth.

    Parameters
    ----------
    evidence, truth
        Data of the hazard map, and exact landing safety of the terrain.
    error
        Map coordinates minus true coordinates (3,), m.
    count
        Maximum number of sites.
    flight, rng
        Index of the flight, and random generator.
    """
    grid = evidence.horizontal_plane.grid
    xy = grid.centres() - np.asarray(error)[:2]
    where, safe = (np.zeros(grid.shape, np.bool_) for _ in range(2))
    order = rng.permutation(np.flatnonzero(evidence.observed))
    # The truth of a site takes long, so that only as many sites as needed are evaluated.
    for start in range(0, len(order), count):
        some = order[start : start + count]
        some = some[truth.is_known_at(xy.reshape(-1, 2)[some])][: count - int(where.sum())]
        where.ravel()[some] = True
        if where.sum() == count:
            break
    safe[where] = truth.is_safe_at(xy[where])
    return SiteSamples.of(evidence, where, safe, flight)


@dataclass(frozen=True)
class ProbabilityQuality:
    """Accuracy of predicted safety probabilities on sites of maps.

    Arrays hold a value and the ends of its 95 % interval (3,).

    Attributes
    ----------
    sites
        Number of sites in the domain.
    share
        Fraction of all sites that lie in the domain.
    safe
        Observed fraction of safe sites.
    ece, skill
        Expected calibration error, and Brier skill score relative to the base rate.
    confident_sites
        Number of sites with p > 0.95.
    bias
        Bias of the sites with p > 0.95: mean p minus observed fraction of safe sites.
    """

    sites: int
    share: Array
    safe: Array
    ece: Array
    skill: Array
    confident_sites: int
    bias: Array

    def plain(self) -> dict[str, float | None]:
        """Return the metrics by name without intervals; None for values not finite."""
        found = {"sites": float(self.sites), "confident_sites": float(self.confident_sites)}
        found |= {n: float(getattr(self, n)[0]) for n in ("share", "safe", "ece", "skill", "bias")}
        return {name: value if np.isfinite(value) else None for name, value in found.items()}


@dataclass(frozen=True)
class CalibrationComparison:
    """Accuracy of p_safe before and after a refit, on the same sites.

    Attributes
    ----------
    packaged, refit
        Accuracy of the calibration supplied with lunarsim, and of the refitted calibration.
    gain
        Brier score of the supplied calibration minus the Brier score of the refit, and the ends of
        its 95 % interval (3,).
    """

    packaged: ProbabilityQuality
    refit: ProbabilityQuality
    gain: Array

    @property
    def better(self) -> bool:
        """Whether the Brier score of the refit is better, significant at 95 %."""
        return bool(self.gain[1] > 0.0)


@dataclass(frozen=True)
class CrossValidation:
    """Cross-validated accuracy of a refit: fits exclude the flight under test.

    Attributes
    ----------
    packaged_domain
        Comparison on the sites in the domain of the regressions supplied with lunarsim, if these
        regressions agree.
    refit_domain
        Comparison on the sites in the domain of the refit.
    """

    packaged_domain: CalibrationComparison
    refit_domain: CalibrationComparison


def cross_validate(
    sites: SiteSamples, flights: int, lander: Lander, rng: np.random.Generator
) -> CrossValidation:
    """Cross-validate a refitted calibration: test each flight by a fit to all others.

    Parameters
    ----------
    sites
        Sites of all flights.
    flights
        Number of flights, including those without a site.
    lander
        Lander for which the sites were classified as safe or unsafe.
    rng
        Random generator that resamples flights for the intervals.

    Raises
    ------
    InputError
        If there are not enough safe and unsafe sites without one of the flights.
    """
    after, inside = np.zeros(len(sites)), np.zeros(len(sites), np.bool_)
    for flight in np.unique(sites.flight):
        mine = sites.flight == flight
        refit = sites.at(~mine).fitted(lander)
        kept = sites.at(mine)
        after[mine], inside[mine] = kept.probability(refit), kept.inside(refit.domain)
    before = sites.probability()
    drawn = rng.multinomial(flights, np.full(flights, 1.0 / flights), _RESAMPLES)
    weights = np.vstack((np.ones(flights), drawn)).astype(np.float64)
    claimed = sites.known & sites.agreed
    groups = (
        _compare_probabilities(sites, before, after, where, weights) for where in (claimed, inside)
    )
    return CrossValidation(*groups)


def check_site_counts(sites: SiteSamples) -> None:
    """Raise `InputError` if too few safe or unsafe sites are available for a fit.

    There must be enough safe and enough unsafe sites inside the domain of the regressions supplied
    with lunarsim, or enough of each outside this domain.
    """
    safe, known = sites.safe, sites.known
    if not (has_enough_sites(safe[known]) or has_enough_sites(safe[~known])):
        raise InputError(
            "sites", len(safe),
            f"must include {MIN_SITES_PER_CLASS} safe and {MIN_SITES_PER_CLASS} unsafe sites, also "
            f"without any one flight, but {safe.sum()} of {len(safe)} are safe",
            "Use more flights, or a scenario with both kinds of terrain.", show_value=False,
        )  # fmt: skip


def _compare_probabilities(
    sites: SiteSamples, before: Array, after: Array, mask: BoolArray, flight_weights: Array
) -> CalibrationComparison:
    """Compare the accuracy of two probabilities (n,) on the sites of a mask (n,).

    `flight_weights` (resamples, flights) are the numbers of times that each bootstrap resample
    contains each flight; the first row is the original sample of ones.
    """
    flights = flight_weights.shape[1]
    score = [(p - sites.safe) ** 2 for p in (before, after)]
    gain = _sum_per_flight(sites.flight[mask], (score[0] - score[1])[mask], flights)
    with np.errstate(invalid="ignore"):
        gains = (flight_weights @ gain) / (
            flight_weights @ _sum_per_flight(sites.flight[mask], None, flights)
        )
    return CalibrationComparison(
        _compute_quality(sites, before, mask, flight_weights),
        _compute_quality(sites, after, mask, flight_weights),
        _interval(gains),
    )


def _compute_quality(
    sites: SiteSamples, p: Array, mask: BoolArray, flight_weights: Array
) -> ProbabilityQuality:
    """Compute the accuracy of probabilities `p` (n,) on the sites of a mask (n,).

    `flight_weights` (resamples, flights) are the numbers of times that each bootstrap resample
    contains each flight, as in `_compare_probabilities`.
    """
    flights = flight_weights.shape[1]
    s, p = sites.at(mask), p[mask]
    confident = p > _CONFIDENT_P

    def total(values: Array | BoolArray | None, among: BoolArray | None = None) -> Array:
        at = s.flight if among is None else s.flight[among]
        given = values if values is None or among is None else values[among]
        sums: Array = flight_weights @ _sum_per_flight(at, given, flights)
        return sums

    bins = np.array(
        [reliability(p[s.flight == f], s.safe[s.flight == f], EDGES) for f in range(flights)]
    )
    table = np.tensordot(flight_weights, bins, axes=1)
    number, safe = total(None), total(s.safe)
    with np.errstate(invalid="ignore", divide="ignore"):
        base = safe / number
        spread = base * (1.0 - base)
        skill = 1.0 - total((p - s.safe) ** 2) / number / np.where(spread > 0.0, spread, np.nan)
        gap = total(p - s.safe, confident) / total(None, confident)
        share = number / (flight_weights @ _sum_per_flight(sites.flight, None, flights))
        ece = np.abs(table[..., 1] - table[..., 2]).sum(axis=1) / number
    return ProbabilityQuality(
        len(s), _interval(share), _interval(base), _bias_corrected_interval(ece), _interval(skill),
        int(confident.sum()), _interval(gap),
    )  # fmt: skip


def _sum_per_flight(flight: IntArray, values: Array | BoolArray | None, flights: int) -> Array:
    """Return the sum of the values (n,) of each flight (flights,).

    `flight` (n,) are the indices of the flights; if `values` is None, the number of elements of
    each flight is returned.
    """
    return np.bincount(flight, weights=values, minlength=flights).astype(np.float64)


def _interval(resampled: Array) -> Array:
    """Return a statistic and the ends of its 95 % bootstrap interval (3,).

    `resampled` holds the statistic of the original sample, then those of the resamples.
    """
    rest = resampled[1:][np.isfinite(resampled[1:])]
    ends = np.quantile(rest, [0.025, 0.975]) if rest.size else np.full(2, np.nan)
    return np.array([resampled[0], *ends])


def _bias_corrected_interval(resampled: Array) -> Array:
    """Return a statistic and its bootstrap interval, corrected for resampling bias.

    `resampled` holds the statistic of the original sample, then those of the resamples. For a
    statistic that is non-negative and increases with noise, such as the calibration error,
    resampling adds noise. The interval is therefore shifted back by the mean increase.
    """
    value, low, high = _interval(resampled)
    rest = resampled[1:][np.isfinite(resampled[1:])]
    added = float(rest.mean() - value) if rest.size else 0.0
    return np.array([value, max(low - added, 0.0), max(high - added, 0.0)])


def with_quality(
    refit: ScenarioCalibration, cross_validation: CrossValidation
) -> ScenarioCalibration:
    """Return a copy of a calibration that also stores its cross-validated accuracy.

    `refit` is the calibration; the accuracy of the supplied calibration is stored too.
    """
    groups = {
        "packaged_domain": cross_validation.packaged_domain,
        "refit_domain": cross_validation.refit_domain,
    }
    return replace(
        refit,
        before={name: group.packaged.plain() for name, group in groups.items()},
        after={name: group.refit.plain() for name, group in groups.items()},
    )
