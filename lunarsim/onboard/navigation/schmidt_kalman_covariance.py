"""Schmidt-Kalman covariance with frozen errors and deferred updates.

The covariance block of the frozen errors does not change, but their correlations with the other
errors change with each measurement (`SchmidtKalmanCovariance.freeze_tail`). These correlations are
stored twice: in the rows of the other errors, which are contiguous in memory, and in their columns,
where each entry costs a cache line. Therefore only the rows are updated. The columns are copied
when the rows of frozen errors are read. If an error is frozen or released, only a few columns must
be copied.

A measurement subtracts w' w from the covariance of all errors. With thousands of rocks each pass
reads and writes hundreds of megabytes, for an altitude as much as for an image. The squares are
additive, so that several of them can be subtracted in one pass.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from lunarsim._blas import one_blas_thread
from lunarsim._jit import threads_for
from lunarsim.errors import InputError
from lunarsim.onboard.navigation._rock_filter_kernels import (
    mirror_columns,
    mirror_lower,
    subtract_product_from_rows,
    subtract_square_from_rows,
)
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.value_checks import check_elements

_BLOCK = 384
_ROWS = 64
# Up to this number of rows in w, row by row is faster than a matrix product.
_FEW = 6


def subtract_square(p: Array, w: Array) -> None:
    """Subtract w' w of a Kalman update from the symmetric covariance p, in place.

    `p` is (n, n) and `w` (m, n). For small m this is done row by row, otherwise in blocks above the
    diagonal that fit the cache. The blocks are distributed over threads; the result does not depend
    on the number of threads.
    """
    n = len(p)
    if len(w) <= _FEW:
        subtract_rows(p, w, np.arange(n))
        return

    def subtract(start: int) -> None:
        stop = min(start + _BLOCK, n)
        p[start:stop, start:] -= w[:, start:stop].T @ w[:, start:]
        p[stop:, start:stop] = p[start:stop, stop:].T

    _run_in_threads(subtract, range(0, n, _BLOCK))


def subtract_rows(p: Array, w: Array, states: IntArray) -> None:
    """Subtract w' w of a Kalman update from some rows of the covariance p, in place.

    `states` (s,) are the indices of the rows; `p` (n, n) is symmetric; `w` is (m, n). The block of
    `states` stays symmetric; their columns in other rows are not changed. The rows are distributed
    over threads; the result does not depend on the number of threads.
    """
    if len(w) <= _FEW:
        with threads_for(4e-4 * len(w) * len(states) * len(p)):
            subtract_square_from_rows(p, w, states)
        return
    own = np.ascontiguousarray(w[:, states].T)

    def subtract(start: int) -> None:
        block = slice(start, start + _ROWS)
        subtract_product_from_rows(p, own[block] @ w, states[block])

    _run_in_threads(subtract, range(0, len(states), _ROWS))
    with threads_for(1e-3 * len(states) ** 2):
        mirror_lower(p, states)


def _run_in_threads(job: Callable[[int], None], starts: range) -> None:
    """Run a function for each start index, distributed over the kernels' threads."""
    threads = numba.get_num_threads()
    if threads == 1 or len(starts) == 1:
        for start in starts:
            job(start)
    else:
        list(_threads(threads).map(job, starts))


@lru_cache(maxsize=1)
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count)


# Relative variance added so that the correlation of nearly equal errors is positive definite.
_REGULARISATION = 1e-9


def inflate(p: Array, columns: ArrayLike, factor: float, max_sigma: ArrayLike) -> None:
    """Multiply the conditional variances of some errors in a covariance by a factor.

    Each error is the sum of its regression on the other errors and a residual. Only the residual is
    inflated, so that the correlations remain valid. If the total variance were inflated, a later
    measurement of a difference would create information. Example: two heights have standard
    deviations of 5 m and are known to be equal to 2 cm. If one variance is inflated in full, a
    measurement of their difference makes both seem known to be near zero.

    Parameters
    ----------
    p
        Covariance (n, n), changed in place.
    columns
        Distinct indices of the errors (k,).
    factor
        Factor on the variances, 1 or more.
    max_sigma
        Maximum standard deviations (k,) after the inflation, or one for all.

    Raises
    ------
    InputError
        If the factor is below 1 or not finite, or a standard deviation is negative or NaN.
    """
    if not 1.0 <= factor < np.inf:
        raise InputError("factor", factor, "must be 1 or more, and finite")
    check_elements("max_sigma", max_sigma, np.asarray(max_sigma) >= 0.0, "must be 0 or more")
    at = np.asarray(columns, dtype=np.int64)
    explained = _explained_covariance(p, at)
    covariance = p[np.ix_(at, at)]
    residual = covariance - explained
    # If rounding made a variance negative, all updates are rejected anyway; do not worsen it here.
    variance = np.maximum(residual.diagonal(), 0.0)
    headroom = np.square(max_sigma) - np.maximum(explained.diagonal(), 0.0)
    scale = np.sqrt(np.clip(headroom / np.maximum(variance, 1e-300), 1.0, factor))
    p[np.ix_(at, at)] = covariance + (np.outer(scale, scale) - 1.0) * residual


