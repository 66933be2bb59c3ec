"""Columns of a covariance that are brought up to date only when somebody asks for them.

Of errors that rest the block among themselves stays as it is, while their correlations with others
change with each measurement (`RestingErrors.rest`). These stand in the matrix twice: in the rows of
the others, which lie in one piece each, and in their columns, of which each entry costs a line of
the cache. So the rows are kept up and the columns lag behind in the rows of errors that rest, until
these are used. What an error that begins or ceases to rest changes is few columns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim._jit import threads_for
from lunarsim.onboard.navigation._rock_filter_kernels import take_over_columns

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Lag:
    """Whether columns of errors that do not rest lag behind in the rows of those that do.

    Attributes
    ----------
    behind
        Whether they do.
    """

    def __init__(self) -> None:
        self.behind = False

    def catch_up(self, p: Array, rests: Flags) -> None:
        """Bring the symmetric p (n, n) up to date, of which errors `rests` (n,) rest."""
        if self.behind:
            self.behind = False
            _take_over(p, np.flatnonzero(rests), np.flatnonzero(~rests))

    def change(self, p: Array, before: Flags, now: Flags) -> None:
        """Let other errors `now` (n,) rest than did before (n,), of the symmetric p (n, n)."""
        if not self.behind:
            return
        begin, cease = np.flatnonzero(~before & now), np.flatnonzero(before & ~now)
        resting, awake = np.flatnonzero(before), np.flatnonzero(~before)
        if len(begin) + len(cease) > len(awake) // 2:
            self.catch_up(p, before)
            return
        _take_over(p, resting, begin)
        _take_over(p, cease, awake)


def _take_over(p: Array, rows: Index, columns: Index) -> None:
    """Let rows of the symmetric p have in columns what stands in the rows of these, mirrored."""
    with threads_for(2e-3 * len(rows) * len(columns)):
        take_over_columns(p, rows, columns)
