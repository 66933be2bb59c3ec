"""Scans against an earlier scan: how the lander has moved, not where it is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.navigation import odometry_noise as noise
from lunarsim.onboard.navigation.error_state import KEY, POSE
from lunarsim.onboard.navigation.parts import Shared
from lunarsim.onboard.navigation.registration import fit, solved, together
from lunarsim.onboard.navigation.registration_settings import RegistrationSettings
from lunarsim.onboard.navigation.seen_scan import SeenScan
from lunarsim.onboard.navigation.surface import Surface

Array = NDArray[np.float64]

# No return comes from farther, m.
_FARTHEST = 20_000.0
# Deviations beyond which what a fit leaves of a square is not noise; squares tell this many times
# less than they err by, since the slopes that weigh them err too.
_FAR_OFF, _SLOPES = 3.0, 1.5
# A mount differs from a rotation, and a ray's direction from a unit vector, by rounding alone.
_TURNS = 1e-3
# A scan kept is averaged afresh when it has been moved by so much of a square: carried on by their
# slopes its squares no longer hold, and what is found then moves them farther.
_AFRESH = 0.05


def key_block() -> dict[str, Array]:
    """Return the block for an error state."""
    return {KEY: np.zeros((6, 6))}


@dataclass(frozen=True)
class _Key:
    """A scan kept to compare later ones with.

    Attributes
    ----------
    sensor, seen
        Whose, and how it was seen, as far as is known now.
    grid, surface
        Its squares as they were averaged last.
    off
        By how much it has been moved since, m.
    """

    sensor: str
    grid: Grid
    surface: Surface
    seen: SeenScan
    off: float = 0.0

    def moved(self, change: Array) -> _Key:
        """Return it with errors (11,) added, its squares carried on by their slopes."""
        middle = self.surface.position.mean(axis=0)
        off = self.off + float(np.abs(self.seen.point_jacobian(middle) @ change).max())
        position = self.surface.position.copy()
        position[:, 2] += self.seen.jacobian(position, self.surface.normal) @ change
        surface = replace(self.surface, position=position)
        return replace(self, surface=surface, seen=self.seen.moved(change), off=off)

    def afresh(self) -> _Key:
        """Return it averaged afresh, if its squares no longer hold."""
        if self.off <= _AFRESH * self.grid.posting:
            return self
        return replace(self, surface=self.seen.surface(self.grid), off=0.0)


class ScanOdometry:
    """Compares scans with one kept; the pose at that one is part of the state.

    Parameters
    ----------
    shared
        Its state has the block of `key_block`.
    settings
        Limits of the comparison.
    """

    def __init__(self, shared: Shared, settings: RegistrationSettings) -> None:
        self.shared = shared
        self.settings = settings
        self._key: _Key | None = None
        self._share = 0.0
        shared.state.listeners.append(self._corrected)

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool) -> bool:
        """Compare a scan with the one kept, unless it is used already, and keep it if need be."""
        if not isinstance(measurement, LidarScan):
            return False
        taken = False
        if not used:
            taken = self._follow(sensor, measurement, time)
        self._remember(sensor, measurement)
        return taken

    def _remember(self, sensor: str, scan: LidarScan) -> None:
        """Keep this scan and the pose at it for later ones, if the last kept is left behind."""
        if self._key is not None and self._share >= self.settings.key_share:
            return
        posting = float(np.clip(width_of(scan) / 24.0, *self.settings.odometry_postings))
        grid = Grid(0.0, 0.0, posting, 1, 1)
        seen = self.shared.seen(sensor, scan)
        self._key = _Key(sensor, grid, seen.surface(grid), seen)
        self.shared.state.clone(KEY, POSE)
        self._share = 1.0

    def _follow(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Compare a scan with the one kept."""
        self._share = 0.0
        if self._key is None or self._key.sensor != sensor:
            return False
        self._key = key = self._key.afresh()
        least, state = self.settings.least_squares, self.shared.state
        seen = self.shared.seen(sensor, scan)
        new = seen.surface(key.grid)
        i, j = _common(key.surface, new)
        if len(i) < least:
            return False
        # A scan from nearer covers less ground: it need only lie on the one kept.
        self._share = len(i) / len(new) if len(i) >= 2 * least else 0.0
        own = self.shared.scanner(sensor)
        both = np.concatenate((POSE, np.arange(state.head)[state.block(KEY)], own))
        prior = state.own(both)
        middle = new.position[j].mean(axis=0)
        normal = noise.slopes(new.normal[j], key.surface.normal[i])
        jacobian = _differences(seen, key.seen, new.position[j], normal, own)
        residual = key.surface.position[i, 2] - new.position[j, 2]
        variance = np.full(len(i), self.settings.odometry_sigma**2)
        result = fit(jacobian, residual, variance, prior)
        if not self.settings.believes(result):
            self._share = 0.0
            return False
        left = residual - jacobian @ solved(result, prior)
        used = np.abs(left) <= _FAR_OFF * self.settings.odometry_sigma
        variance = _SLOPES * noise.variances(normal, left, used)
        ways = np.stack(
            (seen.position - key.seen.position, middle - key.surface.position.mean(axis=0))
        )
        variance += result.used * noise.second_order(prior, ways)
        exact = fit(jacobian[used], residual[used], variance[used], prior)
        squares = new.row[j][used], new.col[j][used]
        alike = max(together(squares, left[used], variance[used]), 1.0)
        found = state.inform(
            both, exact.information / alike, exact.vector / alike, chance=self.settings.chance
        )
        self.shared.judge(sensor, "scans", found, time)
        if not found.taken:
            # Either scan may be the wrong one: the next is compared with this.
            self._share = 0.0
        return found.taken

    def _corrected(self, error: Array) -> None:
        """Move the scan kept with its pose; one without squares is compared with nothing."""
        if self._key is None or len(self._key.surface) == 0:
            return
        state = self.shared.state
        own = error[self.shared.scanner(self._key.sensor)]
        change = np.zeros(11)
        change[:6], change[6 : 6 + len(own)] = error[state.block(KEY)], own
        self._key = self._key.moved(change)


