"""Deferred covariance updates: collect several measurements for one pass.

A measurement subtracts w' w from the covariance of all errors. With thousands of rocks each pass
reads and writes hundreds of megabytes, for an altitude as much as for an image. The squares are
additive, so that several of them can be subtracted in one pass.
"""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.navigation.covariance_update import subtract_rows, subtract_square
from lunarsim.typing import Array, IntArray

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
        """Subtract all queued products from the first n rows and columns of p, in place.

        The return value states whether the columns of active errors are now out of date in the rows
        of frozen errors.
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
