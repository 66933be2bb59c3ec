"""Interface of terrain models, and placement of rocks on their relief."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from lunarsim.errors import InputError
from lunarsim.grid import check_raster_size
from lunarsim.rng import RandomStreams
from lunarsim.rocks.field import RockField
from lunarsim.rocks.population import RockPopulation
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.world.terrain import (
    AgedCraters,
    CraterClusters,
    Heightfield,
    Terrain,
    add_fillets,
    place_rocks,
)
from lunarsim.world.terrain.placement import NO_CLUSTERS

MAX_POSTS_PER_SIDE = 20_000
MIN_POSTS_PER_SIDE = 2


class TerrainModel(Protocol):
    """Interface of terrain models, which generate the true terrain of a flight."""

    def build(self, rocks: RockPopulation, streams: RandomStreams) -> Terrain:
        """Return relief with rocks; random parts use the flight's streams."""
        ...


def add_rocks(
    relief: Heightfield,
    rocks: RockPopulation,
    streams: RandomStreams,
    craters: Callable[[], AgedCraters] | None = None,
) -> Terrain:
    """Return relief with rocks drawn for one flight.

    Parameters
    ----------
    relief
        Relief without rocks.
    rocks
        Population of rocks to draw from.
    streams
        Random streams of the flight.
    craters
        Function that returns the craters of the relief; called only if rocks cluster around
        craters. Omitted: the relief has no known craters.

    Raises
    ------
    InputError
        If the rocks do not fit, or cluster around craters that are not known.
    """
    west, east, south, north = relief.bounds
    field = RockField.empty()
    if rocks.cover > 0.0:
        rng = streams.get("rocks")
        area = rocks.share * (east - west) * (north - south)
        diameters = sample_diameters(area, rocks.cover, rocks.min_diameter, rocks.max_diameter, rng)
        clusters = NO_CLUSTERS
        if rocks.clustered > 0.0:
            if craters is None:
                raise InputError(
                    "rocks.clustered",
                    rocks.clustered,
                    "must be 0 for terrain whose craters are not known",
                )
            found = craters()
            old = found.diameter >= rocks.block_crater
            middles = found.x[old], found.y[old]
            clusters = CraterClusters(*middles, 0.5 * found.diameter[old], rocks.clustered)
        field = place_rocks(relief, diameters, rng, model=rocks.model(), clusters=clusters)
    return Terrain(add_fillets(relief, field, rocks.fillet), field)


def check_posts(size: float, posting: float) -> None:
    """Refuse relief with less than 2 or more than 20,000 posts (1.6 GB) along a side."""
    check_raster_size("size", size, posting, MAX_POSTS_PER_SIDE, "posts")
    if round(size / posting) < MIN_POSTS_PER_SIDE:
        raise InputError(
            "posting", posting, f"must be at most half of size_m: {size / MIN_POSTS_PER_SIDE:g}"
        )


def check_terrain_size(terrain: Terrain, footprint: float) -> None:
    """Refuse terrain that is less than twice a footprint (m) across."""
    west, east, south, north = terrain.bounds
    if min(east - west, north - south) < 2.0 * footprint:
        raise InputError(
            "terrain",
            f"{east - west:.1f} x {north - south:.1f} m",
            f"must be at least twice as wide as the footprint of {footprint:.1f} m",
        )
