"""Precision and recall of hazard maps against the exact safety."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.world.terrain import Terrain
from lunarsim.world.truth import TerrainTruth


@dataclass(frozen=True)
class MapQuality:
    """Counts of evaluated cells.

    Attributes
    ----------
    hits
        Classified safe, and truly safe.
    false_safe
        Classified safe, but truly unsafe.
    missed
        Truly safe, but classified unsafe.
    rejected
        Classified unsafe, and truly unsafe.
    """

    hits: int
    false_safe: int
    missed: int
    rejected: int

    @classmethod
    def none(cls) -> MapQuality:
        """Return zero counts."""
        return cls(0, 0, 0, 0)

    @classmethod
    def of(cls, called: ArrayLike, safe: ArrayLike) -> MapQuality:
        """Compare cells classified safe (n,) with cells that are safe (n,).

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
        """Add the counts of two maps."""
        return MapQuality(
            self.hits + other.hits,
            self.false_safe + other.false_safe,
            self.missed + other.missed,
            self.rejected + other.rejected,
        )

    @property
    def precision(self) -> float:
        """Share of the cells classified safe that are safe; NaN without any."""
        called = self.hits + self.false_safe
        return self.hits / called if called else float("nan")

    @property
    def recall(self) -> float:
        """Share of the safe cells that are classified safe; NaN without any."""
        safe = self.hits + self.missed
        return self.hits / safe if safe else float("nan")

    @property
    def evaluated(self) -> int:
        """Number of evaluated cells."""
        return self.hits + self.false_safe + self.missed + self.rejected

    @property
    def safe_share(self) -> float:
        """Share of all cells that are safe; NaN without any."""
        return (self.hits + self.missed) / self.evaluated if self.evaluated else float("nan")


def map_quality(
    hazard_map: HazardMap, truth: TerrainTruth, error: ArrayLike, level: float = 0.5
) -> MapQuality:
    """Compare the observed cells of a map with the truth.

    Parameters
    ----------
    hazard_map, truth
        Hazard map, and exact safety of the world.
    error
        Map coordinates minus true coordinates (3,), m.
    level
        Threshold of p_safe above which a cell is classified safe.
    """
    seen = hazard_map.observed
    xy = hazard_map.grid.centres()[seen] - np.asarray(error)[:2]
    return MapQuality.of(hazard_map.p_safe[seen] > level, truth.safe_at(xy))


def true_elevation_in_map_frame(
    terrain: Terrain, grid: Grid, error: ArrayLike
) -> NDArray[np.float32]:
    """Return the true elevation at a map's cells (rows, cols), m, in its frame.

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


def precision_at_recall(p: NDArray[np.float32], safe: NDArray[np.bool_], recall: float) -> float:
    """Return the precision at the threshold of p (n,) that gives this recall.

    NaN if no threshold above 0 reaches it.
    """
    level = float(np.quantile(p[safe], 1.0 - recall))
    called = (p >= level) & (p > 0.0)
    return float(safe[called].mean()) if level > 0.0 else float("nan")
