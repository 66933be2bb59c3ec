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
    AlbedoMap,
    CraterClusters,
    Heightfield,
    Terrain,
    add_fillets,
    place_given_rocks,
    place_rocks,
)
from lunarsim.world.terrain.placement import NO_CLUSTERS

MAX_POSTS_PER_SIDE = 20_000
MIN_POSTS_PER_SIDE = 2


class TerrainModel(Protocol):
    """Interface of terrain models, which generate the true terrain of a flight."""

    def build(self, rocks: RockPopulation, streams: RandomStreams) -> Terrain:
        """Return the true terrain (relief and rocks) of one flight.

        `rocks` is the population to sample from, `streams` are the flight's random streams.
        """
        ...


def add_rocks(
    relief: Heightfield,
    rocks: RockPopulation,
    streams: RandomStreams,
    craters: Callable[[], AgedCraters] | None = None,
    albedo: AlbedoMap | None = None,
) -> Terrain:
    """Return the terrain of one flight: relief with random rocks or with given rocks.

    Parameters
    ----------
    relief
        Relief without rocks.
    rocks
        Population to sample the rocks from.
    streams
        Random streams of the flight.
    craters
        Function that returns the craters of the relief; called only if rocks cluster around
        craters. Omitted: the relief has no known craters.
    albedo
        Relative albedo of the relief; omitted: uniform.

    Raises
    ------
    InputError
        If the rocks do not fit or are not on the terrain, or cluster around craters that are not
        known.
    """
    west, east, south, north = relief.bounds
    field = RockField.empty()
    given = rocks.given_rocks()
    if given is not None:
        field = place_given_rocks(relief, given, streams.get("rocks"), rocks.model())
    elif rocks.cover > 0.0:
        rng = streams.get("rocks")
        area = rocks.disc_area_ratio * (east - west) * (north - south)
        diameters = sample_diameters(area, rocks.cover, rocks.min_diameter, rocks.max_diameter, rng)
        clusters = NO_CLUSTERS
        if rocks.cluster_fraction > 0.0:
            if craters is None:
                raise InputError(
                    "rocks.cluster_fraction",
                    rocks.cluster_fraction,
                    "must be 0, because the craters of this terrain are not known",
                )
            found = craters()
            old = found.diameter >= rocks.min_block_crater_diameter
            middles = found.x[old], found.y[old]
            clusters = CraterClusters(*middles, 0.5 * found.diameter[old], rocks.cluster_fraction)
        field = place_rocks(relief, diameters, rng, model=rocks.model(), clusters=clusters)
    return Terrain(add_fillets(relief, field, rocks.fillet_height_ratio), field, albedo)


def check_posts(size: float, posting: float) -> None:
    """Raise InputError unless a side has 2 to 20,000 grid points (1.6 GB).

    `size` is the side of the relief and `posting` its grid spacing, m.
    """
    check_raster_size("size", size, posting, MAX_POSTS_PER_SIDE, "points")
    if round(size / posting) < MIN_POSTS_PER_SIDE:
        raise InputError("posting", posting, f"must be at most {0.5 * size:g} m, half of size_m")


def check_terrain_size(terrain: Terrain, footprint: float) -> None:
    """Raise InputError if the terrain is less than two lander footprints across.

    `footprint` is the footprint's diameter, m.
    """
    west, east, south, north = terrain.bounds
    if min(east - west, north - south) < 2.0 * footprint:
        raise InputError(
            "terrain",
            f"{east - west:.1f} x {north - south:.1f} m",
            f"must be at least {2.0 * footprint:.1f} m wide, twice the lander's footprint",
        )
