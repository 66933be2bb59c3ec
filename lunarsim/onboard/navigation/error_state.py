"""Error state of the navigation filter: lander, auxiliary states and rocks.

The first 15 errors are those of the lander (shadow EKF paper, Eq. 1). Then come named blocks that
exist for the entire flight: poses of earlier scans, sensor biases, terrain height. States that are
added and removed in flight, such as rocks, come after the blocks. This module implements their
propagation and their measurement updates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, solve_triangular
from scipy.linalg.blas import dtrsm
from scipy.special import chdtrc

from lunarsim._blas import one_blas_thread
from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.inertial import (
    ATTITUDE,
    INERTIAL,
    VELOCITY,
    StartSigmas,
    StrapdownState,
    checked_increments,
)
from lunarsim.onboard.navigation.schmidt_kalman_covariance import SchmidtKalmanCovariance, inflate
from lunarsim.typing import Array, IntArray
from lunarsim.value_checks import check_finite, check_shape

# Position and attitude of the lander in the error state.
POSE = np.r_[0:3, 9:12]
# Name of the block of the site frame relative to the local frame: position (m) and azimuth about up
# (rad). Without this block the two frames are identical.
MAP = "map"
# Name of the block of the lander's pose at the reference scan of the odometry.
REFERENCE_POSE = "key"
# Relative variance added so that the correlation of nearly equal errors is positive definite.
_REGULARISATION = 1e-9
# Velocity corrections below this are too small to transform the velocity covariance, m/s.
_MIN_VELOCITY_CORRECTION_M_S = 0.01
# Minimum information in a direction, relative to the prior information; less is ignored.
_MIN_RELATIVE_INFORMATION = 1e-3


@dataclass(frozen=True)
class UpdateOutcome:
    """Outcome of a measurement update of the navigation filter.

    Attributes
    ----------
    nis
        Normalised innovation squared; chi-squared with `dof` degrees of freedom.
    dof
        Degrees of freedom.
    is_accepted
        Whether the measurement was accepted.
    whitened
        Whitened innovation (n,) of an accepted measurement, otherwise empty. The length is constant
        for one kind of measurement of one sensor; missing components are NaN.
    """

    nis: float
    dof: int
    is_accepted: bool
    whitened: Array = field(default_factory=lambda: np.zeros(0))


class ErrorState(SchmidtKalmanCovariance):
    """Error-state Kalman filter: lander state, error covariance and their updates.

    The errors are those of the lander (15), then named blocks of additional errors that exist for
    the entire flight, then errors that are added and removed in flight (rocks).

    Parameters
    ----------
    inertial
        Initial state of the lander.
    start_sigmas
        Standard deviations of the initial state.
    blocks
        Initial covariances (k, k) of additional errors, by name of the block.
    capacity
        Initial number of errors after the blocks to allocate; it grows as needed.

    Attributes
    ----------
    inertial
        State of the lander.
    head
        Number of errors of the lander and the blocks.
    tail
        Number of errors after the blocks.
    listeners
        Functions that are called with each correction (size,), after the lander's state was
        corrected.
    """

    def __init__(
        self,
        inertial: StrapdownState,
        start_sigmas: StartSigmas | None = None,
        *,
        blocks: Mapping[str, ArrayLike] | None = None,
        capacity: int = 0,
    ) -> None:
        self.inertial = inertial
        self.listeners: list[Callable[[Array], None]] = []
        self._blocks: dict[str, slice] = {}
        self._values: dict[str, Array] = {}
        parts, head = [inertial.covariance(start_sigmas or StartSigmas())], INERTIAL
        for name, given in (blocks or {}).items():
            own = _covariance(f"navigation.{name}", given)
            self._blocks[name] = slice(head, head + len(own))
            self._values[name] = np.zeros(len(own))
            head += len(own)
            parts.append(own)
        super().__init__(block_diag(*parts), capacity)

    # --- layout ---------------------------------------------------------------------------

    def block(self, name: str) -> slice:
        """Return the slice of a named block (group of errors) in the error state."""
        return self._blocks[name]

    def value(self, name: str) -> Array:
        """Return the estimate of a named block (group of errors) that started at 0 (k,).

        This is the sum of all corrections of these errors so far. The array is not a copy.
        """
        return self._values[name]

    def has(self, name: str) -> bool:
        """Return whether the error state contains a block (group of errors) of this name."""
        return name in self._blocks

    def inflate(self, columns: ArrayLike, factor: float, max_sigma: ArrayLike) -> None:
        """Multiply the conditional variances of some errors by a factor.

        The conditional variance is the part that the other errors do not explain. `columns` (k,)
        are the indices of the errors, and `max_sigma` (k,) their maximum standard deviations after
        the inflation. Correlations with the other errors remain valid.
        """
        inflate(self.covariance, columns, factor, max_sigma)

    def raise_variances(self, columns: ArrayLike, sigma: ArrayLike) -> None:
        """Raise the standard deviations of some errors to given minimum values.

        `columns` (k,) are the indices of the errors, and `sigma` (k,) the minimum standard
        deviations. Larger ones and all correlations with other errors stay unchanged.
        """
        at = np.asarray(columns)
        p = self._current_covariance(at)
        p[at, at] = np.maximum(p[at, at], np.square(sigma))

    def add_process_noise(self, columns: ArrayLike, covariance: ArrayLike) -> None:
        """Add process noise of a given covariance (k, k) to some errors.

        `columns` (k,) are the indices of the errors.
        """
        at = np.asarray(columns)
        self._current_covariance(at)[np.ix_(at, at)] += np.atleast_2d(covariance)

    def clone(self, name: str, source: IntArray) -> None:
        """Make the errors of a block equal to other errors, for example those of the pose.

        A block is a named group of errors; `source` (k,) are the indices of the errors that are
        copied into the block `name`. Only the covariance changes, not the estimate of the block.
        """
        p = self._p if int(np.max(source)) < self.head else self.p
        into = self._blocks[name]
        p[into] = p[source]
        p[:, into] = p[:, source]

    def replace_by_sum(
        self, index: int, sources: IntArray, weights: Array, noise_variance: float
    ) -> None:
        """Replace one error by a weighted sum of errors plus independent noise.

        `index` is that of the replaced error; `sources` (k,) are the indices of the summed errors,
        `weights` (k,) their weights, and `noise_variance` the variance of the noise.
        """
        p = self._current_covariance(index, sources)
        row = weights @ p[sources]
        own = float(row[sources] @ weights) + noise_variance
        p[index], p[:, index] = row, row
        p[index, index] = own

    # --- time -----------------------------------------------------------------------------

    def propagate(self, angle: ArrayLike, velocity: ArrayLike) -> None:
        """Propagate state and covariance with inertial samples; NaN marks missing ones.

        `angle` (n, 3), rad, and `velocity` (n, 3), m/s, are the increments of gyroscopes and
        accelerometers. Over missing samples, the last rate and specific force are continued with
        more process noise.

        Raises
        ------
        InputError
            If the arrays are not (n, 3) or differ in length; the state is then unchanged.
        """
        turns, pushes = checked_increments(np.atleast_2d(angle), np.atleast_2d(velocity))
        transition, noise = self.inertial.propagate(turns, pushes)
        p, n = self._current_covariance(INERTIAL - 1), INERTIAL
        with one_blas_thread():
            p[:n, :n] = transition @ p[:n, :n] @ transition.T + noise
            p[:n, n:] = transition @ p[:n, n:]
        p[:n, :n] = 0.5 * (p[:n, :n] + p[:n, :n].T)
        p[n:, :n] = p[:n, n:].T

    # --- measurements ---------------------------------------------------------------------

    def measure(
        self,
        jacobian: ArrayLike,
        columns: ArrayLike,
        innovation: ArrayLike,
        noise: ArrayLike,
        gate: float = np.inf,
    ) -> UpdateOutcome:
        """Update state and covariance with a measurement (n,) that depends on few errors.

        Parameters
        ----------
        jacobian
            Jacobian of the measurement with respect to the errors at `columns` (n, k).
        columns
            Distinct indices into the error state (k,).
        innovation
            Measured minus predicted value (n,).
        noise
            Noise covariance (n, n), or variances (n,) of independent components.
        gate
            Maximum normalised innovation squared; a larger one is rejected. A measurement that is
            not finite or whose noise is not positive definite is ignored, and `nis` is NaN. If the
            state covariance is no longer positive definite, each measurement is rejected with an
            infinite `nis`.
        """
        h, at = np.atleast_2d(np.asarray(jacobian, np.float64)), np.asarray(columns)
        y = np.atleast_1d(np.asarray(innovation, np.float64))
        r = np.asarray(noise, np.float64)
        r = np.diag(r) if r.ndim == 1 else np.atleast_2d(r)
        if not (np.isfinite(r).all() and np.linalg.eigvalsh(r).min() > 0.0):
            return UpdateOutcome(np.nan, len(y), False)
        hp = h @ self._rows(at)
        return self.update_with_innovation(hp, hp[:, at] @ h.T + r, y, gate)

    def update_with_innovation(
        self,
        jacobian_covariance: Array,
        innovation_covariance: Array,
        innovation: Array,
        gate: float = np.inf,
    ) -> UpdateOutcome:
        """Update state and covariance with an innovation (n,) and its covariance.

        `jacobian_covariance` (n, size) is the product H P of measurement Jacobian and covariance;
        the update overwrites it. `innovation_covariance` is (n, n). `gate` is the maximum
        normalised innovation squared. If an innovation exceeds it or is not finite, the state does
        not change.
        """
        outcome, lower = gate_innovation(innovation, innovation_covariance, gate)
        if not outcome.is_accepted:
            return outcome
        # (L^-1 H P)' = (H P)' L^-T, in place: the transposed array is in Fortran order.
        w = np.ascontiguousarray(
            dtrsm(1.0, lower.T, jacobian_covariance.T, side=1, lower=0, overwrite_b=1).T
        )
        error = outcome.whitened @ w
        active = self._active()
        if active is not None:
            error[self.head :][self._frozen] = 0.0
        if not np.isfinite(error).all():
            return UpdateOutcome(np.inf, len(innovation), False)
        self._subtract(w, active)
        self.correct(error)
        return outcome

    def update_with_information(
        self,
        indices: IntArray,
        information: Array,
        vector: Array,
        gate: float = np.inf,
        *,
        min_probability: float = 0.0,
    ) -> UpdateOutcome:
        """Update state and covariance with an information matrix (k, k) and vector (k,).

        They refer to the errors with the given indices (k,). The update treats the information as
        independent measurements along its principal axes, which works even if the covariance is
        singular, as while two poses coincide. `nis` of the outcome is the squared Mahalanobis
        distance of the correction. A correction is rejected if `nis` exceeds `gate`, or if its
        chi-squared tail probability is below `min_probability`. Information that is not finite is
        ignored, and `nis` is NaN. If rounding errors have made the covariance indefinite, it is
        rejected with an infinite `nis`.
        """
        k = len(indices)
        if not (np.isfinite(information).all() and np.isfinite(vector).all()):
            return UpdateOutcome(np.nan, k, False)
        own = self.covariance_of(indices)
        try:
            rows, measured, white = _as_measurements(own, information, vector)
            hp = rows @ self._rows(indices)
            lower = np.linalg.cholesky(np.eye(len(rows)) + hp[:, indices] @ rows.T)
        except np.linalg.LinAlgError:
            # Rounding errors have made the covariance indefinite: reject everything from now on.
            return UpdateOutcome(np.inf, k, False)
        distance, degrees = float(white @ white), len(measured)
        if not (distance <= gate and chdtrc(max(degrees, 1), distance) >= min_probability):
            return UpdateOutcome(distance, degrees, False)
        w = solve_triangular(lower, hp, lower=True, check_finite=False)
        error = solve_triangular(lower, measured, lower=True, check_finite=False) @ w
        if not np.isfinite(error).all():
            return UpdateOutcome(np.inf, degrees, False)
        with one_blas_thread():
            self._subtract(w, None)
        self.correct(error)
        return UpdateOutcome(distance, degrees, True, white)

    def correct(self, error: Array) -> None:
        """Add estimated errors (size,) to lander state and blocks; inform the listeners.

        Velocity sensors measure in body axes. They constrain a combination of the velocity error
        and the tilt times the velocity. When the velocity estimate changes, this combination must
        keep its covariance, so the velocity errors are transformed with the tilt. The result is
        the covariance of an invariant filter (Barrau and Bonnabel 2017), whose Jacobians do not
        depend on the estimate. Without this transformation, successive velocity corrections would
        wrongly reduce the uncertainty of the tilt.

        Raises
        ------
        InputError
            If the error is not `size` finite numbers; nothing is changed then.
        """
        error = np.asarray(error, np.float64)
        check_shape("navigation.error", error, (self.size,))
        check_finite("navigation.error", error)
        change = error[VELOCITY]
        if np.abs(change).max() > _MIN_VELOCITY_CORRECTION_M_S:
            lever = np.cross(np.eye(3), change) @ quat_to_matrix(self.inertial.attitude)
            p = self._current_covariance(POSE)
            p[VELOCITY] -= lever @ p[ATTITUDE]
            p[:, VELOCITY] -= p[:, ATTITUDE] @ lever.T
        self.inertial.correct(error[:INERTIAL])
        for name, place in self._blocks.items():
            self._values[name] += error[place]
        for listener in self.listeners:
            listener(error)


def gate_innovation(
    innovation: Array, innovation_covariance: Array, gate: float
) -> tuple[UpdateOutcome, Array]:
    """Test an innovation (n,); return the outcome and a Cholesky factor (n, n).

    The factor is that of `innovation_covariance` (n, n). The innovation is accepted if its
    normalised square is at most `gate`. If it is not finite, it is ignored (`nis` is NaN). If the
    covariance is not positive definite, the innovation is rejected with an infinite `nis`; the
    second result is then not a factor.
    """
    m = len(innovation)
    if not np.isfinite(innovation).all():
        return UpdateOutcome(np.nan, m, False), innovation_covariance
    if not np.isfinite(innovation_covariance).all():
        return UpdateOutcome(np.inf, m, False), innovation_covariance
    try:
        lower: Array = np.asarray(
            np.linalg.cholesky(0.5 * (innovation_covariance + innovation_covariance.T))
        )
    except np.linalg.LinAlgError:
        # Rounding errors have made the covariance indefinite: reject everything from now on.
        return UpdateOutcome(np.inf, m, False), innovation_covariance
    white = solve_triangular(lower, innovation, lower=True, check_finite=False)
    nis = float(white @ white)
    if not nis <= gate:
        return UpdateOutcome(nis, m, False), lower
    return UpdateOutcome(nis, m, True, white), lower


def _as_measurements(
    prior_covariance: Array, information: Array, vector: Array
) -> tuple[Array, Array, Array]:
    """Convert information on errors to independent measurements of unit variance.

    `prior_covariance` P (k, k) is that of the errors; `information` I (k, k) and `vector` v (k,)
    are information matrix and vector. With P = L L' and M = L' I L, the vector L' v has the
    covariance M + M^2, so its components along the eigenvectors of M are independent. Directions
    with little information are dropped: small unmodelled errors look like many standard deviations
    there. The results are the Jacobian (n, k) and innovation (n,) of the measurements, and the
    whitened innovation (k,) along the axes of L, which are the same for every measurement.
    """
    unit = np.sqrt(np.maximum(prior_covariance.diagonal(), 1e-300))
    correlation = prior_covariance / np.outer(unit, unit)
    lower = (
        np.linalg.cholesky(correlation + _REGULARISATION * np.eye(len(prior_covariance)))
        * unit[:, None]
    )
    gain, axes = np.linalg.eigh(lower.T @ information @ lower)
    kept = gain > _MIN_RELATIVE_INFORMATION
    gain, axes = gain[kept], axes[:, kept]
    root = np.sqrt(gain)
    measured = axes.T @ (lower.T @ vector) / root
    rows = solve_triangular(lower, axes * root, trans="T", lower=True, check_finite=False).T
    return rows, measured, axes @ (measured / np.sqrt(1.0 + gain))


def _covariance(name: str, given: ArrayLike) -> Array:
    own = np.atleast_2d(np.asarray(given, dtype=np.float64))
    good = own.ndim == 2 and own.shape[0] == own.shape[1] and np.isfinite(own).all()
    # Singular covariances are valid; rounding can make their smallest eigenvalue negative.
    good = good and own.size > 0 and np.allclose(own, own.T)
    if not (good and np.linalg.eigvalsh(own).min() >= -1e-12 * np.abs(own).max()):
        raise InputError(
            name, given, "must be a finite, symmetric and positive semi-definite matrix"
        )
    return own
