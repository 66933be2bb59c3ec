"""LiDAR-inertial navigation relative to a map (quadtree paper, section 3)."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.frames import Shift, normalised, quat_multiply
from lunarsim.grid import Grid
from lunarsim.messages.measurements import (
    InertialSamples,
    LidarScan,
)
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.aids import Aids, LevelGround, blocks_of
from lunarsim.onboard.navigation.arrivals import Arrivals
from lunarsim.onboard.navigation.error_state import POSE, ErrorState
from lunarsim.onboard.navigation.estimate import Estimate, NavigationEvent
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.place_search import Features, Match, ScanPatch, features_of, search
from lunarsim.onboard.navigation.registration import (
    Fit,
    Surface,
    fit,
    point_jacobian,
    pose_jacobian,
    register,
    surface_of,
)
from lunarsim.onboard.navigation.watch import Watch

Array = NDArray[np.float64]

# The pose at the scan kept for odometry, in the error state.
_KEY = "key"
# No return comes from farther, m.
_FARTHEST = 20_000.0


@dataclass(frozen=True)
class RegistrationSettings:
    """How scans are compared with the map and with each other.

    Attributes
    ----------
    model_sigma
        What else sets a scan's mean over a post's square apart from the post: rocks that hide the
        ground behind them, points that lie unevenly, m.
    least_squares
        Fewest squares for a registration.
    least_share
        Least share of them that must agree with the map.
    greatest_misfit
        Mean square of their residuals, in units of their variance, above which there is no match.
    gate
        Greatest squared Mahalanobis distance of a correction; chi-squared of 6 exceeds 30 once in
        25,000.
    certainty
        Probability of the best place that a search must reach to be believed.
    patch_s
        Scans of so many seconds are searched for together, s.
    level_sigma
        Of a height taken from the level of the ground before the place is known, m.
    feature_reach
        What is wider than twice this many posts is no feature to search by.
    search_s
        Between two searches, s.
    lost_s
        Without agreement for so long the lock is lost, s.
    odometry_postings
        Least and greatest squares in which scans are compared with each other, m: a
        twenty-fourth of a scan's width between them.
    odometry_sigma
        Of the difference of their heights there, m.
    key_share
        A scan is compared with an earlier one until less than this share of it lies on that one.
    """

    model_sigma: float = 0.03
    least_squares: int = 12
    least_share: float = 0.6
    greatest_misfit: float = 2.5
    gate: float = 30.0
    certainty: float = 0.99999
    patch_s: float = 4.0
    level_sigma: float = 0.5
    feature_reach: int = 4
    search_s: float = 0.5
    lost_s: float = 2.0
    odometry_postings: tuple[float, float] = (0.05, 0.4)
    odometry_sigma: float = 0.03
    key_share: float = 0.8


@dataclass(frozen=True)
class _Key:
    """A scan kept to compare later ones with: its squares, and the pose as it was known then."""

    grid: Grid
    surface: Surface
    position: Array
    attitude: Array


class LidarInertialFilter:
    """Error-state filter: inertial samples carry it, LiDAR scans tie it to a map.

    Where a scan does not agree with the map it is compared with an earlier one (odometry; the pose
    at that scan is part of the state), and the scans of the last seconds are searched for on
    the map. Once found, every scan is fitted to the map. A post's error is the same whenever
    it is seen, so its k-th use counts 1 / (k (k + 1)) of a full one: all uses together never
    count more than one.

    Parameters
    ----------
    inertial
        State at the start.
    errors
        Its standard deviations.
    prior
        The map; None: scans are compared with each other alone.
    settings
        Limits of the registration.
    instruments
        Calibrations of altimeters, velocimeters and star trackers, by name.
    ground
        What is known of the ground's height.
    """

    def __init__(
        self,
        inertial: StrapdownState,
        errors: StartSigmas,
        prior: PriorMap | None,
        settings: RegistrationSettings | None = None,
        *,
        instruments: Mapping[str, Any] | None = None,
        ground: LevelGround | None = None,
    ) -> None:
        level, known = ground or LevelGround(), instruments or {}
        blocks = {_KEY: np.zeros((6, 6))} | blocks_of(known, level)
        self.state = ErrorState(inertial, errors, blocks=blocks)
        self.state.listeners.append(self._corrected)
        self.prior = prior
        self.settings = settings or RegistrationSettings()
        self.locked = False
        self.events: list[NavigationEvent] = []
        self._aids = Aids(self.state, known, level, self.events)
        self._arrivals = Arrivals(
            inertial.step, lambda *told: self.events.append(NavigationEvent(*told))
        )
        if prior is not None:
            self._uses = np.zeros(prior.grid.shape, np.int32)
            self._variance = self._of_uses(prior, self._uses)
        self._agreed = -np.inf
        self._searched = -np.inf
        self._patch: deque[tuple[float, Features]] = deque()
        self._key: _Key | None = None
        self._shared = 0.0
        self._moved = np.zeros(3)
        self._offset = np.zeros(3)

    # --- state ----------------------------------------------------------------------------

    @property
    def inertial(self) -> StrapdownState:
        """The lander's state."""
        return self.state.inertial

    @property
    def covariance(self) -> Array:
        """Of the error state: the lander's (15), the pose at the scan kept (6), what aids need."""
        return self.state.covariance

    @property
    def watches(self) -> dict[str, Watch]:
        """What watches over the kinds of measurements, by "sensor kind"."""
        return self._aids.watches

    @property
    def found(self) -> bool:
        """Whether the lander has been found on the map at least once."""
        return any(event.name == "lock" for event in self.events)

    @property
    def position_sigma(self) -> float:
        """Greatest standard deviation of the position on an axis, m."""
        return float(np.sqrt(np.diag(self.covariance)[:3].max()))

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the lander's state as the rest of the loop takes it."""
        found = self.inertial.estimate(self.covariance, time, mass)
        position = self.site_to_local.to_local(found.position)
        return replace(found, position=position, lost=self._aids.lost)

    @property
    def site_to_local(self) -> Shift:
        """Where the map lies in the local frame, which does not jump when the map is found."""
        return Shift(self._offset.copy())

    def take(self, sensor: str, measurement: Any, time: float) -> None:
        """Take in a measurement; what it cannot use, or what comes out of order, changes nothing.

        Raises
        ------
        InputError
            If `time` (s) runs backwards.
        """
        measurement = self._arrivals.admit(sensor, measurement, time)
        if isinstance(measurement, InertialSamples):
            self.propagate(measurement.angle, measurement.velocity)
        elif isinstance(measurement, LidarScan):
            self.update_scan(measurement, time)
        elif measurement is not None:
            before = self.inertial.position.copy()
            self._aids.take(sensor, measurement, time)
            # Where the site lies is learnt; the local frame stays where it is.
            self._offset -= self.inertial.position - before

    def propagate(self, angle: ArrayLike, velocity: ArrayLike) -> None:
        """Carry the filter over inertial samples (n, 3); NaN stands for a missing one."""
        self.state.propagate(angle, velocity)
        self._aids.travel()

    # --- scans ----------------------------------------------------------------------------

    def update_scan(self, scan: LidarScan, time: float) -> bool:
        """Take in a scan; return whether it agreed with the map.

        A scan without returns, or too slanted to average, changes nothing.
        """
        scan = _plausible(scan)
        width = self._width(scan)
        if not np.isfinite(width):
            return False
        if self.prior is None:
            self._follow(scan)
            self._remember(scan, width)
            return False
        return self._place(scan, time, width)

    def _place(self, scan: LidarScan, time: float, width: float) -> bool:
        """Find a scan's place on the map."""
        if self.locked:
            agreed = self._register(scan, time)
            if not agreed:
                self._follow(scan)
        else:
            self._follow(scan)
            if self._search(scan, time):
                self._lock(time)
            agreed = self._register(scan, time)
        if self.locked and time - self._agreed > self.settings.lost_s:
            self.locked = False
            self._patch.clear()
            self.events.append(NavigationEvent(time, "lock-lost", {"moved": 0.0}))
        self._remember(scan, width)
        return agreed

    def _width(self, scan: LidarScan) -> float:
        """Return the width of the ground that a scan covers, across the line of sight, m."""
        if not np.isfinite(scan.range).any():
            return np.nan
        reach = np.nanmedian(scan.range)
        cosine = float(np.min(scan.direction @ scan.direction[len(scan.direction) // 2]))
        return float(2.0 * reach * np.sqrt(max(1.0 - cosine**2, 0.0)))

    def _surface(self, scan: LidarScan, grid: Grid) -> Surface:
        s = self.inertial
        return surface_of(scan.points(s.position, s.attitude), grid)

    def _lock(self, time: float) -> None:
        name = "relock" if self.found else "lock"
        self.locked = True
        self._agreed = time
        self._patch.clear()
        self.events.append(
            NavigationEvent(time, name, {"moved": float(np.linalg.norm(self._moved))})
        )

    # --- the map --------------------------------------------------------------------------

    def _register(self, scan: LidarScan, time: float) -> bool:
        """Fit a scan to the map; without a lock only where the state is certain enough for it."""
        assert self.prior is not None
        s, g = self.settings, self.prior.grid
        if not self.locked and not (self.found and self.position_sigma < g.posting):
            return False
        result, posts = register(
            scan,
            self.prior,
            self.inertial.position,
            self.inertial.attitude,
            self.covariance[np.ix_(POSE, POSE)],
            self._variance,
        )
        if not self._believable(result):
            return False
        if not self._apply(POSE, result.information, result.vector, s.gate, jump=not self.locked):
            return False
        self._uses[posts] += 1
        self._variance[posts] = self._of_uses(self.prior, self._uses[posts])
        if not self.locked:
            self._lock(time)
        self._agreed = time
        return True

    def _of_uses(self, prior: PriorMap, uses: NDArray[np.int32]) -> Array:
        """Return the variance of a residual at posts that were compared `uses` times before."""
        own = prior.sigma**2 * (uses + 1.0) * (uses + 2.0)
        return np.asarray(own + self.settings.model_sigma**2)

    def _believable(self, result: Fit) -> bool:
        s = self.settings
        return (
            result.used >= s.least_squares
            and result.share >= s.least_share
            and result.misfit <= s.greatest_misfit
        )

    def _search(self, scan: LidarScan, time: float) -> bool:
        """Look for the scans of the last seconds on the map; return whether they were found."""
        assert self.prior is not None
        s, g = self.settings, self.prior.grid
        self._patch.append((time, features_of(self._surface(scan, g), s.feature_reach)))
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
        jacobian = point_jacobian(middle, self.inertial.position, self.inertial.attitude)
        p = jacobian @ self.covariance[np.ix_(POSE, POSE)] @ jacobian.T
        reach = int(np.ceil(3.5 * np.sqrt(max(p[0, 0], p[1, 1])) / g.posting))
        window = _window(
            self.prior.elevation, patch.first[0] - reach, patch.first[1] - reach,
            patch.known.shape[0] + 2 * reach, patch.known.shape[1] + 2 * reach,
        )  # fmt: skip
        variance = 1.5 * self.prior.sigma**2 + s.model_sigma**2
        match = search(
            patch, window, g.posting, variance, p[:2, :2], np.full(2, -reach * g.posting),
            reach=s.feature_reach,
        )  # fmt: skip
        if match is None:
            return False
        if match.certainty < s.certainty or match.share < s.least_share:
            self._take_height(jacobian, match, float(p[2, 2]))
            return False
        information = np.linalg.inv(match.covariance)
        return self._apply(
            POSE,
            jacobian.T @ information @ jacobian,
            jacobian.T @ information @ match.shift,
            s.gate,
            jump=True,
        )

    def _take_height(self, jacobian: Array, match: Match, before: float) -> None:
        """Take in the height alone, where it is known much better than before: level ground."""
        # The map's own level over the patch is the same in every search: counted once, not again.
        variance = match.up_variance + self.settings.level_sigma**2
        if 9.0 * variance < before:
            row = jacobian[2]
            information = np.outer(row, row) / variance
            if self._apply(
                POSE, information, row * match.up / variance, self.settings.gate, jump=True
            ):
                # Earlier scans lie where the lander was thought to be.
                self._patch.clear()

    # --- odometry -------------------------------------------------------------------------

    def _remember(self, scan: LidarScan, width: float) -> None:
        """Keep this scan and the pose at it for later ones, if the last kept is left behind."""
        if self._key is not None and self._shared >= self.settings.key_share:
            return
        posting = float(np.clip(width / 24.0, *self.settings.odometry_postings))
        s = self.inertial
        grid = Grid(0.0, 0.0, posting, 1, 1)
        self._key = _Key(grid, self._surface(scan, grid), s.position.copy(), s.attitude.copy())
        self.state.clone(_KEY, POSE)
        self._shared = 1.0

    def _follow(self, scan: LidarScan) -> None:
        """Compare a scan with the one kept."""
        self._shared = 0.0
        if self._key is None:
            return
        key, least = self._key, self.settings.least_squares
        new = self._surface(scan, key.grid)
        i, j = _common(key.surface, new)
        if len(i) < least:
            return
        # A scan from nearer covers less ground: it need only lie on the one kept.
        self._shared = len(i) / len(new) if len(i) >= 2 * least else 0.0
        s = self.inertial
        here = pose_jacobian(new.position[j], new.normal[j], s.position, s.attitude)
        there = pose_jacobian(key.surface.position[i], new.normal[j], key.position, key.attitude)
        both = np.concatenate((POSE, np.arange(self.state.head)[self.state.block(_KEY)]))
        result = fit(
            np.hstack((here, -there)),
            key.surface.position[i, 2] - new.position[j, 2],
            np.full(len(i), self.settings.odometry_sigma**2),
            self.covariance[np.ix_(both, both)],
        )
        if self._believable(result):
            self._apply(both, result.information, result.vector, self.settings.gate)

    # --- correction -----------------------------------------------------------------------

    def _apply(
        self,
        part: NDArray[np.int64],
        information: Array,
        vector: Array,
        gate: float,
        *,
        jump: bool = False,
    ) -> bool:
        """Take in information on a part of the error state, unless its correction is too unlikely.

        What is learnt in a `jump` is where the map lies: the local frame stays where it is.
        """
        if not self.state.inform(part, information, vector, gate).taken:
            return False
        if jump:
            self._offset -= self._moved
        return True

    def _corrected(self, error: Array) -> None:
        """Note a correction of the whole error state."""
        self._moved = error[:3].copy()
        if self._key is not None:
            self._correct_key(error[self.state.block(_KEY)])

    def _correct_key(self, error: Array) -> None:
        """Move the scan kept with its pose; drop it where its squares would no longer hold."""
        assert self._key is not None
        key = self._key
        middle = key.surface.position.mean(axis=0) if len(key.surface) else key.position
        moved = point_jacobian(middle, key.position, key.attitude) @ error
        if np.abs(moved).max() > 0.5 * key.grid.posting:
            self._key, self._shared = None, 0.0
            return
        jacobian = pose_jacobian(
            key.surface.position, key.surface.normal, key.position, key.attitude
        )
        position = key.surface.position.copy()
        position[:, 2] += jacobian @ error
        turn = np.concatenate((0.5 * error[3:], [1.0]))
        self._key = replace(
            key,
            surface=replace(key.surface, position=position),
            position=key.position + error[:3],
            attitude=normalised(quat_multiply(key.attitude, turn)),
        )


def _plausible(scan: LidarScan) -> LidarScan:
    """Return a scan without ranges that no LiDAR could give."""
    with np.errstate(invalid="ignore"):
        good = (scan.range > 0.0) & (scan.range < _FARTHEST)
    return scan if good.all() else replace(scan, range=np.where(good, scan.range, np.nan))


def _window(elevation: Array, row: int, col: int, rows: int, cols: int) -> Array:
    """Return a part of a map, NaN where it lies off the map."""
    out = np.full((rows, cols), np.nan)
    r0, r1 = max(row, 0), min(row + rows, elevation.shape[0])
    c0, c1 = max(col, 0), min(col + cols, elevation.shape[1])
    if r0 < r1 and c0 < c1:
        out[r0 - row : r1 - row, c0 - col : c1 - col] = elevation[r0:r1, c0:c1]
    return out


def _common(a: Surface, b: Surface) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the places in `a` and in `b` of the squares that both hold."""
    if len(a) == 0 or len(b) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    wide = int(max(a.col.max(), b.col.max()) - min(a.col.min(), b.col.min())) + 1
    west = min(a.col.min(), b.col.min())
    _, i, j = np.intersect1d(
        a.row * wide + a.col - west, b.row * wide + b.col - west,
        assume_unique=True, return_indices=True,
    )  # fmt: skip
    return i, j
