"""Match LiDAR scans with a prior map, to locate the site frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from lunarsim.messages.measurements import LidarScan
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.error_state import Outcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.scan_accumulator import Gathering
from lunarsim.onboard.navigation.inertial import VELOCITY
from lunarsim.onboard.navigation.local_frame import LocalFrame
from lunarsim.onboard.navigation.map_features import MapFeatures
from lunarsim.onboard.navigation.measurement_processor import Shared
from lunarsim.onboard.navigation.place_search import Match, PlaceSearch
from lunarsim.onboard.navigation.registration import register, solved
from lunarsim.onboard.navigation.registration_settings import RegistrationSettings
from lunarsim.onboard.navigation.seen_scan import LET_GO, SeenScan
from lunarsim.onboard.navigation.innovation_monitor import Verdict

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Factor on the standard deviations in the second fit of a scan that does not match.
_LOOSE = 20.0
# Maximum rotation of the local frame before a search is restarted, rad.
_TURNED = 0.01
_LEVEL_VELOCITY = np.arange(VELOCITY.start, VELOCITY.start + 2)


@dataclass(frozen=True)
class _Laid:
    """Transformation from the local frame to the map at the start of a search.

    Attributes
    ----------
    rotation, position
        Map coordinates of a local point are ``rotation @ point + position``.
    azimuth
        Angle of the rotation, rad.
    """

    rotation: Array
    position: Array
    azimuth: float


class MapMatcher:
    """Search for the place of scans on a map, then register every scan on it.

    The error of a map post is the same in every use. Its k-th use therefore gets the weight
    1 / (k (k + 1)), so that all uses together count as one.

    Parameters
    ----------
    shared
        State and helpers that the processors share.
    frame
        Transformation between local frame and site frame.
    prior
        Prior map, site frame.
    settings
        Settings of the registration.

    Attributes
    ----------
    locked
        Whether scans agree with the map.
    """

    def __init__(
        self, shared: Shared, frame: LocalFrame, prior: PriorMap, settings: RegistrationSettings
    ) -> None:
        self.shared = shared
        self.frame = frame
        self.settings = settings
        self.locked = False
        self.prior = prior
        self._gathering = Gathering(prior.grid.posting, settings.least_squares, settings.gather_s)
        self._agreed = -np.inf
        self._searched = -np.inf
        self._before = np.zeros(3)

    @property
    def prior(self) -> PriorMap:
        """Prior map, site frame; setting another map resets the search and the use counts."""
        return self._features.prior

    @prior.setter
    def prior(self, prior: PriorMap) -> None:
        self._features = MapFeatures(prior)
        self._places = PlaceSearch(self._features)
        self._laid: _Laid | None = None
        self._uses = np.zeros(prior.grid.shape, np.int32)
        self._variance = self._of_uses(prior, self._uses)

    @property
    def found(self) -> bool:
        """Whether a scan was located on the map at least once."""
        return any(event.name == "lock" for event in self.shared.events)

    @property
    def position_sigma(self) -> float:
        """Largest standard deviation of the position on the map over the three axes, m."""
        return float(np.sqrt(np.diag(self.frame.covariance_in_site())[:3].max()))

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool) -> bool:
        """Search or register a scan on the map; return whether it agrees with the map."""
        if used or not isinstance(measurement, LidarScan):
            return False
        self._before = self.frame.shift.offset
        if not self.locked and self._search(sensor, measurement, time):
            self._lock(time)
        agreed = self._register(sensor, measurement, time)
        if self.locked and time - self._agreed > self.settings.lost_s:
            self.locked = False
            self._restart()
            self.shared.events.append(NavigationEvent(time, "lock-lost", {"moved": 0.0}))
        return agreed

    def _lock(self, time: float) -> None:
        name = "relock" if self.found else "lock"
        self.locked = True
        self._agreed = time
        moved = float(np.linalg.norm(self.frame.shift.offset - self._before))
        self.shared.events.append(NavigationEvent(time, name, {"moved": moved}))

    # --- fit ------------------------------------------------------------------------------

    def _register(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Register a scan; without a lock only if the position is certain enough."""
        s = self.settings
        near = self.found and self.position_sigma < self.prior.grid.posting
        if not self.locked and not near:
            return False
        seen = self._gathering.take(self.shared.seen(sensor, scan), time)
        if seen is None:
            # A scan that covers too few posts is no evidence for or against the lock.
            if self.locked and near:
                self._agreed = time
            return False
        columns, jacobian = self._errors(sensor)
        own = self.shared.state.own(columns)
        result, posts = register(
            self.frame.in_site(seen), self._features, jacobian @ own @ jacobian.T,
            self._variance,
        )  # fmt: skip
        if not s.believes(result):
            if self.locked:
                self._judge_elsewhere(sensor, seen, time)
            return False
        outcome = self._inform(sensor, result.information, result.vector, s.map_chance)
        if self.locked:
            self.shared.judge(sensor, "map", outcome, time)
        if not outcome.taken:
            return False
        self._watch(sensor, outcome, time)
        self._uses[posts] += 1
        self._variance[posts] = self._of_uses(self.prior, self._uses[posts])
        if not self.locked:
            self._lock(time)
        self._agreed = time
        return True

    def _judge_elsewhere(self, sensor: str, seen: SeenScan, time: float) -> None:
        """Monitor a scan that agrees with the map only at another place.

        A scan that fits nowhere has met changed terrain, and gives no further information. A scan
        that fits well, but farther away than the errors allow, contradicts the state. Since the
        lander cannot jump between scans, only the variances of the scanner's errors are raised, to
        cover the offset. If this does not explain it, navigation is lost.
        """
        columns, jacobian = self._errors(sensor)
        own = self.shared.state.own(columns)
        loose = _LOOSE**2 * jacobian @ own @ jacobian.T
        in_site = self.frame.in_site(seen)
        result, _ = register(in_site, self._features, loose, self._variance)
        if not self.settings.believes(result):
            return
        told = jacobian.T @ result.information @ jacobian, jacobian.T @ result.vector
        # A negative gate rejects the information, so that only its distance is evaluated.
        outcome = self.shared.state.inform(columns, *told, -1.0)
        if chdtrc(max(outcome.degrees, 1), outcome.nis) >= self.settings.map_chance:
            return
        if self._watch(sensor, outcome, time) is Verdict.WELL:
            return
        scanner = self.shared.scanner(sensor)
        middle = np.nanmean(in_site.points(), axis=0)
        off = float(np.abs(in_site.point_jacobian(middle) @ solved(result, loose)).max())
        turned = off / float(np.linalg.norm(middle - in_site.position))
        least = np.array([off, *np.full(3, turned), 0.0])
        self.shared.state.let_go(scanner, np.maximum(LET_GO, least)[: len(scanner)])

    def _watch(self, sensor: str, outcome: Outcome, time: float) -> Verdict:
        """Monitor whether scans fit the map at the estimated place."""
        scanner = self.shared.scanner(sensor)
        return self.shared.aids.judge(
            sensor, "fits", outcome, scanner, LET_GO[: len(scanner)], time
        )

    def _errors(self, sensor: str) -> tuple[Index, Array]:
        """Return state indices (k,) and Jacobian (11, k) of a scan's site-frame errors."""
        own = self.shared.scanner(sensor)
        out = np.zeros((11, 10 + len(own)))
        out[:6, :10] = self.frame.pose_jacobian()
        out[6:, 10:] = np.eye(5, len(own))
        return np.concatenate((self.frame.pose_columns(), own)), out

    def _inform(self, sensor: str, information: Array, vector: Array, chance: float) -> Outcome:
        """Update with information (11, 11) on a scan's errors in the site frame."""
        columns, jacobian = self._errors(sensor)
        return self.shared.state.inform(
            columns, jacobian.T @ information @ jacobian, jacobian.T @ vector, chance=chance
        )

    def _of_uses(self, prior: PriorMap, uses: NDArray[np.int32]) -> Array:
        """Return the variance of a residual at posts with a number of earlier uses, m^2."""
        own = prior.sigma**2 * (uses + 1.0) * (uses + 2.0)
        return np.asarray(own + self.settings.model_sigma**2)

    # --- search ---------------------------------------------------------------------------

    def _restart(self) -> None:
        self._places.restart()
        self._laid = None

    def _lay(self) -> _Laid:
        """Return the transformation of the search; restart it after a large rotation."""
        frame = self.frame
        if self._laid is not None and abs(frame.azimuth - self._laid.azimuth) > _TURNED:
            self._restart()
        if self._laid is None:
            self._laid = _Laid(frame.rotation, frame.to_site(np.zeros(3)), frame.azimuth)
        return self._laid

    def _search(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Search the map for the scanned terrain; return whether the place was found."""
        s, frame = self.settings, self.frame
        seen, laid = self.shared.seen(sensor, scan), self._lay()
        local = seen.points()
        self._places.add(local @ laid.rotation.T + laid.position)
        if time - self._searched < s.search_s - 1e-9:
            return False
        self._searched = time
        middle = np.nanmean(local, axis=0)
        at = frame.to_site(middle)
        # Shift that other measurements have added since the start of the search.
        known = at - (laid.rotation @ middle + laid.position)
        jacobian = frame.in_site(seen).point_jacobian(at)
        columns, of_state = self._errors(sensor)
        over = jacobian @ of_state
        p = over @ self.shared.state.own(columns) @ over.T
        speed = float(np.sqrt(self.shared.state.own(_LEVEL_VELOCITY).diagonal().max()))
        match = self._places.search(time, known[:2], p[:2, :2], speed)
        if match is None:
            return False
        if match.certainty < s.certainty or match.share < s.least_share:
            self._take_height(sensor, jacobian[2], match, float(known[2]), float(p[2, 2]))
            return False
        information = np.linalg.inv(match.covariance)
        return self._inform(
            sensor, jacobian.T @ information @ jacobian,
            jacobian.T @ information @ (match.shift - known), s.chance,
        ).taken  # fmt: skip

    def _take_height(
        self, sensor: str, row: Array, match: Match, known: float, before: float
    ) -> None:
        """Update the height only, if the search determines it much better than the prior."""
        # The level of the map is common to all searches: the strong condition uses it only once.
        variance = match.up_variance + self.settings.level_sigma**2
        if 9.0 * variance < before:
            self._inform(
                sensor, np.outer(row, row) / variance, row * (match.up - known) / variance,
                self.settings.chance,
            )  # fmt: skip
