"""Procedural terrain: fractal relief, craters and rocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.parts.quantity import quantity
from lunarsim.rng import RandomStreams
from lunarsim.rocks.population import RockPopulation
from lunarsim.world.terrain import Heightfield, Terrain
from lunarsim.world.terrain_models.interface import add_rocks, check_posts
from lunarsim.world.terrain_models.roughness import ReliefRoughness

# Automatic detail: minimum posting (m) and maximum number of posts along a side.
_MIN_DETAIL_POSTING_M, _MAX_DETAIL_POSTS = 0.05, 4000
# Above this posting (m), added detail would contain wavelengths for which the roughness is invalid.
_MAX_DETAILED_POSTING_M = 24.0


@dataclass(frozen=True)
class FractalTerrain(ReliefRoughness):
    """Fractal relief with craters, constant over flights; rocks are drawn.

    Attributes
    ----------
    detail
        Posting of the same relief with roughness and small craters below `posting`, m, for sensors
        that come close enough to resolve its facets; 0: none. Omitted: `detail_posting` chooses.
    """

    size: float = quantity(160.0, "m", gt=0, help="side of the square")
    posting: float = quantity(0.25, "m", gt=0, help="distance between posts of the relief")
    detail: float | None = quantity(
        None, "m", ge=0,
        help="finer posting with added roughness and craters; 0: none; omitted: with a preset, "
        "0.05 m, or size_m / 4000 if that is larger",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_posts(self.size, self.posting)
        if self.detail:
            if not self.detail < self.posting:
                raise InputError(
                    "detail", self.detail, f"must be less than posting_m ({self.posting:g})"
                )
            check_posts(self.size, self.detail)

    @property
    def detail_posting(self) -> float | None:
        """Return the posting of the added detail, m; None: no detail is added.

        If `detail` is omitted, terrain with a preset gets posts 0.05 m apart, or more widely
        spaced ones where that gives more than 4,000 along a side; other terrain gets none.
        """
        if self.detail is not None:
            return self.detail or None
        if self.preset == "none" or self.posting > _MAX_DETAILED_POSTING_M:
            return None
        finest = max(_MIN_DETAIL_POSTING_M, self.size / _MAX_DETAIL_POSTS)
        # The new posting must divide the old one.
        steps = int(self.posting / finest * (1.0 + 1e-9))
        return self.posting / steps if steps > 1 else None

    def build(self, rocks: RockPopulation, streams: RandomStreams) -> Terrain:
        """Return the terrain of one flight."""
        relief = self.relief()
        return add_rocks(relief, rocks, streams, lambda: self.craters(relief))

    def relief(self) -> Heightfield:
        """Return the relief without rocks."""
        return _cached_relief(self)


@lru_cache(maxsize=4)
def _cached_relief(model: FractalTerrain) -> Heightfield:
    grid = Grid.centred((0.0, 0.0), model.size, model.posting)
    return model.procedural(grid, detail=model.detail_posting)
