"""The error state of a filter: the lander, what else is estimated with it, and rocks.

The first 15 errors are those of the lander (shadow EKF paper, Eq. 1). Then come blocks that a
navigation adds at its start: poses at earlier scans, biases, the ground. What comes and goes, as
rocks do, stands behind them. Time and measurements treat all of it alike, in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag, solve_triangular
from scipy.linalg.blas import dtrsm
from scipy.special import chdtrc

from lunarsim._blas import one_blas_thread
from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.doubt import inflate
from lunarsim.onboard.navigation.inertial import (
    ATTITUDE,
    INERTIAL,
    VELOCITY,
    StartSigmas,
    StrapdownState,
)
from lunarsim.onboard.navigation.resting_errors import RestingErrors

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# The lander's pose in the error state.
POSE = np.r_[0:3, 9:12]
# Name of a block: where the site frame lies in that of the lander's pose, position (m) and azimuth
# about up (rad). Without it both are one frame.
MAP = "map"
# Name of a block: the pose at the scan that later ones are compared with.
KEY = "key"
# Two errors that are the same but for this share of their variance are so by rounding.
_SINGULAR = 1e-9
# Corrections of the velocity so small change nothing in what errs with it, m/s.
_TELLING = 0.01
# What takes less than this share off the variance of a direction tells nothing of it.
_LEAST_TOLD = 1e-3


@dataclass(frozen=True)
class Outcome:
    """What came of a measurement.

    Attributes
    ----------
    nis
        Normalised innovation squared; chi-squared with `degrees` degrees of freedom.
    degrees
        Of freedom.
    taken
        Whether it corrected the state.
    white
        Whitened innovation (n,) of what was taken, by degree or by error, always of one length for
        one kind of measurement of one sensor, NaN for parts that it did not give this time; else
        empty.
    """

    nis: float
    degrees: int
    taken: bool
    white: Array = field(default_factory=lambda: np.zeros(0))


class ErrorState(RestingErrors):
    """Covariance of all that a filter errs by, and how time and measurements change it.

    Parameters
    ----------
    inertial
        The lander's state at the start.
    errors
        Its standard deviations.
    blocks
        Covariances (k, k) at the start of further errors, by name.
    capacity
        Errors behind the blocks for which room is made at first; it grows as needed.

    Attributes
    ----------
    inertial
        The lander's state.
    head
        Number of errors of lander and blocks.
    tail
        Number of those behind them.
    listeners
        Called with each correction (size,), after the lander took its part of it.
    """

    def __init__(
        self,
        inertial: StrapdownState,
        errors: StartSigmas | None = None,
        *,
        blocks: Mapping[str, ArrayLike] | None = None,
        capacity: int = 0,
    ) -> None:
        self.inertial = inertial
        self.listeners: list[Callable[[Array], None]] = []
        self._blocks: dict[str, slice] = {}
        self._values: dict[str, Array] = {}
        parts, head = [inertial.covariance(errors or StartSigmas())], INERTIAL
        for name, given in (blocks or {}).items():
            own = _covariance(f"navigation.{name}", given)
            self._blocks[name] = slice(head, head + len(own))
            self._values[name] = np.zeros(len(own))
            head += len(own)
            parts.append(own)
        super().__init__(block_diag(*parts), capacity)

    # --- layout ---------------------------------------------------------------------------

    def block(self, name: str) -> slice:
        """Return where a block lies."""
        return self._blocks[name]

    def value(self, name: str) -> Array:
        """Return the sum of a block's corrections (k,): what it is now, if it began at 0."""
        return self._values[name]

    def has(self, name: str) -> bool:
        """Tell whether there is such a block."""
        return name in self._blocks

    def inflate(self, columns: ArrayLike, factor: float, most: ArrayLike) -> None:
        """Multiply the variances of some errors (k,), see `doubt.inflate`."""
        inflate(self.covariance, columns, factor, most)

    def let_go(self, columns: ArrayLike, sigma: ArrayLike) -> None:
        """Widen errors (k,) to standard deviations (k,) where they are less; correlations fade."""
        at = np.asarray(columns)
        p = self._for(at)
        p[at, at] = np.maximum(p[at, at], np.square(sigma))

    def widen(self, columns: ArrayLike, covariance: ArrayLike) -> None:
        """Add to the covariance of some errors (k,) what they may have moved by (k, k)."""
        at = np.asarray(columns)
        self._for(at)[np.ix_(at, at)] += np.atleast_2d(covariance)

    def clone(self, name: str, source: Index) -> None:
        """Let a block err from now on as other errors do, for instance the pose of now."""
        p = self._p if int(np.max(source)) < self.head else self.p
        into = self._blocks[name]
        p[into] = p[source]
        p[:, into] = p[:, source]

    def follow(self, at: int, sources: Index, weights: Array, variance: float) -> None:
        """Let an error be from now on a weighted sum of errors (k,), and noise of its own."""
        p = self._for(at, sources)
        row = weights @ p[sources]
        own = float(row[sources] @ weights) + variance
        p[at], p[:, at] = row, row
        p[at, at] = own

    # --- time -----------------------------------------------------------------------------

    def propagate(self, angle: ArrayLike, velocity: ArrayLike) -> None:
        """Carry lander and covariance over inertial samples (n, 3); NaN stands for a missing one.

        Raises
        ------
        InputError
            If they are not as many of both, three numbers each; the state stays as it was.
        """
        turns, pushes = _samples(angle, velocity)
        transition, noise = self.inertial.propagate(turns, pushes)
        p, n = self._for(INERTIAL - 1), INERTIAL
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
    ) -> Outcome:
        """Take in a measurement (m,) that depends on a few errors.

        Parameters
        ----------
        jacobian
            Of the measurement by the errors at `columns` (m, k).
        columns
            Distinct places in the error state (k,).
        innovation
            What was measured less what was expected (m,).
        noise
            Its covariance (m, m), or the variances (m,) of independent parts.
        gate
            Greatest normalised innovation squared; beyond it nothing changes. Nor does it where
            anything is not finite, or the noise not positive: that tells nothing, and `nis` is
            NaN. A covariance of the state that is no longer good refuses all, `nis` being infinite.
        """
        h, at = np.atleast_2d(np.asarray(jacobian, np.float64)), np.asarray(columns)
        y = np.atleast_1d(np.asarray(innovation, np.float64))
        r = np.asarray(noise, np.float64)
        r = np.diag(r) if r.ndim == 1 else np.atleast_2d(r)
        if not (np.isfinite(r).all() and np.linalg.eigvalsh(r).min() > 0.0):
            return Outcome(np.nan, len(y), False)
        hp = h @ self._rows(at)
        return self.absorb(hp, hp[:, at] @ h.T + r, y, gate)

    def absorb(
        self, hp: Array, expected: Array, innovation: Array, gate: float = np.inf
    ) -> Outcome:
        """Take in an innovation (m,) by its Jacobian times the covariance (m, size).

        `expected` (m, m) is the innovation's covariance. Overwrites `hp`.
        """
        outcome, lower = compared(innovation, expected, gate)
        if not outcome.taken:
            return outcome
        # (L^-1 H P)' = (H P)' L^-T, in place: the transposed array is in Fortran's order.
        w = np.ascontiguousarray(dtrsm(1.0, lower.T, hp.T, side=1, lower=0, overwrite_b=1).T)
        error = outcome.white @ w
        awake = self._awake()
        if awake is not None:
            error[self.head :][self._rests] = 0.0
        if not np.isfinite(error).all():
            return Outcome(np.inf, len(innovation), False)
        self._take_off(w, awake)
        self.correct(error)
        return outcome

    def inform(
        self,
        part: Index,
        information: Array,
        vector: Array,
        gate: float = np.inf,
        *,
        chance: float = 0.0,
    ) -> Outcome:
        """Take in information (k, k) and its vector (k,) on the errors at `part` (k,).

        Written without the inverse of the covariance, which is singular while two poses coincide:
        the information is that of independent measurements of unit variance along its axes, and
        what these take off the covariance is a square, so that rounding leaves it symmetric.
        The outcome's `nis` is the squared Mahalanobis distance of the correction. Nothing changes
        where it exceeds `gate`, or where good information would be as far off with less than a
        `chance`. Nor does it where anything is not finite, `nis` being NaN then, or where the
        covariance is no longer good, `nis` being infinite.
        """
        k = len(part)
        if not (np.isfinite(information).all() and np.isfinite(vector).all()):
            return Outcome(np.nan, k, False)
        own = self.own(part)
        try:
            rows, measured, white = _as_measurements(own, information, vector)
            hp = rows @ self._rows(part)
            lower = np.linalg.cholesky(np.eye(len(rows)) + hp[:, part] @ rows.T)
        except np.linalg.LinAlgError:
            # Rounding has eaten the covariance: nothing can be told from it any more.
            return Outcome(np.inf, k, False)
        distance, degrees = float(white @ white), len(measured)
        if not (distance <= gate and chdtrc(max(degrees, 1), distance) >= chance):
            return Outcome(distance, degrees, False)
        w = solve_triangular(lower, hp, lower=True, check_finite=False)
        error = solve_triangular(lower, measured, lower=True, check_finite=False) @ w
        if not np.isfinite(error).all():
            return Outcome(np.inf, degrees, False)
        with one_blas_thread():
            self._take_off(w, None)
        self.correct(error)
        return Outcome(distance, degrees, True, white)

    def correct(self, error: Array) -> None:
        """Add estimated errors (size,) to the lander and to all that listen.

        What is measured of velocity is measured along body axes: known is its error and, with it,
        the tilt times the velocity. When the velocity is corrected that product stays what it is
        known to be, so that the error of the velocity moves with the tilt by as much. That is the
        covariance of an invariant filter (Barrau and Bonnabel 2017), whose Jacobians do not depend
        on the estimate; had it stayed, velocities that are learnt bit by bit would pass for
        knowledge of the tilt.

        Raises
        ------
        InputError
            If it is not `size` finite numbers; nothing changes then.
        """
        error = np.asarray(error, np.float64)
        if error.shape != (self.size,) or not np.isfinite(error).all():
            raise InputError("navigation.error", error.shape, f"{self.size} finite numbers")
        change = error[VELOCITY]
        if np.abs(change).max() > _TELLING:
            lever = np.cross(np.eye(3), change) @ quat_to_matrix(self.inertial.attitude)
            p = self._for(POSE)
            p[VELOCITY] -= lever @ p[ATTITUDE]
            p[:, VELOCITY] -= p[:, ATTITUDE] @ lever.T
        self.inertial.correct(error[:INERTIAL])
        for name, place in self._blocks.items():
            self._values[name] += error[place]
        for listener in self.listeners:
            listener(error)


