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

# Posts of detail that nobody asked for: no nearer than so, m, and so many along a side.
_FINEST, _MOST_ALONG = 0.05, 4000
# Between posts farther apart there are waves too long for the roughness that comes back, m.
_FARTHEST = 24.0


@dataclass(frozen=True)
class FractalGround(Roughness):
    """Fractal relief with craters, the same for all flights; rocks are drawn for each.

    Attributes
    ----------
    size, posting
        Side of the square and distance of the posts, m.
    detail
        Posting of the same ground with roughness and small craters below `posting`, m, for sensors
        that come so near that they would see its facets; 0: none are added. Left out: see
        `detail_posting`.
    """

    size: float = quantity(160.0, "m", gt=0, help="side of the square")
    posting: float = quantity(0.25, "m", gt=0, help="of the relief")
    detail: float | None = quantity(
        None, "m", ge=0,
        help="finer posting, with roughness and craters below the other; 0: none; left out: "
        "0.05 m, or what up to 200 m across allow, where there is a preset",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_posts(self.size, self.posting)
        if self.detail:
            if not self.detail < self.posting:
                raise InputError("detail", self.detail, f"less than posting_m, {self.posting:g}")
            check_posts(self.size, self.detail)

    @property
    def detail_posting(self) -> float | None:
        """Return the posting of the detail that the ground has, m; None: it has none.

        Where it is left out, ground of a kind that there is, a preset, has posts 0.05 m apart or
        some more, so that they are 16 million at most; other ground has what is asked for.
        """
        if self.detail is not None:
            return self.detail or None
        if self.preset == "none" or self.posting > _FARTHEST:
            return None
        finest = max(_FINEST, self.size / _MOST_ALONG)
        # Whole steps of the new posts make one of the old.
        steps = int(self.posting / finest * (1.0 + 1e-9))
        return self.posting / steps if steps > 1 else None

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
    return ground.procedural(grid, detail=ground.detail_posting)
