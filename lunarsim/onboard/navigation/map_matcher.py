"""Scans against a prior map: where in the local frame the site lies."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.measurements import LidarScan
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.error_state import Outcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.parts import Shared
from lunarsim.onboard.navigation.place_search import Features, Match, ScanPatch, features_of, search
from lunarsim.onboard.navigation.registration import register
from lunarsim.onboard.navigation.registration_settings import RegistrationSettings
from lunarsim.onboard.navigation.seen_scan import SeenScan

Array = NDArray[np.float64]


class MapMatcher:
    """Finds the place of scans on a map, then fits every scan to it.

    A post's error is the same whenever it is seen, so its k-th use counts 1 / (k (k + 1)) of a
    full one: all uses together never count more than one.

    Parameters
    ----------
    shared
        What the parts share.
    prior
        The map, site frame.
    settings
        Limits of the registration.

    Attributes
    ----------
    locked
        Whether scans agree with the map.
    """

    def __init__(self, shared: Shared, prior: PriorMap, settings: RegistrationSettings) -> None:
        self.shared = shared
        self.prior = prior
        self.settings = settings
        self.locked = False
        self._uses = np.zeros(prior.grid.shape, np.int32)
        self._variance = self._of_uses(prior, self._uses)
        self._agreed = -np.inf
        self._searched = -np.inf
        self._patch: deque[tuple[float, Features]] = deque()
        self._before = np.zeros(3)

    @property
    def found(self) -> bool:
        """Whether the lander has been found on the map at least once."""
        return any(event.name == "lock" for event in self.shared.events)

    @property
    def position_sigma(self) -> float:
        """Greatest standard deviation of the position on the map on an axis, m."""
        return float(np.sqrt(np.diag(self.shared.frame.covariance_in_site())[:3].max()))

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool) -> bool:
        """Find a scan's place on the map; return whether it agreed with it."""
        if used or not isinstance(measurement, LidarScan):
            return False
        self._before = self.shared.frame.shift.offset
        if not self.locked and self._search(sensor, measurement, time):
            self._lock(time)
        agreed = self._register(sensor, measurement, time)
        if self.locked and time - self._agreed > self.settings.lost_s:
            self.locked = False
            self._patch.clear()
            self.shared.events.append(NavigationEvent(time, "lock-lost", {"moved": 0.0}))
        return agreed

    def _in_site(self, sensor: str, scan: LidarScan) -> SeenScan:
        return self.shared.frame.in_site(self.shared.seen(sensor, scan))

    def _lock(self, time: float) -> None:
        name = "relock" if self.found else "lock"
        self.locked = True
        self._agreed = time
        self._patch.clear()
        moved = float(np.linalg.norm(self.shared.frame.shift.offset - self._before))
        self.shared.events.append(NavigationEvent(time, name, {"moved": moved}))

    # --- fit ------------------------------------------------------------------------------

    def _register(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Fit a scan to the map; without a lock only where the state is certain enough for it."""
        s = self.settings
        near = self.found and self.position_sigma < self.prior.grid.posting
        if not self.locked and not near:
            return False
        columns, jacobian = self.shared.site_errors(sensor)
        own = self.shared.state.covariance[np.ix_(columns, columns)]
        result, posts = register(
            self._in_site(sensor, scan), self.prior, jacobian @ own @ jacobian.T, self._variance,
            1.5 * self.prior.sigma**2 + s.model_sigma**2,
        )  # fmt: skip
        if not s.believes(result):
            return False
        outcome = self._inform(sensor, result.information, result.vector, s.map_chance)
        if self.locked:
            self.shared.judge(sensor, "map", outcome, time)
        if not outcome.taken:
            return False
        self._uses[posts] += 1
        self._variance[posts] = self._of_uses(self.prior, self._uses[posts])
        if not self.locked:
            self._lock(time)
        self._agreed = time
        return True

    def _inform(self, sensor: str, information: Array, vector: Array, chance: float) -> Outcome:
        """Take in information (11, 11) on a scan's errors in the site frame."""
        columns, jacobian = self.shared.site_errors(sensor)
        return self.shared.state.inform(
            columns, jacobian.T @ information @ jacobian, jacobian.T @ vector, chance=chance
        )

    def _of_uses(self, prior: PriorMap, uses: NDArray[np.int32]) -> Array:
        """Return the variance of a residual at posts that were compared `uses` times before."""
        own = prior.sigma**2 * (uses + 1.0) * (uses + 2.0)
        return np.asarray(own + self.settings.model_sigma**2)

    # --- search ---------------------------------------------------------------------------

    def _search(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Look for the scans of the last seconds on the map; return whether they were found."""
        s, g = self.settings, self.prior.grid
        seen = self._in_site(sensor, scan)
        self._patch.append((time, features_of(seen.surface(g), s.feature_reach)))
        while self._patch[0][0] < time - s.patch_s:
            self._patch.popleft()
        if time - self._searched < s.search_s - 1e-9:
            return False
        self._searched = time
        patch = ScanPatch.merged([features for _, features in self._patch])
        if patch is None:
            return False
        rows, cols = np.nonzero(patch.known)
        middle = np.array(
            [
                g.x0 + g.posting * (patch.first[1] + cols.mean()),
                g.y0 + g.posting * (patch.first[0] + rows.mean()),
                patch.level[patch.known].mean(),
            ]
        )
        jacobian = seen.point_jacobian(middle)
        columns, of_state = self.shared.site_errors(sensor)
        over = jacobian @ of_state
        p = over @ self.shared.state.covariance[np.ix_(columns, columns)] @ over.T
        match = self._place_of(patch, p[:2, :2])
        if match is None:
            return False
        if match.certainty < s.certainty or match.share < s.least_share:
            self._take_height(sensor, jacobian[2], match, float(p[2, 2]))
            return False
        information = np.linalg.inv(match.covariance)
        return self._inform(
            sensor, jacobian.T @ information @ jacobian, jacobian.T @ information @ match.shift,
            s.chance,
        ).taken  # fmt: skip

    def _place_of(self, patch: ScanPatch, spread: Array) -> Match | None:
        """Look for a patch on the map, as far off as its place is uncertain (2, 2), m^2."""
        s, g = self.settings, self.prior.grid
        reach = int(np.ceil(3.5 * np.sqrt(spread.diagonal().max()) / g.posting))
        window = _window(
            self.prior.elevation, patch.first[0] - reach, patch.first[1] - reach,
            patch.known.shape[0] + 2 * reach, patch.known.shape[1] + 2 * reach,
        )  # fmt: skip
        variance = 1.5 * self.prior.sigma**2 + s.model_sigma**2
        return search(
            patch, window, g.posting, variance, spread, np.full(2, -reach * g.posting),
            reach=s.feature_reach,
        )  # fmt: skip

    def _take_height(self, sensor: str, row: Array, match: Match, before: float) -> None:
        """Take in the height alone, where it is known much better than before: level ground."""
        # The map's own level over the patch is the same in every search: counted once, not again.
        variance = match.up_variance + self.settings.level_sigma**2
        if (
            9.0 * variance < before
            and self._inform(
                sensor,
                np.outer(row, row) / variance,
                row * match.up / variance,
                self.settings.chance,
            ).taken
        ):
            # Earlier scans lie where the lander was thought to be.
            self._patch.clear()


def _window(elevation: Array, row: int, col: int, rows: int, cols: int) -> Array:
    """Return a part of a map, NaN where it lies off the map."""
    out = np.full((rows, cols), np.nan)
    r0, r1 = max(row, 0), min(row + rows, elevation.shape[0])
    c0, c1 = max(col, 0), min(col + cols, elevation.shape[1])
    if r0 < r1 and c0 < c1:
        out[r0 - row : r1 - row, c0 - col : c1 - col] = elevation[r0:r1, c0:c1]
    return out
