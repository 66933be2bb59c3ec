"""Terrain nodes for the planner, from the current hazard map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.active_perception.information import entropy
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.policies.reachability import elevation_on_grid

Array = NDArray[np.float64]


def terrain_nodes(hazard_map: HazardMap, side: int, prior: float, site: Array) -> Array:
    """Divide a hazard map into squares; return position, weight and knowledge of each.

    The columns (side^2, 5) are the centre (3), m, the weight and the fraction of hazard uncertainty
    that the map has already removed: ``1 - E[H(p)] / H(prior)``, with the entropy H, and with the
    prior where nothing was observed. The weight is the fraction of the square on which the mission
    allows a landing.

    Parameters
    ----------
    hazard_map
        Current hazard map.
    side
        Number of squares along a side of the map.
    prior
        Probability of a hazard without any observation.
    site
        Landing site (3,), m; its height is used where the map has none.
    """
    fine = hazard_map.grid
    posting = max(fine.shape) * fine.posting / side
    grid = Grid.centred(fine.centre, side * posting, posting)
    prior_entropy = float(entropy(prior))
    left = np.where(hazard_map.observed, entropy(1.0 - hazard_map.p_safe), prior_entropy)
    known = 1.0 - np.minimum(_averaged(left, side) / prior_entropy, 1.0)
    allowed = np.ones(fine.shape) if hazard_map.eligible is None else hazard_map.eligible
    weight = _averaged(np.asarray(allowed, dtype=np.float64), side)
    place = grid.centres().reshape(-1, 2)
    height = elevation_on_grid(grid, hazard_map, float(site[2])).ravel()
    return np.column_stack((place, height, weight.ravel(), known.ravel()))


def _averaged(layer: Array, side: int) -> Array:
    """Return means of a layer (rows, cols) over equal squares (side, side)."""
    rows, cols = layer.shape
    most = max(rows, cols)
    # Fractions of each row and column of cells that lie in each row and column of squares.
    edges = np.linspace(0.0, most, side + 1)

    def shares(count: int) -> Array:
        """Return the fraction of each of `count` cells in each square (side, count)."""
        first = np.arange(count) + 0.5 * (most - count)
        low, high = np.maximum(edges[:-1, None], first), np.minimum(edges[1:, None], first + 1.0)
        return np.asarray(np.maximum(high - low, 0.0))

    of_rows, of_cols = shares(rows), shares(cols)
    area = np.outer(of_rows.sum(1), of_cols.sum(1))
    return np.asarray((of_rows @ layer @ of_cols.T) / np.where(area > 0.0, area, 1.0))
