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

# Automatic refinement: minimum grid spacing (m) and maximum number of points along a side.
_MIN_DETAIL_POSTING_M, _MAX_DETAIL_POSTS = 0.05, 4000
# Above this grid spacing (m), added detail would contain wavelengths for which the roughness is
# invalid.
_MAX_DETAILED_POSTING_M = 24.0


@dataclass(frozen=True)
class FractalTerrain(ReliefRoughness):
    """Settings of procedural terrain: fractal relief, craters and random rocks.

    The relief is the same in all flights of a scenario; rocks are sampled for every flight.

    Attributes
    ----------
    detail
        Grid spacing, m, of a refined relief with added roughness and small craters, for sensors
        that come close enough to resolve the facets; 0: no refinement. Omitted: `detail_posting`
        chooses the spacing.
    """

    size: float = quantity(160.0, "m", gt=0, help="side of the square terrain")
    posting: float = quantity(0.25, "m", gt=0, help="grid spacing of the relief")
    detail: float | None = quantity(
        None, "m", ge=0,
        help="grid spacing of a finer relief with additional roughness and small craters; 0: no "
        "finer relief; omitted: 0 without preset, otherwise the larger of 0.05 m and size_m / 4000",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_posts(self.size, self.posting)
        if self.detail:
            if not self.detail < self.posting:
                raise InputError(
                    "detail",
                    self.detail,
                    f"must be less than posting_m, which is {self.posting:g} m",
                )
            check_posts(self.size, self.detail)

    @property
    def detail_posting(self) -> float | None:
        """Grid spacing of the refined relief, m; None: no refinement.

        If `detail` is omitted, only terrain with a preset and a `posting` up to 24 m is refined: to
        the smallest spacing that divides `posting`, is at least 0.05 m, and gives at most 4,000
        points along a side.
        """
        if self.detail is not None:
            return self.detail or None
        if self.preset == "none" or self.posting > _MAX_DETAILED_POSTING_M:
            return None
        finest = max(_MIN_DETAIL_POSTING_M, self.size / _MAX_DETAIL_POSTS)
        # The new spacing must divide the old one.
        steps = int(self.posting / finest * (1.0 + 1e-9))
        return self.posting / steps if steps > 1 else None

    def build(self, rocks: RockPopulation, streams: RandomStreams) -> Terrain:
        """Return the relief with random rocks of one flight.

        `rocks` is the population to sample from, `streams` are the flight's random streams.
        """
        relief = self.relief()
        return add_rocks(relief, rocks, streams, lambda: self.craters(relief))

    def relief(self) -> Heightfield:
        """Return the relief without rocks."""
        return _cached_relief(self)


@lru_cache(maxsize=4)
def _cached_relief(model: FractalTerrain) -> Heightfield:
    grid = Grid.centred((0.0, 0.0), model.size, model.posting)
    return model.procedural_relief(grid, detail=model.detail_posting)
