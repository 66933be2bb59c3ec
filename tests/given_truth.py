"""Landing safety that a test states for each cell, in place of that of a terrain."""

from __future__ import annotations

import numpy as np

from lunarsim.world.truth import TruthMap


class GivenTruth:
    """Stand-in for `TerrainTruth`; `safe` and `known` are (rows, cols) of the grid."""

    def __init__(self, grid, safe, known=None):
        self.grid, self.safe = grid, safe
        self.known = np.ones(grid.shape, bool) if known is None else known

    def _at(self, values, xy):
        row, col = self.grid.cell(xy)
        inside = self.grid.contains(xy)
        return inside & values[np.where(inside, row, 0), np.where(inside, col, 0)]

    def is_safe_at(self, xy):
        return self._at(self.safe & self.known, xy)

    def is_known_at(self, xy):
        return self._at(self.known, xy)

    def within(self, bounds, max_cells=None):
        """Return the complete map, whatever the bounds."""
        flat = np.zeros(self.grid.shape, np.float32)
        return TruthMap(self.grid, flat, self.safe, self.known)
