"""Deferred update of covariance columns until they are read.

The covariance block of the frozen errors does not change, but their correlations with the other
errors change with each measurement (`SchmidtKalmanCovariance.freeze_tail`). These correlations are
stored twice: in the rows of the other errors, which are contiguous in memory, and in their columns,
where each entry costs a cache line. Therefore only the rows are updated. The columns are copied
when the rows of frozen errors are read. If an error is frozen or released, only a few columns must
be copied.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import threads_for
from lunarsim.onboard.navigation._rock_filter_kernels import mirror_columns
from lunarsim.typing import Array, BoolArray, IntArray

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
