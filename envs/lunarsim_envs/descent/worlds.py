"""The worlds that descents meet: a pool of them, drawn once and shared by all lanes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid, bytes_in_words
from lunarsim.rng import Streams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation.worlds import build_world
from lunarsim.world import World
from lunarsim.world.terrain import Terrain

# Distance of the posts of ground with rocks, and of relief, m.
_POSTING, _RELIEF_POSTING = 0.1, 1.0
# Ground that is kept about where targets lie, m.
_ASIDE = 50.0
_MOST_BYTES = 4 * 2**30
# Relative, above that of rounding to single precision.
_SINGLE = 1e-6


@dataclass(frozen=True)
class Worlds:
    """Ground of each world, about where its targets lie.

    Attributes
    ----------
    grounds, frame
        Heights with rocks (k, rows, cols), m, and where they are: corner and posting (3,).
    reliefs, relief_frame
        The same without rocks, which is what a mission knows.
    levels
        Least and greatest height of each (k, 2), m.
    covers
        Of rocks, of equal shares of the worlds one after another; the scenario's own is the first.
    """

    grounds: NDArray[np.float32]
    frame: NDArray[np.float64]
    reliefs: NDArray[np.float32]
    relief_frame: NDArray[np.float64]
    levels: NDArray[np.float64]
    covers: tuple[float, ...]

    @classmethod
    def of(cls, scenario: Scenario, count: int, seed: int, covers: Sequence[float] = ()) -> Worlds:
        """Draw worlds of a scenario.

        Parameters
        ----------
        scenario
            Of which terrain, rocks and the scatter of targets count.
        count, seed
            How many, and their root seed: world k is that of flight k of a campaign with it.
        covers
            Of rocks, of each of which so many are drawn besides.

        Raises
        ------
        InputError
            If there are none, a cover will not do, they take more than 4 GiB, or targets may lie
            off the map.
        """
        if count < 1:
            raise InputError("worlds", count, "at least 1")
        drawn = (
            build_world(one, Streams(flight_seed(seed, k)))
            for one in with_covers(scenario, covers)
            for k in range(count)
        )
        return cls.about(scenario, count, drawn, covers)

    @classmethod
    def about(
        cls, scenario: Scenario, count: int, drawn: Iterable[World], covers: Sequence[float] = ()
    ) -> Worlds:
        """Keep the ground about the targets of worlds that have been drawn; see `of`."""
        told = tuple(one.rocks.cover for one in with_covers(scenario, covers))
        grounds, reliefs, grids = [], [], None
        for world in drawn:
            if grids is None:
                grids = _grids(scenario, world.terrain)
                size = 4.0 * count * len(told) * sum(g.rows * g.cols for g in grids)
                if size > _MOST_BYTES:
                    raise InputError(
                        "worlds", count,
                        f"fewer, or less scatter of targets: they take {bytes_in_words(size)}",
                    )  # fmt: skip
            grounds.append(world.terrain.raster(grids[0]))
            reliefs.append(Terrain(world.terrain.relief).raster(grids[1]))
        assert grids is not None
        ground, relief = np.stack(grounds), np.stack(reliefs)
        if not np.isfinite(relief).all():
            raise InputError("target.scatter_m", scenario.target.make().scatter, "measured ground")
        levels = np.stack((np.nanmin(ground, (1, 2)), np.nanmax(ground, (1, 2))), axis=1)
        frames = [np.array([g.x0, g.y0, g.posting]) for g in grids]
        return cls(ground, frames[0], relief, frames[1], levels.astype(np.float64), told)

    def span(self, cover: float | None) -> tuple[int, int]:
        """Return the first world of a cover, and how many there are; None: the scenario's own.

        Raises
        ------
        InputError
            If there are no worlds of such a cover.
        """
        count = len(self.grounds) // len(self.covers)
        if cover is None:
            return 0, count
        # Within the rounding of single precision.
        k = int(np.abs(np.array(self.covers) - cover).argmin())
        if abs(self.covers[k] - cover) > _SINGLE * self.covers[k]:
            known = ", ".join(f"{one:g}" for one in self.covers)
            raise InputError(
                "options.cover",
                cover,
                f"{known}; others are drawn if the argument covers names them",
            )
        return k * count, count


def with_covers(scenario: Scenario, covers: Sequence[float]) -> list[Scenario]:
    """Return a scenario, and what it is with each of other covers of rocks.

    Raises
    ------
    InputError
        If a cover is named twice or will not do.
    """
    made = [scenario]
    for cover in covers:
        if cover in [one.rocks.cover for one in made]:
            raise InputError("covers", cover, "other covers than the scenario's own, each once")
        made.append(scenario.changed(rocks={"cover": cover}))
    return made


def _grids(scenario: Scenario, terrain: Terrain) -> tuple[Grid, Grid]:
    """Return where ground with rocks, and relief, are kept."""
    target = scenario.target.make()
    middle, scatter = np.asarray(target.position), np.asarray(target.scatter)
    west, east, south, north = terrain.bounds
    low = np.maximum(middle - scatter - _ASIDE, [west, south])
    high = np.minimum(middle + scatter + _ASIDE, [east, north])
    lander = scenario.vehicle.make()
    room = lander.leg_radius + lander.pad_diameter
    if np.any(middle - scatter - room < low) or np.any(middle + scatter + room > high):
        raise InputError(
            "target.scatter_m", target.scatter,
            f"targets {room:.1f} m or more inside the map, which goes from {west:.0f} to "
            f"{east:.0f} m east and {south:.0f} to {north:.0f} m north",
        )  # fmt: skip

    def grid(low: NDArray[np.float64], high: NDArray[np.float64], posting: float) -> Grid:
        cols, rows = (np.floor((high - low) / posting + 1e-6).astype(int) + 1).tolist()
        return Grid(float(low[0]), float(low[1]), posting, rows, cols)

    near, far = middle - scatter, middle + scatter
    return grid(low, high, _POSTING), grid(near - 2.0, far + 2.0, _RELIEF_POSTING)
