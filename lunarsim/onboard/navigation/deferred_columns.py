"""Deferred update of covariance columns until they are read.

The covariance block of the frozen errors does not change, but their correlations with the other
errors change with each measurement (`SchmidtKalmanCovariance.rest`). These correlations are stored
twice: in the rows of the other errors, which are contiguous in memory, and in their columns, where
each entry costs a cache line. Therefore only the rows are updated. The columns are copied when the
rows of frozen errors are read. If an error is frozen or released, only a few columns must be
copied.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim._jit import threads_for
from lunarsim.onboard.navigation._rock_filter_kernels import mirror_columns

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]


class DeferredColumns:
    """Mirror the columns of active errors in the rows of frozen errors on demand.

    Attributes
    ----------
    is_outdated
        Whether these columns are out of date.
    """

    def __init__(self) -> None:
        self.is_outdated = False

    def catch_up(self, p: Array, is_frozen: Flags) -> None:
        """Update the columns of the symmetric p (n, n) for frozen errors (n,)."""
        if self.is_outdated:
            self.is_outdated = False
            _take_over(p, np.flatnonzero(is_frozen), np.flatnonzero(~is_frozen))

    def change_frozen(self, p: Array, before: Flags, now: Flags) -> None:
        """Change the frozen errors of the symmetric p (n, n) from `before` to `now` (n,)."""
        if not self.is_outdated:
            return
        begin, cease = np.flatnonzero(~before & now), np.flatnonzero(before & ~now)
        resting, active = np.flatnonzero(before), np.flatnonzero(~before)
        if len(begin) + len(cease) > len(active) // 2:
            self.catch_up(p, before)
            return
        _take_over(p, resting, begin)
        _take_over(p, cease, active)


def _take_over(p: Array, rows: Index, columns: Index) -> None:
    """Copy p[columns, rows]' to p[rows, columns]."""
    with threads_for(2e-3 * len(rows) * len(columns)):
        mirror_columns(p, rows, columns)
