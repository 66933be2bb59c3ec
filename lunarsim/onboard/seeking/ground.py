"""The ground that is worth looking at, as the lander believes it to be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.policies.reach import heights_on
from lunarsim.onboard.seeking.information import entropy

Array = NDArray[np.float64]


def nodes_of(hazard_map: HazardMap, side: int, prior: float, site: Array) -> Array:
    """Return squares of the ground of a map as the planner takes them (side^2, 5).

    Their middles (3), weight and the share of the uncertainty that the map has taken away already:
    ``1 - E[H(p)] / H(prior)``, at the prior's where nothing was observed. The weight is the share
    of a square that the mission lets the lander land on.

    Parameters
    ----------
    hazard_map
        As it stands.
    side
        Squares along a side of the map.
    prior
        Probability of a hazard before anything is seen.
    site
        The site (3,), m: its height counts where the map knows none.
    """
    fine = hazard_map.grid
    posting = max(fine.shape) * fine.posting / side
    grid = Grid.centred(fine.centre, side * posting, posting)
    whole = float(entropy(prior))
    left = np.where(hazard_map.observed, entropy(1.0 - hazard_map.p_safe), whole)
    known = 1.0 - np.minimum(_averaged(left, side) / whole, 1.0)
    allowed = np.ones(fine.shape) if hazard_map.eligible is None else hazard_map.eligible
    weight = _averaged(np.asarray(allowed, dtype=np.float64), side)
    place = grid.centres().reshape(-1, 2)
    height = heights_on(grid, hazard_map, float(site[2])).ravel()
    return np.column_stack((place, height, weight.ravel(), known.ravel()))


def _averaged(layer: Array, side: int) -> Array:
    """Return means over equal squares of a layer (side, side); nothing beyond it counts."""
    rows, cols = layer.shape
    most = max(rows, cols)
    # Shares of each row and column of cells that lie in each row and column of squares.
    edges = np.linspace(0.0, most, side + 1)

    def shares(count: int) -> Array:
        first = np.arange(count) + 0.5 * (most - count)
        low, high = np.maximum(edges[:-1, None], first), np.minimum(edges[1:, None], first + 1.0)
        return np.asarray(np.maximum(high - low, 0.0))

    of_rows, of_cols = shares(rows), shares(cols)
    area = np.outer(of_rows.sum(1), of_cols.sum(1))
    return np.asarray((of_rows @ layer @ of_cols.T) / np.where(area > 0.0, area, 1.0))