def _explained_covariance(p: Array, indices: IntArray) -> Array:
    """Return the covariance (k, k) of some errors explained by all other errors.

    This is the covariance of the regression of the errors `indices` (k,) on the others; `p` (n, n)
    is the covariance of all errors. The result is zero if `p` is not positive definite.
    """
    others = np.setdiff1d(np.arange(len(p)), indices)
    unit = np.sqrt(np.maximum(p.diagonal()[others], 1e-300))
    cross = p[np.ix_(indices, others)] / unit
    correlation = p[np.ix_(others, others)] / np.outer(unit, unit)
    correlation.flat[:: len(others) + 1] += _REGULARISATION
    try:
        explained = cross @ cho_solve(cho_factor(correlation), cross.T)
    except (np.linalg.LinAlgError, ValueError):
        # Not positive definite or not finite: all later measurements are rejected in any case.
        return np.zeros((len(indices), len(indices)))
    return np.asarray(0.5 * (explained + explained.T))


Flags = BoolArray


class DeferredColumns:
    """Copies covariances between active and frozen errors only when they are read.

    Active errors are those that measurements currently correct; frozen errors are not corrected.
    Their covariances are kept up to date in the rows of the active errors. The equal entries in the
    rows of the frozen errors may be outdated.

    Attributes
    ----------
    is_outdated
        Whether entries in the rows of the frozen errors are out of date.
    """

    def __init__(self) -> None:
        self.is_outdated = False

    def catch_up(self, p: Array, is_frozen: Flags) -> None:
        """Update the outdated entries of the symmetric covariance p (n, n) in place.

        `is_frozen` (n,) marks the frozen errors.
        """
        if self.is_outdated:
            self.is_outdated = False
            _mirror(p, np.flatnonzero(is_frozen), np.flatnonzero(~is_frozen))

    def change_frozen(self, p: Array, was_frozen: Flags, is_frozen: Flags) -> None:
        """Update the entries of p (n, n) that a change of the frozen errors requires.

        `was_frozen` and `is_frozen` (n,) mark the frozen errors before and after the change. `p` is
        the symmetric covariance, changed in place.
        """
        if not self.is_outdated:
            return
        begin, cease = (
            np.flatnonzero(~was_frozen & is_frozen),
            np.flatnonzero(was_frozen & ~is_frozen),
        )
        resting, active = np.flatnonzero(was_frozen), np.flatnonzero(~was_frozen)
        if len(begin) + len(cease) > len(active) // 2:
            self.catch_up(p, was_frozen)
            return
        _mirror(p, resting, begin)
        _mirror(p, cease, active)


def _mirror(p: Array, rows: IntArray, columns: IntArray) -> None:
    """Copy p[columns, rows]' to p[rows, columns] of a symmetric matrix, in place."""
    with threads_for(2e-3 * len(rows) * len(columns)):
        mirror_columns(p, rows, columns)


# Maximum number of deferred rows: a larger number does not reduce the cost per row.
_MAX_ROWS = 256


