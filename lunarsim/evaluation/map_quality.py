"""Precision and recall of hazard maps against the exact safety."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.typing import BoolArray
from lunarsim.world.terrain import Terrain
from lunarsim.world.truth import TerrainTruth

# Distance between evaluated cells of a map, m; the safety of nearer cells is nearly the same.
_EVALUATED_POSTING_M = 0.4


@dataclass(frozen=True)
class MapQuality:
    """Confusion counts of a hazard map's cells against the true safety.

    Attributes
    ----------
    true_safe
        Cells classified safe that are truly safe.
    false_safe
        Cells classified safe that are truly unsafe.
    false_unsafe
        Cells classified unsafe that are truly safe.
    rejected
        Cells classified unsafe that are truly unsafe.
    """

    true_safe: int
    false_safe: int
    false_unsafe: int
    rejected: int

    @classmethod
    def none(cls) -> MapQuality:
        """Return counts that are all zero, for a flight without a map."""
        return cls(0, 0, 0, 0)

    @classmethod
    def of(cls, called: ArrayLike, safe: ArrayLike) -> MapQuality:
        """Count cells by whether they are classified safe (n,) and truly safe (n,).

        Examples
        --------
        >>> quality = MapQuality.of([True, True, False], [True, False, True])
        >>> quality.precision, quality.recall
        (0.5, 0.5)
        """
        c, s = np.asarray(called, np.bool_), np.asarray(safe, np.bool_)
        return cls(int((c & s).sum()), int((c & ~s).sum()), int((~c & s).sum()),
                   int((~c & ~s).sum()))  # fmt: skip

    def __add__(self, other: MapQuality) -> MapQuality:
        """Add the counts of this map and another map."""
        return MapQuality(
            self.true_safe + other.true_safe,
            self.false_safe + other.false_safe,
            self.false_unsafe + other.false_unsafe,
            self.rejected + other.rejected,
        )

    @property
    def precision(self) -> float:
        """Fraction of the cells classified safe that are truly safe.

        It is NaN if no cell is classified safe.
        """
        called = self.true_safe + self.false_safe
        return self.true_safe / called if called else float("nan")

    @property
    def recall(self) -> float:
        """Fraction of the truly safe cells that are classified safe.

        It is NaN if no cell is truly safe.
        """
        safe = self.true_safe + self.false_unsafe
        return self.true_safe / safe if safe else float("nan")

    @property
    def evaluated(self) -> int:
        """Number of evaluated cells."""
        return self.true_safe + self.false_safe + self.false_unsafe + self.rejected

    @property
    def safe_share(self) -> float:
        """Fraction of all evaluated cells that are truly safe; NaN without cells."""
        return (
            (self.true_safe + self.false_unsafe) / self.evaluated
            if self.evaluated
            else float("nan")
        )


def map_quality(
    hazard_map: HazardMap, truth: TerrainTruth, error: ArrayLike, level: float = 0.5
) -> MapQuality:
    """Count observed cells of a hazard map, 0.4 m apart, by predicted and true safety.

    Parameters
    ----------
    hazard_map, truth
        Hazard map, and exact safety of the world.
    error
        Map coordinates minus true coordinates (3,), m.
    level
        Threshold of p_safe above which a cell is classified safe.

    Examples
    --------
    >>> from lunarsim import Heightfield, Terrain
    >>> from lunarsim.api import Lander
    >>> grid = Grid.centred((0.0, 0.0), 20.0, 0.5)
    >>> z = np.where(grid.x < 0.0, 0.0, 0.5 * grid.x) * np.ones((grid.rows, 1))  # steep in the east
    >>> truth = TerrainTruth(Terrain(Heightfield(grid, z)), grid, Lander())
    >>> observed = truth.is_known_at(grid.centres())
    >>> optimistic = HazardMap(grid, np.full(grid.shape, 0.9, np.float32), observed)
    >>> quality = map_quality(optimistic, truth, error=np.zeros(3))
    >>> quality.recall, quality.precision == quality.safe_share
    (1.0, True)
    """
    step = evaluated_step(hazard_map.grid)
    seen = hazard_map.observed[::step, ::step]
    xy = hazard_map.grid.centres()[::step, ::step][seen] - np.asarray(error)[:2]
    return MapQuality.of(hazard_map.p_safe[::step, ::step][seen] > level, truth.is_safe_at(xy))


def evaluated_step(grid: Grid) -> int:
    """Return the distance in cells between evaluated rows and columns of a map."""
    return max(1, round(_EVALUATED_POSTING_M / grid.posting))


def true_elevation_in_map_frame(
    terrain: Terrain, grid: Grid, error: ArrayLike
) -> NDArray[np.float32]:
    """Return the true elevation at a map's cells (rows, cols), m, in the map's frame.

    Parameters
    ----------
    terrain
        True terrain.
    grid
        Grid of the map.
    error
        Map coordinates minus true coordinates (3,), m.
    """
    error = np.asarray(error, dtype=np.float64)
    return np.asarray(terrain.raster(grid.moved(-error)) + np.float32(error[2]))


def precision_at_recall(p: NDArray[np.float32], safe: BoolArray, recall: float) -> float:
    """Return the precision of a classifier at the threshold with a given recall.

    `p` (n,) are predicted safety probabilities, `safe` (n,) the truth. The result is NaN if no
    threshold above 0 reaches the recall.
    """
    level = float(np.quantile(p[safe], 1.0 - recall))
    called = (p >= level) & (p > 0.0)
    return float(safe[called].mean()) if level > 0.0 else float("nan")
