"""What measurements take off a covariance, put off until somebody asks for it.

A measurement takes w' w off the covariance of all errors. Of thousands of rocks that is hundreds of
megabytes to read and write, whatever was measured: an altitude costs as much as a picture. Squares
add up, so that many of them are taken off in one pass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.navigation.covariance_update import subtract_rows, subtract_square

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# So many rows are put off at most: more would not make a pass any cheaper for each.
_MOST = 256


class PutOff:
    """Squares that are still to be taken off a symmetric matrix.

    Of rows that rest, the block among themselves stays as it is: see `RestingErrors.rest`.
    """

    def __init__(self) -> None:
        self._of_all: list[Array] = []
        self._of_awake: list[Array] = []
        self._awake: Index | None = None

    @property
    def rows(self) -> int:
        """How many rows are put off."""
        return sum(len(w) for w in (*self._of_all, *self._of_awake))

    @property
    def full(self) -> bool:
        """Whether they are to be taken off before there are more."""
        return self.rows >= _MOST

    def add(self, w: Array, awake: Index | None) -> None:
        """Put off taking w' w off, w being (m, n).

        Parameters
        ----------
        w
            A row for each number that was measured.
        awake
            Rows that do not rest (k,), the same until `settle`; None: all.
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
        """Whether any of it is to be taken off rows that rest."""
        return bool(self._of_all)

    def settle(self, p: Array) -> bool:
        """Take all of it off the matrix p in place, of which these are the first n rows.

        Returns
        -------
        lags
            Whether columns of rows that do not rest are left as they were in those that rest.
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
