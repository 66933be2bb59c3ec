"""Terrain nodes for the planner, from the current hazard map."""

from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid
from lunarsim.onboard.active_perception.information import entropy
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.policies.reachability import elevation_on_grid
from lunarsim.typing import Array


def terrain_nodes(hazard_map: HazardMap, side: int, prior: float, site: Array) -> Array:
    """Divide a hazard map into squares; return position, weight and knowledge of each.

    The columns (side^2, 5) are the centre of a square (3), m, the fraction of the square on which
    the mission allows a landing, and the fraction of hazard uncertainty that the map has already
    removed: ``1 - E[H(p)] / H(prior)``, with the entropy H, and with the prior where nothing was
    observed.

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
    remaining_entropy = np.where(
        hazard_map.observed, entropy(1.0 - hazard_map.p_safe), prior_entropy
    )
    known_fraction = 1.0 - np.minimum(_square_means(remaining_entropy, side) / prior_entropy, 1.0)
    allowed = np.ones(fine.shape) if hazard_map.eligible is None else hazard_map.eligible
    weight = _square_means(np.asarray(allowed, dtype=np.float64), side)
    centres = grid.centres().reshape(-1, 2)
    height = elevation_on_grid(grid, hazard_map, float(site[2])).ravel()
    return np.column_stack((centres, height, weight.ravel(), known_fraction.ravel()))


def _square_means(layer: Array, side: int) -> Array:
    """Return means of a map layer (rows, cols) over equal squares (side, side).

    The squares divide the square around the centre of the map whose side is the longer side of the
    map. A square that contains no part of the map has the mean 0.
    """
    rows, cols = layer.shape
    size = max(rows, cols)
    # Fractions of each row and column of cells that lie in each row and column of squares.
    edges = np.linspace(0.0, size, side + 1)

    def overlaps(count: int) -> Array:
        """Return the fraction of each of `count` cells in each square (side, count)."""
        first = np.arange(count) + 0.5 * (size - count)
        low, high = np.maximum(edges[:-1, None], first), np.minimum(edges[1:, None], first + 1.0)
        return np.asarray(np.maximum(high - low, 0.0))

    row_overlaps, col_overlaps = overlaps(rows), overlaps(cols)
    area = np.outer(row_overlaps.sum(1), col_overlaps.sum(1))
    return np.asarray((row_overlaps @ layer @ col_overlaps.T) / np.where(area > 0.0, area, 1.0))
