"""Match LiDAR scans with a prior map, to locate the site frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from lunarsim.messages.measurements import LidarScan
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.corrected_scan import DRIFTED_SCANNER_SIGMAS, CorrectedScan
from lunarsim.onboard.navigation.error_state import UpdateOutcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.inertial import VELOCITY
from lunarsim.onboard.navigation.innovation_monitor import MonitorResult
from lunarsim.onboard.navigation.local_frame import LocalFrame
from lunarsim.onboard.navigation.map_features import MODEL_SIGMA_M, MapFeatures
from lunarsim.onboard.navigation.measurement_processor import FilterContext
from lunarsim.onboard.navigation.place_search import MapMatch, PlaceSearch
from lunarsim.onboard.navigation.registration import (
    MIN_AGREEING_FRACTION,
    MIN_SQUARES,
    REJECTION_PROBABILITY,
    is_good_fit,
    register_scan,
    solve_error,
)
from lunarsim.onboard.navigation.submap import ScanAccumulator
from lunarsim.typing import Array, IntArray

# Factor on the standard deviations in the second fit of a scan that does not match.
_WIDE_FACTOR = 20.0
# Probability to reject a valid fit to the map; partly changed terrain biases it by a few standard
# deviations.
_MAP_REJECTION_PROBABILITY = 1e-3
# Minimum probability of the best place of a search, and standard deviation of a height that is
# derived before the place is known, m.
_MIN_CERTAINTY, _HEIGHT_SIGMA_M = 0.99999, 0.5
# Time between two searches, time without agreement of a large enough scan after which the lock is
# lost, and maximum time over which small scans are accumulated, s.
_SEARCH_S, _LOST_S, _MAX_ACCUMULATION_S = 0.5, 2.0, 5.0
# Maximum rotation of the local frame before a search is restarted, rad.
_MAX_ROTATION_RAD = 0.01
_LEVEL_VELOCITY = np.arange(VELOCITY.start, VELOCITY.start + 2)


@dataclass(frozen=True)
class _MapAlignment:
    """Transformation from the local frame to the map at the start of a search.

    Attributes
    ----------
    rotation, position
        Rotation matrix (3, 3) and offset (3,), m: map coordinates of a local point are ``rotation @
        point + position``.
    azimuth
        Angle of the rotation, rad.
    """

    rotation: Array
    position: Array
    azimuth: float


class MapMatcher:
    """Measurement processor that locates LiDAR scans on a prior map.

    The processor searches the map until the place of the scans is certain ("lock"), then registers
    every scan on the map. The error of a map grid point is the same in every use. The k-th use
    therefore gets the weight 1 / (k (k + 1)), so that all uses together count as one.

    Parameters
    ----------
    context
        State and helpers that the processors share.
    frame
        Transformation between local frame and site frame.
    prior
        Prior map, site frame.

    Attributes
    ----------
    locked
        Whether scans agree with the map.
    """

    def __init__(self, context: FilterContext, frame: LocalFrame, prior: PriorMap) -> None:
        self.context = context
        self.frame = frame
        self.locked = False
        self.prior = prior
        self._accumulator = ScanAccumulator(prior.grid.posting, MIN_SQUARES, _MAX_ACCUMULATION_S)
        self._last_agreement = -np.inf
        self._last_search = -np.inf
        self._before = np.zeros(3)

    @property
    def prior(self) -> PriorMap:
        """Prior map in the site frame.

        Setting another map restarts the search for the place of the scans, and forgets how often
        each grid point has been used.
        """
        return self._features.prior

    @prior.setter
    def prior(self, prior: PriorMap) -> None:
        self._features = MapFeatures(prior)
        self._places = PlaceSearch(self._features)
        self._alignment: _MapAlignment | None = None
        self._uses = np.zeros(prior.grid.shape, np.int32)
        self._variance = self._use_variance(prior, self._uses)

    @property
    def has_located(self) -> bool:
        """Whether scans were located on the prior map at least once."""
        return any(event.name == "lock" for event in self.context.events)

    @property
    def position_sigma(self) -> float:
        """Largest standard deviation of the position on the map over the three axes, m."""
        return float(np.sqrt(np.diag(self.frame.covariance_in_site())[:3].max()))

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool) -> bool:
        """Locate or register a scan on the map; return whether it agrees with the map.

        Without a lock, the scan is added to the search for the place; once the place is certain,
        it is registered at this place. The lock is given up if no scan agrees for 2 s; scans that
        cover too few grid points count as agreeing while the position is certain enough. Nothing
        is done with a scan that an earlier processor has `used`, or with other measurement types;
        the result is then False. `time` is in s.
        """
        if used or not isinstance(measurement, LidarScan):
            return False
        self._before = self.frame.site_to_local.offset
        if not self.locked and self._search(sensor, measurement, time):
            self._lock(time)
        agreed = self._register(sensor, measurement, time)
        if self.locked and time - self._last_agreement > _LOST_S:
            self.locked = False
            self._restart()
            self.context.events.append(NavigationEvent(time, "lock-lost", {"moved": 0.0}))
        return agreed

    def _lock(self, time: float) -> None:
        name = "relock" if self.has_located else "lock"
        self.locked = True
        self._last_agreement = time
        moved = float(np.linalg.norm(self.frame.site_to_local.offset - self._before))
        self.context.events.append(NavigationEvent(time, name, {"moved": moved}))

    # --- fit ------------------------------------------------------------------------------

    def _register(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Update the filter by registering a scan on the map; return whether accepted.

        Without a lock, a scan is registered only if the map was located before and the position is
        certain enough. Small scans are accumulated until they cover enough grid points; until then
        the result is False.
        """
        is_certain = self.has_located and self.position_sigma < self.prior.grid.posting
        if not self.locked and not is_certain:
            return False
        corrected = self._accumulator.take(self.context.correct_scan(sensor, scan), time)
        if corrected is None:
            # A scan that covers too few grid points neither confirms nor contradicts the lock.
            if self.locked and is_certain:
                self._last_agreement = time
            return False
        columns, jacobian = self._site_jacobian(sensor)
        own = self.context.state.covariance_of(columns)
        result, posts = register_scan(
            self.frame.in_site(corrected), self._features, jacobian @ own @ jacobian.T,
            self._variance,
        )  # fmt: skip
        if not is_good_fit(result):
            if self.locked:
                self._check_other_place(sensor, corrected, time)
            return False
        outcome = self._update_with_information(
            sensor, result.information, result.vector, _MAP_REJECTION_PROBABILITY
        )
        if self.locked:
            self.context.record_outcome(sensor, "map", outcome, time)
        if not outcome.is_accepted:
            return False
        self._monitor(sensor, outcome, time)
        self._uses[posts] += 1
        self._variance[posts] = self._use_variance(self.prior, self._uses[posts])
        if not self.locked:
            self._lock(time)
        self._last_agreement = time
        return True

    def _check_other_place(self, sensor: str, corrected: CorrectedScan, time: float) -> None:
        """Check whether a scan that does not fit agrees with the map at another place.

        If it fits nowhere, the terrain has changed, and nothing is done. A scan that fits well,
        but farther away than the errors allow, contradicts the state. Since the lander cannot jump
        between scans, only the variances of the scanner's errors are raised, to cover the offset.
        If the scanner's errors do not explain the offset in later scans either, the monitor
        declares navigation lost.
        """
        columns, jacobian = self._site_jacobian(sensor)
        own = self.context.state.covariance_of(columns)
        wide_covariance = _WIDE_FACTOR**2 * jacobian @ own @ jacobian.T
        in_site = self.frame.in_site(corrected)
        result, _ = register_scan(in_site, self._features, wide_covariance, self._variance)
        if not is_good_fit(result):
            return
        information = jacobian.T @ result.information @ jacobian, jacobian.T @ result.vector
        # A negative gate rejects the information, so that only its distance is evaluated.
        outcome = self.context.state.update_with_information(columns, *information, -1.0)
        if chdtrc(max(outcome.dof, 1), outcome.nis) >= _MAP_REJECTION_PROBABILITY:
            return
        if self._monitor(sensor, outcome, time) is MonitorResult.CONSISTENT:
            return
        scanner = self.context.scanner_indices(sensor)
        middle = np.nanmean(in_site.points(), axis=0)
        offset = float(
            np.abs(in_site.point_jacobian(middle) @ solve_error(result, wide_covariance)).max()
        )
        rotation = offset / float(np.linalg.norm(middle - in_site.position))
        least = np.array([offset, *np.full(3, rotation), 0.0])
        self.context.state.raise_variances(
            scanner, np.maximum(DRIFTED_SCANNER_SIGMAS, least)[: len(scanner)]
        )

    def _monitor(self, sensor: str, outcome: UpdateOutcome, time: float) -> MonitorResult:
        """Record whether a scan fits the map at the estimated place; return the result.

        `outcome` is the outcome of a registration at `time` (s). After a drift or an alarm, the
        variances of the scanner's errors are increased.
        """
        scanner = self.context.scanner_indices(sensor)
        return self.context.aiding.record_outcome(
            sensor, "fits", outcome, scanner, DRIFTED_SCANNER_SIGMAS[: len(scanner)], time
        )

    def _site_jacobian(self, sensor: str) -> tuple[IntArray, Array]:
        """Return which state errors a scan in the site frame depends on, and a Jacobian.

        The errors are given by their indices (k,). The Jacobian (11, k) converts them to the 11
        errors of a `CorrectedScan` in the site frame.
        """
        own = self.context.scanner_indices(sensor)
        out = np.zeros((11, 10 + len(own)))
        out[:6, :10] = self.frame.pose_jacobian()
        out[6:, 10:] = np.eye(5, len(own))
        return np.concatenate((self.frame.pose_columns(), own)), out

    def _update_with_information(
        self, sensor: str, information: Array, vector: Array, min_probability: float
    ) -> UpdateOutcome:
        """Update the filter with information on a scan's errors in the site frame.

        `information` (11, 11) and `vector` (11,) are the information matrix and vector; a
        correction with a smaller chi-squared tail probability than `min_probability` is rejected.
        """
        columns, jacobian = self._site_jacobian(sensor)
        return self.context.state.update_with_information(
            columns,
            jacobian.T @ information @ jacobian,
            jacobian.T @ vector,
            min_probability=min_probability,
        )

    def _use_variance(self, prior: PriorMap, uses: NDArray[np.int32]) -> Array:
        """Return the residual variance of map grid points after earlier uses, m^2.

        For the k-th use of a grid point, it is k (k + 1) times the variance of the map, plus that
        of the comparison; so all uses together count as one. `uses` is the number of earlier uses
        of each grid point, k - 1.
        """
        own = prior.sigma**2 * (uses + 1.0) * (uses + 2.0)
        return np.asarray(own + MODEL_SIGMA_M**2)

    # --- search ---------------------------------------------------------------------------

    def _restart(self) -> None:
        self._places.restart()
        self._alignment = None

    def _align(self) -> _MapAlignment:
        """Return the transformation used by the search, from the local frame to the map.

        It is fixed at the start of a search. If the local frame has rotated by more than 0.01 rad
        since, the search is restarted with the current transformation.
        """
        frame = self.frame
        if (
            self._alignment is not None
            and abs(frame.azimuth - self._alignment.azimuth) > _MAX_ROTATION_RAD
        ):
            self._restart()
        if self._alignment is None:
            self._alignment = _MapAlignment(
                frame.rotation, frame.to_site(np.zeros(3)), frame.azimuth
            )
        return self._alignment

    def _search(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Search the map for the scanned terrain; return whether the place was found.

        The scan is added to the searched terrain; a search is made at most every 0.5 s. If the
        place was found, the filter is updated. If it is not yet certain, only the height may be
        updated, and the result is False. `time` is in s.
        """
        frame = self.frame
        corrected, alignment = self.context.correct_scan(sensor, scan), self._align()
        local = corrected.points()
        self._places.add(local @ alignment.rotation.T + alignment.position)
        if time - self._last_search < _SEARCH_S - 1e-9:
            return False
        self._last_search = time
        middle = np.nanmean(local, axis=0)
        at = frame.to_site(middle)
        # Shift that other measurements have added since the start of the search.
        prior_shift = at - (alignment.rotation @ middle + alignment.position)
        jacobian = frame.in_site(corrected).point_jacobian(at)
        columns, of_state = self._site_jacobian(sensor)
        over = jacobian @ of_state
        p = over @ self.context.state.covariance_of(columns) @ over.T
        speed = float(np.sqrt(self.context.state.covariance_of(_LEVEL_VELOCITY).diagonal().max()))
        match = self._places.search(time, prior_shift[:2], p[:2, :2], speed)
        if match is None:
            return False
        if match.certainty < _MIN_CERTAINTY or match.agreeing_fraction < MIN_AGREEING_FRACTION:
            self._update_height(sensor, jacobian[2], match, float(prior_shift[2]), float(p[2, 2]))
            return False
        information = np.linalg.inv(match.covariance)
        return self._update_with_information(
            sensor, jacobian.T @ information @ jacobian,
            jacobian.T @ information @ (match.shift - prior_shift), REJECTION_PROBABILITY,
        ).is_accepted  # fmt: skip

    def _update_height(
        self,
        sensor: str,
        height_jacobian: Array,
        match: MapMatch,
        prior_shift: float,
        prior_variance: float,
    ) -> None:
        """Update only the height, if the search determines it much better than the prior.

        `height_jacobian` (11,) is the Jacobian of the height with respect to the scan's errors;
        `prior_shift`, m, and `prior_variance`, m^2, are mean and variance of the vertical shift
        before the search. Nothing is done if the search reduces its standard deviation by less
        than a factor of 3.
        """
        # The height offset of the map is common to all searches: use it only once.
        variance = match.vertical_shift_variance + _HEIGHT_SIGMA_M**2
        if 9.0 * variance < prior_variance:
            self._update_with_information(
                sensor, np.outer(height_jacobian, height_jacobian) / variance,
                height_jacobian * (match.vertical_shift - prior_shift) / variance,
                REJECTION_PROBABILITY,
            )  # fmt: skip