def compared(innovation: Array, expected: Array, gate: float) -> tuple[Outcome, Array]:
    """Return what an innovation (m,) is against its covariance, and that one's Cholesky factor.

    It is taken if its normalised square is at most `gate`. One that is not finite tells nothing
    (`nis` is NaN); a covariance (m, m) that is no longer good refuses all, `nis` being infinite.
    """
    m = len(innovation)
    if not np.isfinite(innovation).all():
        return Outcome(np.nan, m, False), expected
    if not np.isfinite(expected).all():
        return Outcome(np.inf, m, False), expected
    try:
        lower: Array = np.asarray(np.linalg.cholesky(0.5 * (expected + expected.T)))
    except np.linalg.LinAlgError:
        # Rounding has eaten the covariance: nothing can be told from it any more.
        return Outcome(np.inf, m, False), expected
    white = solve_triangular(lower, innovation, lower=True, check_finite=False)
    nis = float(white @ white)
    if not nis <= gate:
        return Outcome(nis, m, False), lower
    return Outcome(nis, m, True, white), lower


def _as_measurements(own: Array, information: Array, vector: Array) -> tuple[Array, Array, Array]:
    """Return what information on errors of covariance (k, k) tells, as measurements.

    With P = L L' before, M = L' I L and u = L' v, u has the covariance M + M^2 (I being that of v's
    noise). Only directions in which it tells something are taken: in others a trace of what is not
    modelled looks like many deviations, and moves the errors by as many, over and over.

    Returns
    -------
    rows, measured
        Jacobian (m, k) and innovation (m,) of measurements of unit variance.
    white
        The whitened innovation (k,) along the axes of L, the same in every measurement.
    """
    unit = np.sqrt(np.maximum(own.diagonal(), 1e-300))
    correlation = own / np.outer(unit, unit)
    lower = np.linalg.cholesky(correlation + _SINGULAR * np.eye(len(own))) * unit[:, None]
    told, axes = np.linalg.eigh(lower.T @ information @ lower)
    kept = told > _LEAST_TOLD
    told, axes = told[kept], axes[:, kept]
    root = np.sqrt(told)
    measured = axes.T @ (lower.T @ vector) / root
    rows = solve_triangular(lower, axes * root, trans="T", lower=True, check_finite=False).T
    return rows, measured, axes @ (measured / np.sqrt(1.0 + told))