def _differences(
    new: SeenScan, old: SeenScan, points: Array, normals: Array, scanner: NDArray[np.int64]
) -> Array:
    """Return how points (m, 3) of a scan move along vectors (m, 3) against those of an earlier one.

    With the errors of the pose, of the pose kept, and of the scanner, both have the same (m, d).
    """
    here, there = new.jacobian(points, normals), old.jacobian(points, normals)
    of_scanner = (here - there)[:, 6 : 6 + len(scanner)]
    return np.hstack((here[:, :6], -there[:, :6], of_scanner))


def plausible(scan: LidarScan) -> LidarScan:
    """Return a scan without ranges that no LiDAR could give, or that have no deviation.

    With none if its mount turns nothing, or its rays are no unit vectors.

    Raises
    ------
    InputError
        If its arrays do not fit each other, or hold no real numbers.
    """
    scan.check_arrays()
    n = len(scan.range)
    with np.errstate(invalid="ignore", over="ignore"):
        turns = np.abs(scan.mount @ scan.mount.T - np.eye(3)).max() <= _TURNS
        unit = np.abs(np.einsum("ni,ni->n", scan.direction, scan.direction) - 1.0) <= _TURNS
    if not (turns and unit.all() and np.linalg.det(scan.mount) > 0.0):
        return replace(scan, range=np.full(n, np.nan))
    with np.errstate(invalid="ignore"):
        good = (scan.range > 0.0) & (scan.range < _FARTHEST)
        good &= (scan.sigma >= 0.0) & (scan.sigma < np.inf)
    return scan if good.all() else replace(scan, range=np.where(good, scan.range, np.nan))


def width_of(scan: LidarScan) -> float:
    """Return the width of the ground that a scan covers, across the line of sight, m.

    NaN without returns.
    """
    if not np.isfinite(scan.range).any():
        return np.nan
    reach = np.nanmedian(scan.range)
    cosine = float(np.min(scan.direction @ scan.direction[len(scan.direction) // 2]))
    return float(2.0 * reach * np.sqrt(max(1.0 - cosine**2, 0.0)))


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
