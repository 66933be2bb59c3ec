"""Deferred covariance updates: collect several measurements for one pass.

A measurement subtracts w' w from the covariance of all errors. With thousands of rocks each pass
reads and writes hundreds of megabytes, for an altitude as much as for an image. The squares are
additive, so that several of them can be subtracted in one pass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.navigation.covariance_update import subtract_rows, subtract_square

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Maximum number of deferred rows: a larger number does not reduce the cost per row.
_MOST = 256


class PutOff:
    """Matrix squares that are still to be subtracted from a symmetric matrix.

    The covariance block of frozen rows does not change; see `RestingErrors.rest`.
    """

    def __init__(self) -> None:
        self._of_all: list[Array] = []
        self._of_awake: list[Array] = []
        self._awake: Index | None = None

    @property
    def rows(self) -> int:
        """Number of deferred rows."""
        return sum(len(w) for w in (*self._of_all, *self._of_awake))

    @property
    def full(self) -> bool:
        """Whether the deferred rows must be subtracted before more are added."""
        return self.rows >= _MOST

    def add(self, w: Array, awake: Index | None) -> None:
        """Defer the subtraction of w' w, for w (m, n).

        Parameters
        ----------
        w
            One row for each scalar measurement.
        awake
            Indices of the rows that are not frozen (k,), constant until `settle`; None for all.
        """
        if len(w) == 0:
            return
        if awake is None:
            self._of_all.append(w)
        else:
            self._of_awake.append(w)
            self._awake = awake

    @property
    def of_all(self) -> bool:
        """Whether a deferred update applies to all rows, including frozen ones."""
        return bool(self._of_all)

    def settle(self, p: Array) -> bool:
        """Subtract all deferred squares from the first n rows and columns of p, in place.

        Returns
        -------
        lags
            Whether the columns of active rows are out of date in the frozen rows.
        """
        lags = False
        if self._of_all:
            w = np.concatenate(self._of_all)
            n = w.shape[1]
            subtract_square(p[:n, :n], w)
        if self._of_awake and self._awake is not None:
            w, n = np.concatenate(self._of_awake), self._of_awake[0].shape[1]
            subtract_rows(p[:n, :n], w, self._awake)
            lags = 0 < len(self._awake) < n
        self._of_all, self._of_awake, self._awake = [], [], None
        return lags
