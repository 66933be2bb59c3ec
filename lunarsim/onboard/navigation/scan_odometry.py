"""Scan-to-scan odometry: motion from the overlap with an earlier scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.navigation.corrected_scan import CorrectedScan, ScanSurface
from lunarsim.onboard.navigation.error_state import POSE, REFERENCE_POSE
from lunarsim.onboard.navigation.measurement_processor import FilterContext
from lunarsim.onboard.navigation.registration import (
    MIN_SQUARES,
    REJECTION_PROBABILITY,
    fit_residuals,
    is_good_fit,
    residual_correlation,
    solve_error,
)
from lunarsim.typing import Array, BoolArray, IntArray

# Factor on the noise variance of a slope below which the slope is set to the median.
_MIN_SLOPE_RATIO = 6.0
# Minimum standard deviation of the height of a square, m.
_MIN_SIGMA_M = 3e-4


def comparison_normals(new: Array, old: Array) -> Array:
    """Return terrain normals (n, 3) for the comparison of two scans, without noise.

    Measured slopes contain the scan noise, which dominates on smooth terrain and would look like
    position information (errors in variables; Fuller 1987, section 1.1). The difference of the two
    scans gives the noise. Slopes are shrunk towards the median slope by this noise, and slopes that
    do not exceed it are set to the median.

    Parameters
    ----------
    new, old
        Normals (-dz/dx, -dz/dy, 1) of the same squares in both scans (n, 3).
    """
    slope = 0.5 * (new[:, :2] + old[:, :2])
    middle = np.median(slope, axis=0)
    deviation = slope - middle
    noise = (1.4826 * float(np.median(np.abs(new[:, :2] - old[:, :2])))) ** 2 / 4.0
    shrinkage = np.maximum(
        1.0 - _MIN_SLOPE_RATIO * noise / np.maximum(np.sum(deviation**2, axis=1), 1e-300), 0.0
    )
    out = np.ones_like(new)
    out[:, :2] = middle + shrinkage[:, None] * deviation
    return out


def height_variances(normal: Array, residual: Array, used: BoolArray) -> Array:
    """Estimate the height variance of each square (n,), m^2, from fit residuals.

    `residual` (n,), m, are the residuals, `normal` (n, 3) the terrain normals, and `used` (n,)
    marks the squares used in the fit. The variance grows with the squared slope: at the edges of
    rocks the measured height depends on the viewpoint.
    """
    square = residual**2
    squared_slope = np.sum((normal[:, :2] - np.median(normal[:, :2], axis=0)) ** 2, axis=1)
    is_flat = used & (squared_slope <= np.median(squared_slope[used]))
    min_variance = max(float(np.mean(square[is_flat])), _MIN_SIGMA_M**2)
    is_steep = used & ~is_flat
    slope_sum = float(np.sum(squared_slope[is_steep]))
    growth = max(float(np.sum(square[is_steep])) - min_variance * int(is_steep.sum()), 0.0)
    return np.asarray(
        min_variance + (growth / slope_sum if slope_sum > 0.0 else 0.0) * squared_slope
    )


def linearisation_variance(prior: Array, displacements: Array) -> float:
    """Return the variance of the linearisation error of a scan comparison, m^2.

    The error is common to all squares. Attitude errors rotate the displacements of the lander and
    of the observed terrain between the two scans. The squared angle times the displacement is the
    second-order error.

    Parameters
    ----------
    prior
        Prior covariance of the pose, the reference pose and the scanner errors.
    displacements
        Displacements of the lander and of the observed terrain (2, 3), m.
    """
    angles = 0.5 * float(np.trace(prior[3:6, 3:6]) + np.trace(prior[9:12, 9:12]))
    angles += float(np.trace(prior[13:16, 13:16]))
    return float(angles**2 * np.sum(displacements**2))


# Maximum plausible range, m.
_MAX_RANGE_M = 20_000.0
# Minimum and maximum side of the compared squares, m; between them it is 1/24 of the scan's width.
_POSTINGS_M = (0.05, 0.4)
# Standard deviation of the height difference of two scans in a square, m.
_SCAN_SIGMA_M = 0.03
# Minimum overlap with the reference scan; below it the reference scan is replaced.
_MIN_OVERLAP = 0.8
# Maximum residual of a square in standard deviations; factor on the variances, since the slopes
# that weight the squares have errors too.
_MAX_RESIDUAL_SIGMAS, _SLOPE_VARIANCE_FACTOR = 3.0, 1.5
# Tolerance on the orthogonality of the mount and on the norm of ray directions.
_ROTATION_TOLERANCE = 1e-3
# Displacement of the reference scan, in squares, above which it is averaged again: a linear
# extrapolation along the slopes is no longer valid then.
_MAX_DISPLACEMENT_SQUARES = 0.05


def reference_pose_block() -> dict[str, Array]:
    """Return the initial error covariance (6, 6) of the reference-scan pose, zero.

    The result maps the name of the block (group of errors) to the covariance.
    """
    return {REFERENCE_POSE: np.zeros((6, 6))}


@dataclass(frozen=True)
class _ReferenceScan:
    """Reference scan that later scans are compared with.

    Attributes
    ----------
    sensor, corrected
        Name of the sensor, and the scan with its current pose estimate.
    grid, surface
        Grid, and the scan averaged over its squares.
    displacement
        Displacement since the last averaging, m.
    """

    sensor: str
    grid: Grid
    surface: ScanSurface
    corrected: CorrectedScan
    displacement: float = 0.0

    def moved(self, errors: Array) -> _ReferenceScan:
        """Return the reference scan with errors (11,) added to its pose and scanner.

        The heights are extrapolated along the slopes of the squares, without a new averaging.
        """
        centre = self.surface.position.mean(axis=0)
        displacement = self.displacement + float(
            np.abs(self.corrected.point_jacobian(centre) @ errors).max()
        )
        position = self.surface.position.copy()
        position[:, 2] += self.corrected.jacobian(position, self.surface.normal) @ errors
        surface = replace(self.surface, position=position)
        return replace(
            self,
            surface=surface,
            corrected=self.corrected.corrected_by(errors),
            displacement=displacement,
        )

    def refresh(self) -> _ReferenceScan:
        """Return the reference scan, averaged again if its displacement is too large."""
        if self.displacement <= _MAX_DISPLACEMENT_SQUARES * self.grid.posting:
            return self
        return replace(self, surface=self.corrected.surface(self.grid), displacement=0.0)


class ScanOdometry:
    """Measurement processor that compares scans with an earlier reference scan.

    The pose of the reference scan is part of the error state.

    Parameters
    ----------
    context
        State and helpers that the processors share; the state has the block of
        `reference_pose_block`.
    """

    def __init__(self, context: FilterContext) -> None:
        self.context = context
        self._reference: _ReferenceScan | None = None
        self._share = 0.0
        context.state.listeners.append(self._apply_correction)

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool) -> bool:
        """Update the filter by comparing a scan with the reference scan.

        The scan is not compared if an earlier processor has `used` it. It becomes the new
        reference if its overlap with the old one is too small. The return value states whether the
        comparison was accepted; other measurement types are ignored (False).
        """
        if not isinstance(measurement, LidarScan):
            return False
        taken = False
        if not used:
            taken = self._compare(sensor, measurement, time)
        self._update_reference(sensor, measurement)
        return taken

    def _update_reference(self, sensor: str, scan: LidarScan) -> None:
        """Make a scan the reference if its overlap with the last reference is too small.

        This also holds without a reference. The errors of the pose are copied to the block of the
        reference pose.
        """
        if self._reference is not None and self._share >= _MIN_OVERLAP:
            return
        posting = float(np.clip(scan_width(scan) / 24.0, *_POSTINGS_M))
        grid = Grid(0.0, 0.0, posting, 1, 1)
        corrected = self.context.correct_scan(sensor, scan)
        self._reference = _ReferenceScan(sensor, grid, corrected.surface(grid), corrected)
        self.context.state.clone(REFERENCE_POSE, POSE)
        self._share = 1.0

    def _compare(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Update the filter from the overlap with the reference; return whether accepted.

        The result is False without a reference of the same sensor, with too little overlap, or
        after a bad fit. `time` is in s.
        """
        self._share = 0.0
        if self._reference is None or self._reference.sensor != sensor:
            return False
        self._reference = reference = self._reference.refresh()
        least, state = MIN_SQUARES, self.context.state
        corrected = self.context.correct_scan(sensor, scan)
        new = corrected.surface(reference.grid)
        i, j = _common_squares(reference.surface, new)
        if len(i) < least:
            return False
        # A scan from a lower altitude covers a smaller area; only this area must overlap.
        self._share = len(i) / len(new) if len(i) >= 2 * least else 0.0
        own = self.context.scanner_indices(sensor)
        indices = np.concatenate((POSE, np.arange(state.head)[state.block(REFERENCE_POSE)], own))
        prior = state.covariance_of(indices)
        centre = new.position[j].mean(axis=0)
        normal = comparison_normals(new.normal[j], reference.surface.normal[i])
        jacobian = _difference_jacobian(
            corrected, reference.corrected, new.position[j], normal, own
        )
        residual = reference.surface.position[i, 2] - new.position[j, 2]
        variance = np.full(len(i), _SCAN_SIGMA_M**2)
        result = fit_residuals(jacobian, residual, variance, prior)
        if not is_good_fit(result):
            self._share = 0.0
            return False
        residual_after = residual - jacobian @ solve_error(result, prior)
        used = np.abs(residual_after) <= _MAX_RESIDUAL_SIGMAS * _SCAN_SIGMA_M
        variance = _SLOPE_VARIANCE_FACTOR * height_variances(normal, residual_after, used)
        displacements = np.stack(
            (
                corrected.position - reference.corrected.position,
                centre - reference.surface.position.mean(axis=0),
            )
        )
        variance += result.used * linearisation_variance(prior, displacements)
        refined = fit_residuals(jacobian[used], residual[used], variance[used], prior)
        squares = new.row[j][used], new.col[j][used]
        correlation = max(residual_correlation(squares, residual_after[used], variance[used]), 1.0)
        outcome = state.update_with_information(
            indices,
            refined.information / correlation,
            refined.vector / correlation,
            min_probability=REJECTION_PROBABILITY,
        )
        self.context.record_outcome(sensor, "scans", outcome, time)
        if not outcome.is_accepted:
            # Either scan can be wrong: make this one the reference for the next.
            self._share = 0.0
        return outcome.is_accepted

    def _apply_correction(self, error: Array) -> None:
        """Apply a filter correction (size,) to the pose of the reference scan."""
        if self._reference is None or len(self._reference.surface) == 0:
            return
        state = self.context.state
        own = error[self.context.scanner_indices(self._reference.sensor)]
        change = np.zeros(11)
        change[:6], change[6 : 6 + len(own)] = error[state.block(REFERENCE_POSE)], own
        self._reference = self._reference.moved(change)


