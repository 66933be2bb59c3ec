"""Procedural ground: fractal relief, craters, rocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

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
    """

    size: float = quantity(160.0, "m", gt=0, help="side of the square")
    posting: float = quantity(0.25, "m", gt=0, help="of the relief")

    def __post_init__(self) -> None:
        check_posts(self.size, self.posting)

    def build(self, rocks: RockPopulation, streams: Streams) -> Terrain:
        """Return the terrain of one flight."""
        relief = self.relief()
        return strewn(relief, rocks, streams, lambda: self.craters(relief))

    def relief(self) -> Heightfield:
        """Return the relief without rocks."""
        return _relief(self)


@lru_cache(maxsize=4)
def _relief(ground: FractalGround) -> Heightfield:
    return ground.procedural(Grid.centred((0.0, 0.0), ground.size, ground.posting))