class DeferredUpdates:
    """Queue of matrix products w' w to be subtracted from a covariance in one pass.

    Each row of w belongs to one scalar measurement. Some errors can be frozen: the covariances
    among frozen errors do not change.
    """

    def __init__(self) -> None:
        self._full_rows: list[Array] = []
        self._active_rows: list[Array] = []
        self._active: IntArray | None = None

    @property
    def rows(self) -> int:
        """Number of queued rows, one for each scalar measurement."""
        return sum(len(w) for w in (*self._full_rows, *self._active_rows))

    @property
    def is_full(self) -> bool:
        """Whether the queued rows must be subtracted before more are added."""
        return self.rows >= _MAX_ROWS

    def add(self, w: Array, active: IntArray | None) -> None:
        """Queue the subtraction of w' w from the covariance, for w (m, n).

        `w` has a row for each scalar measurement and a column for each error. `active` (k,) are the
        indices of the errors that are not frozen, constant until `apply`; None for all.
        """
        if len(w) == 0:
            return
        if active is None:
            self._full_rows.append(w)
        else:
            self._active_rows.append(w)
            self._active = active

    @property
    def affects_frozen(self) -> bool:
        """Whether a queued update applies to all errors, including frozen ones.

        Frozen errors are not corrected by measurements.
        """
        return bool(self._full_rows)

    def apply(self, p: Array) -> bool:
        """Subtract all queued products from a covariance p in place; empty the queue.

        The products are (n, n); `p` may be larger, but only its first n rows and columns change.
        The return value states whether the columns of active errors are now out of date in the
        rows of frozen errors.
        """
        is_outdated = False
        if self._full_rows:
            w = np.concatenate(self._full_rows)
            n = w.shape[1]
            subtract_square(p[:n, :n], w)
        if self._active_rows and self._active is not None:
            w, n = np.concatenate(self._active_rows), self._active_rows[0].shape[1]
            subtract_rows(p[:n, :n], w, self._active)
            is_outdated = 0 < len(self._active) < n
        self._full_rows, self._active_rows, self._active = [], [], None
        return is_outdated


