"""The contract of grounds, and how rocks are drawn onto one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from lunarsim.errors import InputError
from lunarsim.grid import check_side
from lunarsim.rng import Streams
from lunarsim.rocks.field import RockField
from lunarsim.rocks.laws import sample_diameters
from lunarsim.rocks.population import RockPopulation
from lunarsim.world.terrain import (
    AgedCraters,
    Clusters,
    Heightfield,
    Terrain,
    add_fillets,
    place_rocks,
)
from lunarsim.world.terrain.placement import NOWHERE

MOST_POSTS = 20_000
LEAST_POSTS = 2


class Ground(Protocol):
    """Anything that makes the true terrain of a flight."""

    def build(self, rocks: RockPopulation, streams: Streams) -> Terrain:
        """Return relief and rocks; what is drawn comes from the flight's streams."""
        ...


def strewn(
    relief: Heightfield,
    rocks: RockPopulation,
    streams: Streams,
    craters: Callable[[], AgedCraters] | None = None,
) -> Terrain:
    """Return relief with rocks drawn for one flight.

    Parameters
    ----------
    relief
        The ground.
    rocks
        What is drawn.
    streams
        Source of what is drawn.
    craters
        Returns the craters of the relief; asked where rocks lie about them. Left out: it has none.

    Raises
    ------
    InputError
        If the rocks do not fit.
    """
    west, east, south, north = relief.bounds
    field = RockField.empty()
    if rocks.cover > 0.0:
        rng = streams.get("rocks")
        area = rocks.share * (east - west) * (north - south)
        diameters = sample_diameters(area, rocks.cover, rocks.min_diameter, rocks.max_diameter, rng)
        clusters = NOWHERE
        if rocks.clustered > 0.0:
            if craters is None:
                raise InputError(
                    "rocks.clustered",
                    rocks.clustered,
                    "0: where this ground has craters is not known",
                )
            found = craters()
            old = found.diameter >= rocks.block_crater
            middles = found.x[old], found.y[old]
            clusters = Clusters(*middles, 0.5 * found.diameter[old], rocks.clustered)
        field = place_rocks(relief, diameters, rng, model=rocks.model(), clusters=clusters)
    return Terrain(add_fillets(relief, field, rocks.fillet), field)


def check_posts(size: float, posting: float) -> None:
    """Raise `InputError` for relief of less than 2 posts a side, or more than 20,000: 1.6 GB."""
    check_side("size", size, posting, MOST_POSTS, "posts")
    if round(size / posting) < LEAST_POSTS:
        raise InputError(
            "posting", posting, f"at most {size / LEAST_POSTS:g}: half of size_m, {size:g}"
        )


def check_room(terrain: Terrain, footprint: float) -> None:
    """Raise `InputError` if the terrain is less than twice a footprint (m) across."""
    west, east, south, north = terrain.bounds
    if min(east - west, north - south) < 2.0 * footprint:
        raise InputError(
            "terrain",
            f"{east - west:.1f} x {north - south:.1f} m",
            f"at least twice the footprint of {footprint:.1f} m",
        )
