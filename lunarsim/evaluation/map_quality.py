"""Precision and recall of hazard maps against exact safety: written once, for all that judge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.world.terrain import Terrain
from lunarsim.world.truth import Truth


@dataclass(frozen=True)
class MapQuality:
    """Counts of judged cells.

    Attributes
    ----------
    hits
        Called safe, and safe.
    false_safe
        Called safe, and not.
    missed
        Safe, and not called so.
    rejected
        Neither safe nor called so.
    """

    hits: int
    false_safe: int
    missed: int
    rejected: int

    @classmethod
    def none(cls) -> MapQuality:
        """Return the counts of no map."""
        return cls(0, 0, 0, 0)

    @classmethod
    def of(cls, called: ArrayLike, safe: ArrayLike) -> MapQuality:
        """Count cells called safe (n,) against cells that are (n,).

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
        """Pool the cells of two maps."""
        return MapQuality(
            self.hits + other.hits,
            self.false_safe + other.false_safe,
            self.missed + other.missed,
            self.rejected + other.rejected,
        )

    @property
    def precision(self) -> float:
        """Share of the cells called safe that are; NaN without any."""
        called = self.hits + self.false_safe
        return self.hits / called if called else float("nan")

    @property
    def recall(self) -> float:
        """Share of the safe cells called so; NaN without any."""
        safe = self.hits + self.missed
        return self.hits / safe if safe else float("nan")

    @property
    def judged(self) -> int:
        """Number of cells."""
        return self.hits + self.false_safe + self.missed + self.rejected

    @property
    def safe_share(self) -> float:
        """Share of all cells that are safe; NaN without any."""
        return (self.hits + self.missed) / self.judged if self.judged else float("nan")


def map_quality(
    hazard_map: HazardMap, truth: Truth, error: ArrayLike, level: float = 0.5
) -> MapQuality:
    """Compare what a map has observed with the truth, cell by cell.

    Parameters
    ----------
    hazard_map, truth
        The map, and what judges it.
    error
        Map less true coordinates (3,), m.
    level
        p_safe above which a cell is called safe.
    """
    seen = hazard_map.observed
    xy = hazard_map.grid.centres()[seen] - np.asarray(error)[:2]
    return MapQuality.of(hazard_map.p_safe[seen] > level, truth.safe_at(xy))


def local_ground(terrain: Terrain, grid: Grid, error: ArrayLike) -> NDArray[np.float32]:
    """Return the true elevation where a map has its cells, in the map's heights (rows, cols), m.

    Parameters
    ----------
    terrain
        The true ground.
    grid
        Of the map.
    error
        Map less true coordinates (3,), m.
    """
    error = np.asarray(error, dtype=np.float64)
    return np.asarray(terrain.raster(grid.moved(-error)) + np.float32(error[2]))


def precision_at_recall(p: NDArray[np.float32], safe: NDArray[np.bool_], recall: float) -> float:
    """Return the precision at the level of p (n,) where this share of the safe cells is called.

    NaN where no level reaches it.
    """
    level = float(np.quantile(p[safe], 1.0 - recall))
    called = (p >= level) & (p > 0.0)
    return float(safe[called].mean()) if level > 0.0 else float("nan")