def _samples(angle: ArrayLike, velocity: ArrayLike) -> tuple[Array, Array]:
    """Return inertial samples (n, 3) of both kinds, checked."""
    out = []
    for name, values in (("angle", angle), ("velocity", velocity)):
        array = np.atleast_2d(np.asarray(values, dtype=np.float64))
        if array.ndim != 2 or array.shape[1] != 3:
            shape = np.shape(values)
            raise InputError(f"inertial.{name}", shape, "samples (n, 3), NaN for a missing one")
        out.append(array)
    if len(out[0]) != len(out[1]):
        lengths = tuple(len(a) for a in out)
        raise InputError("inertial.samples", lengths, "as many of angle as of velocity")
    return out[0], out[1]


def _covariance(name: str, given: ArrayLike) -> Array:
    own = np.atleast_2d(np.asarray(given, dtype=np.float64))
    good = own.ndim == 2 and own.shape[0] == own.shape[1] and np.isfinite(own).all()
    # Singular ones are good; rounding makes their least eigenvalue a little negative.
    good = good and own.size > 0 and np.allclose(own, own.T)
    if not (good and np.linalg.eigvalsh(own).min() >= -1e-12 * np.abs(own).max()):
        raise InputError(name, np.shape(given), "a symmetric covariance that is not negative")
    return own