def _difference_jacobian(
    new: CorrectedScan,
    old: CorrectedScan,
    points: Array,
    normals: Array,
    scanner_indices: IntArray,
) -> Array:
    """Return the Jacobian (n, d) of the difference between points of two scans.

    The difference at `points` (n, 3) is taken along `normals` (n, 3). Columns are the errors of the
    pose, of the reference pose and of the common scanner, whose state indices are
    `scanner_indices`.
    """
    new_jacobian, old_jacobian = new.jacobian(points, normals), old.jacobian(points, normals)
    of_scanner = (new_jacobian - old_jacobian)[:, 6 : 6 + len(scanner_indices)]
    return np.hstack((new_jacobian[:, :6], -old_jacobian[:, :6], of_scanner))


def remove_implausible_ranges(scan: LidarScan) -> LidarScan:
    """Return a scan without implausible ranges or ranges without standard deviation.

    Removed ranges are NaN. Plausible ranges are positive and below 20 km. All ranges are removed
    if the mount is not a rotation, or the rays are not unit vectors.

    Raises
    ------
    InputError
        If the arrays do not match each other, or are not real numbers.
    """
    scan.check_arrays()
    n = len(scan.range)
    with np.errstate(invalid="ignore", over="ignore"):
        turns = np.abs(scan.mount @ scan.mount.T - np.eye(3)).max() <= _ROTATION_TOLERANCE
        unit = (
            np.abs(np.einsum("ni,ni->n", scan.direction, scan.direction) - 1.0)
            <= _ROTATION_TOLERANCE
        )
    if not (turns and unit.all() and np.linalg.det(scan.mount) > 0.0):
        return replace(scan, range=np.full(n, np.nan))
    with np.errstate(invalid="ignore"):
        good = (scan.range > 0.0) & (scan.range < _MAX_RANGE_M)
        good &= (scan.sigma >= 0.0) & (scan.sigma < np.inf)
    return scan if good.all() else replace(scan, range=np.where(good, scan.range, np.nan))


def scan_width(scan: LidarScan) -> float:
    """Return the width of a scan across the line of sight, m; NaN without returns.

    It is the width at the median range.
    """
    if not np.isfinite(scan.range).any():
        return np.nan
    reach = np.nanmedian(scan.range)
    cosine = float(np.min(scan.direction @ scan.direction[len(scan.direction) // 2]))
    return float(2.0 * reach * np.sqrt(max(1.0 - cosine**2, 0.0)))


def _common_squares(a: ScanSurface, b: ScanSurface) -> tuple[IntArray, IntArray]:
    """Find the grid squares that two scan surfaces have in common.

    The results are the indices of these squares in `a` (m,) and in `b` (m,), in the same order;
    empty if there are none.
    """
    if len(a) == 0 or len(b) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    wide = int(max(a.col.max(), b.col.max()) - min(a.col.min(), b.col.min())) + 1
    west = min(a.col.min(), b.col.min())
    _, i, j = np.intersect1d(
        a.row * wide + a.col - west, b.row * wide + b.col - west,
        assume_unique=True, return_indices=True,
    )  # fmt: skip
    return i, j
