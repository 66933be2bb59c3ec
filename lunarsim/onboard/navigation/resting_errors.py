"""A covariance of many errors, of which some may rest, kept up no sooner than it is asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim._blas import one_blas_thread
from lunarsim.onboard.navigation.covariance_update import subtract_square
from lunarsim.onboard.navigation.lag import Lag
from lunarsim.onboard.navigation.put_off import PutOff

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class RestingErrors:
    """Covariance of errors: a head that measurements always correct, and a tail that may rest.

    What measurements take off the tail is put off (`PutOff`), and columns lag (`Lag`), until they
    are asked for.

    Parameters
    ----------
    head
        Covariance of the head at the start (k, k).
    capacity
        Errors in the tail for which room is made at first; it grows as needed.

    Attributes
    ----------
    head
        Number of errors of the head.
    tail
        Number of those behind them.
    """

    def __init__(self, head: Array, capacity: int = 0) -> None:
        self.head, self.tail = len(head), 0
        self._p = np.zeros((self.head + capacity,) * 2)
        self._p[: self.head, : self.head] = head
        self._rests = np.zeros(0, np.bool_)
        self._put_off = PutOff()
        self._lag = Lag()

    @property
    def size(self) -> int:
        """Number of errors."""
        return self.head + self.tail

    @property
    def rests(self) -> NDArray[np.bool_]:
        """Which errors of the tail rest (tail,); empty if none has yet."""
        return self._rests

    @property
    def p(self) -> Array:
        """Covariance of all errors, with room for more behind them."""
        self._settle()
        self._catch_up()
        return self._p

    def for_rows(self, *rows: ArrayLike) -> Array:
        """Return `p` where only rows of some errors (...) are used, and blocks of rocks.

        Columns may lag in other rows, see `Lag`.
        """
        self._settle()
        if self._lag.behind and any(self._rest(at).any() for at in rows):
            self._catch_up()
        return self._p

    def between(self, one: Index, other: Index) -> Array:
        """Return the covariances of pairs of errors (...)."""
        self._settle()
        if self._lag.behind:
            one, other = np.broadcast_arrays(one, other)
            turned = self._rest(one)
            one, other = np.where(turned, other, one), np.where(turned, one, other)
        return np.asarray(self._p[one, other])

    def _rest(self, errors: ArrayLike) -> NDArray[np.bool_]:
        """Tell which errors (...) rest."""
        behind = np.asarray(errors) - self.head
        known = (behind >= 0) & (behind < len(self._rests))
        rests = np.zeros(behind.shape, np.bool_)
        rests[known] = self._rests[behind[known]]
        return rests

    def _catch_up(self) -> None:
        """Bring columns up to date that lag behind."""
        n = len(self._rests)
        self._lag.catch_up(self._p[self.head :, self.head :][:n, :n], self._rests)

    def _settle(self) -> None:
        """Take in what has been put off: of the head it has been taken in at once."""
        if self._put_off.rows:
            if self._put_off.of_all:
                self._catch_up()
            with one_blas_thread():
                self._lag.behind |= self._put_off.settle(self._p[self.head :, self.head :])

    @property
    def covariance(self) -> Array:
        """Of all errors (size, size)."""
        return np.asarray(self.p[: self.size, : self.size])

    def own(self, columns: ArrayLike) -> Array:
        """Return the covariance of some errors (k, k); of lander and blocks it costs nothing."""
        at = np.asarray(columns)
        return np.asarray(self._for(at)[np.ix_(at, at)])

    def _rows(self, at: Index) -> Array:
        """Return rows of the covariance (k, size)."""
        return np.asarray(self._for(at)[at])

    def _for(self, *columns: ArrayLike) -> Array:
        """Return the covariance where only rows of some errors (k,) are used.

        And columns among them. Those of lander and blocks are never put off.
        """
        last = max(int(np.max(at, initial=0)) for at in columns)
        held = self._p if last < self.head else self.for_rows(*columns)
        return np.asarray(held[: self.size, : self.size])

    def reserve(self, tail: int) -> None:
        """Make room for so many errors behind the blocks."""
        if self.head + tail <= len(self._p):
            return
        grown = np.zeros((self.head + max(tail, 2 * (len(self._p) - self.head)),) * 2)
        grown[: self.size, : self.size] = self.covariance
        self._p = grown

    def keep(self, tail: int, to: Index, source: Index) -> None:
        """Let errors at `source` (k,) take places `to` (k,); keep so many behind the blocks."""
        p, size = self.for_rows(), self.size
        p[to, :size] = p[source, :size]
        p[:size, to] = p[:size, source]
        rests = self._rests.copy()
        if len(rests):
            rests[to - self.head] = rests[source - self.head]
        self._rests, self.tail = rests[:tail], tail

    def put(self, at: Index, rows: Array) -> None:
        """Give some errors (k,) rows of the covariance (k, size), and the columns that go with it.

        Columns may lag in rows of errors that rest.
        """
        self._settle()
        p, size, awake = self._p, self.size, self._awake()
        p[at, :size] = rows
        if awake is None or self._rest(at).any():
            p[:size, at] = rows.T
        else:
            others = np.concatenate((np.arange(self.head), self.head + awake))
            p[others[:, None], at] = rows[:, others].T
            self._lag.behind = True

    def rest(self, tail: NDArray[np.bool_]) -> None:
        """Leave errors behind the blocks (tail,) as they are until told otherwise.

        Measurements of others correct neither them nor their own covariance, while their
        correlations with what is corrected are kept up, so that the covariance stays that of the
        errors (Schmidt's consider filter; Jazwinski 1970, section 8.4). A measurement then takes
        time in proportion to the number of errors, and not to its square.
        """
        if not np.array_equal(tail, self._rests):
            self._settle()  # What was put off is of those that rested till now.
            n = min(len(tail), len(self._rests))
            own = self._p[self.head :, self.head :][:n, :n]
            self._lag.change(own, self._rests[:n], tail[:n])
            self._rests = tail

    def _awake(self) -> Index | None:
        """Return the errors behind the head that measurements correct; None for all of them."""
        # Correcting half of all alone costs as much as correcting all of them.
        if 2 * np.count_nonzero(self._rests) < max(self.tail, 1):
            return None
        return np.flatnonzero(~self._rests)

    def _take_off(self, w: Array, awake: Index | None) -> None:
        """Take w' w off the covariance, w being (m, size): of what stands behind the head later on.

        Parameters are those of `PutOff.add`, `awake` being counted from the head on.
        """
        n, p = self.head, self._for(self.head - 1)
        if self.tail == 0:
            subtract_square(p, w)
            return
        with one_blas_thread():
            p[:n] -= w[:, :n].T @ w
        p[:n, :n] = 0.5 * (p[:n, :n] + p[:n, :n].T)
        p[n:, :n] = p[:n, n:].T
        self._put_off.add(np.ascontiguousarray(w[:, n:]), awake)
        if self._put_off.full:
            self._settle()
