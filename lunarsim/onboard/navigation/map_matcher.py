"""Scans against a prior map: where in the local frame the site lies."""

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
from lunarsim.onboard.navigation.gathering import Gathering
from lunarsim.onboard.navigation.inertial import VELOCITY
from lunarsim.onboard.navigation.local_frame import LocalFrame
from lunarsim.onboard.navigation.map_features import MapFeatures
from lunarsim.onboard.navigation.parts import Shared
from lunarsim.onboard.navigation.place_search import Match, PlaceSearch
from lunarsim.onboard.navigation.registration import register, solved
from lunarsim.onboard.navigation.registration_settings import RegistrationSettings
from lunarsim.onboard.navigation.seen_scan import LET_GO, SeenScan
from lunarsim.onboard.navigation.watch import Verdict

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# A scan that does not fit is tried with deviations so many times larger.
_LOOSE = 20.0
# The local frame may turn by so much before a search begins anew, rad.
_TURNED = 0.01
_LEVEL_VELOCITY = np.arange(VELOCITY.start, VELOCITY.start + 2)


@dataclass(frozen=True)
class _Laid:
    """How the local frame was laid on the map when a search began.

    Attributes
    ----------
    rotation, position
        Map coordinates of a local point are ``rotation @ point + position``.
    azimuth
        Of the rotation, rad.
    """

    rotation: Array
    position: Array
    azimuth: float


class MapMatcher:
    """Finds the place of scans on a map, then fits every scan to it.

    A post's error is the same whenever it is seen, so its k-th use counts 1 / (k (k + 1)) of a
    full one: all uses together never count more than one.

    Parameters
    ----------
    shared
        What the parts share.
    frame
        Where the site frame lies in the local one.
    prior
        The map, site frame.
    settings
        Limits of the registration.

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
        """The map, site frame; another one begins without a search or a post's use."""
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
        """Whether the lander has been found on the map at least once."""
        return any(event.name == "lock" for event in self.shared.events)

    @property
    def position_sigma(self) -> float:
        """Greatest standard deviation of the position on the map on an axis, m."""
        return float(np.sqrt(np.diag(self.frame.covariance_in_site())[:3].max()))

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool) -> bool:
        """Find a scan's place on the map; return whether it agreed with it."""
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
        """Fit a scan to the map; without a lock only where the state is certain enough for it."""
        s = self.settings
        near = self.found and self.position_sigma < self.prior.grid.posting
        if not self.locked and not near:
            return False
        seen = self._gathering.take(self.shared.seen(sensor, scan), time)
        if seen is None:
            # A scan that covers too few posts speaks neither for nor against the lock.
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
        """Watch a scan that fits the map, but not where it is taken to lie on it.

        One that fits nowhere about has met ground that has changed: it tells of nothing else. One
        that fits as a whole, farther off than errors reach, contradicts the state. A lander does
        not jump from scan to scan, so the scanner's errors alone are let go, as far as it is off;
        where that explains nothing, navigation is lost.
        """
        columns, jacobian = self._errors(sensor)
        own = self.shared.state.own(columns)
        loose = _LOOSE**2 * jacobian @ own @ jacobian.T
        in_site = self.frame.in_site(seen)
        result, _ = register(in_site, self._features, loose, self._variance)
        if not self.settings.believes(result):
            return
        told = jacobian.T @ result.information @ jacobian, jacobian.T @ result.vector
        # Nothing is taken in: with a gate below any distance it is only told.
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
        """Watch whether scans that fit the map fit it where they are taken to lie."""
        scanner = self.shared.scanner(sensor)
        return self.shared.aids.judge(
            sensor, "fits", outcome, scanner, LET_GO[: len(scanner)], time
        )

    def _errors(self, sensor: str) -> tuple[Index, Array]:
        """Return on what of the state (k,) a scan's errors depend, and how (11, k), site frame."""
        own = self.shared.scanner(sensor)
        out = np.zeros((11, 10 + len(own)))
        out[:6, :10] = self.frame.pose_jacobian()
        out[6:, 10:] = np.eye(5, len(own))
        return np.concatenate((self.frame.pose_columns(), own)), out

    def _inform(self, sensor: str, information: Array, vector: Array, chance: float) -> Outcome:
        """Take in information (11, 11) on a scan's errors in the site frame."""
        columns, jacobian = self._errors(sensor)
        return self.shared.state.inform(
            columns, jacobian.T @ information @ jacobian, jacobian.T @ vector, chance=chance
        )

    def _of_uses(self, prior: PriorMap, uses: NDArray[np.int32]) -> Array:
        """Return the variance of a residual at posts that were compared `uses` times before."""
        own = prior.sigma**2 * (uses + 1.0) * (uses + 2.0)
        return np.asarray(own + self.settings.model_sigma**2)

    # --- search ---------------------------------------------------------------------------

    def _restart(self) -> None:
        self._places.restart()
        self._laid = None

    def _lay(self) -> _Laid:
        """Return how the local frame is laid on the map for the search, afresh if it has turned."""
        frame = self.frame
        if self._laid is not None and abs(frame.azimuth - self._laid.azimuth) > _TURNED:
            self._restart()
        if self._laid is None:
            self._laid = _Laid(frame.rotation, frame.to_site(np.zeros(3)), frame.azimuth)
        return self._laid

    def _search(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Look for what was scanned on the map; return whether it was found."""
        s, frame = self.settings, self.frame
        seen, laid = self.shared.seen(sensor, scan), self._lay()
        local = seen.points()
        self._places.add(local @ laid.rotation.T + laid.position)
        if time - self._searched < s.search_s - 1e-9:
            return False
        self._searched = time
        middle = np.nanmean(local, axis=0)
        at = frame.to_site(middle)
        # What the rest of navigation has learnt of the place since the frame was laid on the map.
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
        """Take in the height alone, where it is known much better than before: level ground."""
        # The map's own level over the patch is the same in every search: counted once, not again.
        variance = match.up_variance + self.settings.level_sigma**2
        if 9.0 * variance < before:
            self._inform(
                sensor, np.outer(row, row) / variance, row * (match.up - known) / variance,
                self.settings.chance,
            )  # fmt: skip
