"""Procedural ground: fractal relief, craters, rocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.parts.quantity import quantity
from lunarsim.rng import Streams
from lunarsim.rocks.population import RockPopulation
from lunarsim.world.grounds.contract import check_posts, strewn
from lunarsim.world.grounds.roughness import Roughness
from lunarsim.world.terrain import Heightfield, Terrain


@dataclass(frozen=True)
class FractalGround(Roughness):
    """Fractal relief with craters, the same for all flights; rocks are drawn for each.

    Attributes
    ----------
    size, posting
        Side of the square and distance of the posts, m.
    detail
        Posting of the same ground with roughness and small craters below `posting`, m, for sensors
        that come so near that they would see its facets; None: none are added.
    """

    size: float = quantity(160.0, "m", gt=0, help="side of the square")
    posting: float = quantity(0.25, "m", gt=0, help="of the relief")
    detail: float | None = quantity(
        None, "m", gt=0, help="finer posting, with roughness and craters below the other"
    )

    def __post_init__(self) -> None:
        check_posts(self.size, self.posting)
        if self.detail is not None:
            if not self.detail < self.posting:
                raise InputError("detail", self.detail, f"less than posting_m, {self.posting:g}")
            check_posts(self.size, self.detail)

    def build(self, rocks: RockPopulation, streams: Streams) -> Terrain:
        """Return the terrain of one flight."""
        relief = self.relief()
        return strewn(relief, rocks, streams, lambda: self.craters(relief))

    def relief(self) -> Heightfield:
        """Return the relief without rocks."""
        return _relief(self)


@lru_cache(maxsize=4)
def _relief(ground: FractalGround) -> Heightfield:
    grid = Grid.centred((0.0, 0.0), ground.size, ground.posting)
    return ground.procedural(grid, detail=ground.detail)
