"""Schmidt-Kalman covariance with frozen errors and deferred updates."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim._blas import one_blas_thread
from lunarsim.onboard.navigation.covariance_update import subtract_square
from lunarsim.onboard.navigation.deferred_columns import DeferredColumns
from lunarsim.onboard.navigation.deferred_updates import DeferredUpdates
from lunarsim.typing import Array, BoolArray, IntArray


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

        The columns of these errors in other rows may be out of date, except within the block of one
        rock.
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
        """Return which of the errors with given indices (...) are frozen."""
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