class SchmidtKalmanCovariance:
    """Error covariance of a Schmidt-Kalman filter, with frozen errors.

    The covariance consists of a head, whose errors every measurement corrects, and a tail, whose
    errors can be frozen: measurements do not correct frozen errors. The updates of the tail are
    deferred (`DeferredUpdates`, `DeferredColumns`) until its covariance is read.

    Parameters
    ----------
    head
        Initial covariance of the head (k, k).
    capacity
        Initial number of tail errors to allocate; it grows as needed.

    Attributes
    ----------
    head
        Number of errors in the head.
    tail
        Number of errors in the tail.
    """

    def __init__(self, head: Array, capacity: int = 0) -> None:
        self.head, self.tail = len(head), 0
        self._p = np.zeros((self.head + capacity,) * 2)
        self._p[: self.head, : self.head] = head
        self._frozen = np.zeros(0, np.bool_)
        self._deferred = DeferredUpdates()
        self._columns = DeferredColumns()

    @property
    def size(self) -> int:
        """Number of errors in head and tail."""
        return self.head + self.tail

    @property
    def is_frozen(self) -> BoolArray:
        """Whether each error of the tail is frozen (tail,).

        The array is empty before the first call of `freeze_tail`.
        """
        return self._frozen

    @property
    def p(self) -> Array:
        """Covariance array of all errors; rows beyond `size` are unused allocated space."""
        self._apply_deferred()
        self._catch_up()
        return self._p

    def covariance_for_rows(self, *rows: ArrayLike) -> Array:
        """Return the covariance array `p`, up to date in the rows of given errors.

        `rows` are indices of these errors; without any, only the rows of errors that are not
        frozen are up to date. The columns of these errors in other rows may be out of date, except
        within the block of one rock.
        """
        self._apply_deferred()
        if self._columns.is_outdated and any(self._are_frozen(at).any() for at in rows):
            self._catch_up()
        return self._p

    def pair_covariances(self, first: IntArray, second: IntArray) -> Array:
        """Return the covariances of pairs of errors, with indices `first` and `second`.

        All three arrays have the same shape (...).
        """
        self._apply_deferred()
        if self._columns.is_outdated:
            first, second = np.broadcast_arrays(first, second)
            is_swapped = self._are_frozen(first)
            first, second = np.where(is_swapped, second, first), np.where(is_swapped, first, second)
        return np.asarray(self._p[first, second])

    def _are_frozen(self, indices: ArrayLike) -> BoolArray:
        """Return which of the errors with given indices (...) are frozen.

        Errors of the head never are.
        """
        behind = np.asarray(indices) - self.head
        known = (behind >= 0) & (behind < len(self._frozen))
        is_frozen = np.zeros(behind.shape, np.bool_)
        is_frozen[known] = self._frozen[behind[known]]
        return is_frozen

    def _catch_up(self) -> None:
        """Update covariance entries in rows of frozen errors that are out of date."""
        n = len(self._frozen)
        self._columns.catch_up(self._p[self.head :, self.head :][:n, :n], self._frozen)

    def _apply_deferred(self) -> None:
        """Apply the deferred updates of the tail; updates of the head are never deferred."""
        if self._deferred.rows:
            if self._deferred.affects_frozen:
                self._catch_up()
            with one_blas_thread():
                self._columns.is_outdated |= self._deferred.apply(self._p[self.head :, self.head :])

    @property
    def covariance(self) -> Array:
        """Covariance of all errors (size, size)."""
        return np.asarray(self.p[: self.size, : self.size])

    def covariance_of(self, columns: ArrayLike) -> Array:
        """Return the covariance (k, k) of the errors with indices `columns` (k,).

        For errors of the head, no deferred update is applied.
        """
        at = np.asarray(columns)
        return np.asarray(self._current_covariance(at)[np.ix_(at, at)])

    def _rows(self, indices: IntArray) -> Array:
        """Return the covariance rows (k, size) of the errors with indices `indices` (k,)."""
        return np.asarray(self._current_covariance(indices)[indices])

    def _current_covariance(self, *columns: ArrayLike) -> Array:
        """Return the covariance (size, size), up to date in the rows of given errors.

        The columns are up to date only among the given errors. If all of them belong to the head,
        no deferred update is applied.
        """
        last = max(int(np.max(at, initial=0)) for at in columns)
        held = self._p if last < self.head else self.covariance_for_rows(*columns)
        return np.asarray(held[: self.size, : self.size])

    def reserve(self, tail_size: int) -> None:
        """Allocate space for `tail_size` errors in the tail."""
        if self.head + tail_size <= len(self._p):
            return
        grown = np.zeros((self.head + max(tail_size, 2 * (len(self._p) - self.head)),) * 2)
        grown[: self.size, : self.size] = self.covariance
        self._p = grown

    def move_and_truncate(self, tail_size: int, target: IntArray, source: IntArray) -> None:
        """Move errors of the tail to other indices, then shorten the tail.

        Errors at the indices `source` (k,) move to `target` (k,); afterwards the tail has
        `tail_size` errors.
        """
        p, size = self.covariance_for_rows(), self.size
        p[target, :size] = p[source, :size]
        p[:size, target] = p[:size, source]
        is_frozen = self._frozen.copy()
        if len(is_frozen):
            is_frozen[target - self.head] = is_frozen[source - self.head]
        self._frozen, self.tail = is_frozen[:tail_size], tail_size

    def set_rows(self, indices: IntArray, rows: Array) -> None:
        """Set the covariance rows (k, size) of some errors, and their columns.

        `indices` (k,) are those of the errors. In the rows of frozen errors the columns may stay
        out of date.
        """
        self._apply_deferred()
        p, size, active = self._p, self.size, self._active()
        p[indices, :size] = rows
        if active is None or self._are_frozen(indices).any():
            p[:size, indices] = rows.T
        else:
            others = np.concatenate((np.arange(self.head), self.head + active))
            p[others[:, None], indices] = rows[:, others].T
            self._columns.is_outdated = True

    def freeze_tail(self, is_frozen: BoolArray) -> None:
        """Freeze the tail errors that `is_frozen` (tail,) marks, until the next call.

        Measurements of other errors change neither the frozen errors nor the covariance among them,
        but the correlations of frozen errors with the corrected errors are updated. The covariance
        therefore remains correct (Schmidt's consider filter; Jazwinski 1970, section 8.4). The cost
        of a measurement is then proportional to the number of errors, and not to its square.
        """
        if not np.array_equal(is_frozen, self._frozen):
            self._apply_deferred()  # The deferred updates refer to the errors frozen so far.
            n = min(len(is_frozen), len(self._frozen))
            own = self._p[self.head :, self.head :][:n, :n]
            self._columns.change_frozen(own, self._frozen[:n], is_frozen[:n])
            self._frozen = is_frozen

    def _active(self) -> IntArray | None:
        """Return the indices of the active (not frozen) tail errors; None for all.

        If less than half of the tail is frozen, all errors are treated as active.
        """
        # If less than half of the tail is frozen, a full update costs no more.
        if 2 * np.count_nonzero(self._frozen) < max(self.tail, 1):
            return None
        return np.flatnonzero(~self._frozen)

    def _subtract(self, w: Array, active: IntArray | None) -> None:
        """Subtract w' w from the covariance, for w (n, size); defer this for the tail.

        `active` (k,) are the indices of tail errors that are not frozen, counted from the start of
        the tail; None for all.
        """
        n, p = self.head, self._current_covariance(self.head - 1)
        if self.tail == 0:
            subtract_square(p, w)
            return
        with one_blas_thread():
            p[:n] -= w[:, :n].T @ w
        p[:n, :n] = 0.5 * (p[:n, :n] + p[:n, :n].T)
        p[n:, :n] = p[:n, n:].T
        self._deferred.add(np.ascontiguousarray(w[:, n:]), active)
        if self._deferred.is_full:
            self._apply_deferred()
