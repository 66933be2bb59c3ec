"""Generate a pool of worlds (terrains with rocks) that all landers share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid, format_bytes
from lunarsim.rng import RandomStreams, world_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation.mission import check_target_area
from lunarsim.simulation.worlds import build_world
from lunarsim.typing import Array
from lunarsim.world import World
from lunarsim.world.terrain import Terrain

# Posting of the terrain with rocks, and of the terrain without rocks, m.
_POSTING, _RELIEF_POSTING = 0.1, 1.0
# Margin of stored terrain around the target area, m.
_ASIDE = 50.0
_MOST_BYTES = 4 * 2**30
# Relative tolerance for covers, larger than single-precision rounding.
_SINGLE = 1e-6


def _max_slope(height: NDArray[np.float32], posting: float) -> float:
    """Return an upper bound of the slope between heights (rows, cols).

    The surface is bilinear, `posting` is the grid spacing, m. Unknown heights do not count.
    """
    steps = [np.nanmax(np.abs(np.diff(height, axis=axis))) for axis in (0, 1)]
    return float(np.hypot(*steps)) / posting


@dataclass(frozen=True)
class WorldPool:
    """Terrain rasters of k worlds around the target area.

    Attributes
    ----------
    terrains, frame
        Heights with rocks (k, rows, cols), m; east and north of cell (0, 0), and grid spacing (3,),
        m.
    rock_free_terrains, rock_free_frame
        Heights without rocks, on which targets are placed, and the frame of their grid.
    levels
        Minimum and maximum height of each world (k, 2), m.
    max_slopes
        Upper bound of the slope of each world between its grid points (k,).
    covers
        Rock covers (area fractions). The worlds are grouped by cover in this order, with equal
        group sizes; the cover of the scenario is the first.
    """

    terrains: NDArray[np.float32]
    frame: Array
    rock_free_terrains: NDArray[np.float32]
    rock_free_frame: Array
    levels: Array
    max_slopes: Array
    covers: tuple[float, ...]

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        count: int,
        seed: int,
        covers: Sequence[float] = (),
        split: str = "train",
    ) -> WorldPool:
        """Generate the worlds of a scenario.

        Parameters
        ----------
        scenario
            Scenario with terrain, rocks and target area.
        count, seed
            Number of worlds per cover, and root seed. World k of the split "train" is the world of
            flight k in a campaign with this seed.
        covers
            Additional rock covers, area fractions.
        split
            Split of the worlds, one of `lunarsim.rng.SPLITS`.

        Raises
        ------
        InputError
            If the count is less than 1, a cover is invalid, the worlds need more than 4 GiB, or
            the target area is not inside the map.
        """
        if count < 1:
            raise InputError("worlds", count, "must be 1 or more")
        worlds = (
            build_world(one, RandomStreams(world_seed(seed, k, split)))
            for one in scenarios_by_cover(scenario, covers)
            for k in range(count)
        )
        return cls.rasterize(scenario, count, worlds, covers)

    @classmethod
    def rasterize(
        cls, scenario: Scenario, count: int, worlds: Iterable[World], covers: Sequence[float] = ()
    ) -> WorldPool:
        """Rasterize the terrain around the targets of worlds that were generated before.

        Parameters
        ----------
        scenario, count, covers
            Scenario, number of worlds per rock cover, and additional rock covers.
        worlds
            Worlds, grouped by cover, with the cover of the scenario first.
        """
        all_covers = tuple(one.rocks.cover for one in scenarios_by_cover(scenario, covers))
        terrains, reliefs, grids = [], [], None
        for world in worlds:
            if grids is None:
                grids = _grids(scenario, world.terrain)
                size = 4.0 * count * len(all_covers) * sum(g.rows * g.cols for g in grids)
                if size > _MOST_BYTES:
                    raise InputError(
                        "worlds", count,
                        f"must be smaller: the worlds need {format_bytes(size)}, more than "
                        f"{format_bytes(_MOST_BYTES)}",
                        "A smaller target.scatter_m also helps.",
                    )  # fmt: skip
            terrains.append(world.terrain.raster(grids[0]))
            reliefs.append(Terrain(world.terrain.relief).raster(grids[1]))
        assert grids is not None
        height, relief = np.stack(terrains), np.stack(reliefs)
        if not np.isfinite(relief).all():
            raise InputError(
                "target.scatter_m",
                scenario.target.make().scatter,
                "must be smaller, because some targets are on terrain without data",
            )
        levels = np.stack((np.nanmin(height, (1, 2)), np.nanmax(height, (1, 2))), axis=1)
        frames = [np.array([g.x0, g.y0, g.posting]) for g in grids]
        slopes = np.array([_max_slope(one, grids[0].posting) for one in terrains])
        return cls(
            height, frames[0], relief, frames[1], levels.astype(np.float64), slopes, all_covers
        )

    def span(self, cover: float | None) -> tuple[int, int]:
        """Return index of the first world and number of worlds that have a rock cover.

        None selects the cover of the scenario.

        Raises
        ------
        InputError
            If there are no worlds with this cover.
        """
        count = len(self.terrains) // len(self.covers)
        if cover is None:
            return 0, count
        k = int(np.abs(np.array(self.covers) - cover).argmin())
        if abs(self.covers[k] - cover) > _SINGLE * self.covers[k]:
            known = ", ".join(f"{one:g}" for one in self.covers)
            raise InputError(
                "options.cover",
                cover,
                f"must be one of the covers of the environment ({known})",
                "Add this value to the argument `covers`.",
            )
        return k * count, count


def scenarios_by_cover(scenario: Scenario, covers: Sequence[float]) -> list[Scenario]:
    """Return a list of a scenario and its copies with other rock covers.

    Raises
    ------
    InputError
        If a cover is invalid or occurs twice.
    """
    made = [scenario]
    for cover in covers:
        if cover in [one.rocks.cover for one in made]:
            raise InputError(
                "covers",
                cover,
                "must contain each cover only once, and not rocks.cover of the scenario",
                "Delete this value.",
            )
        made.append(scenario.changed(rocks={"cover": cover}))
    return made


def _grids(scenario: Scenario, terrain: Terrain) -> tuple[Grid, Grid]:
    """Return the grids around the target area for terrain with and without rocks."""
    target = scenario.target.make()
    middle, scatter = np.asarray(target.position), np.asarray(target.scatter)
    west, east, south, north = terrain.bounds
    lander = scenario.vehicle.make()
    check_target_area(target, terrain, lander)
    margin = max(_ASIDE, lander.leg_radius + lander.pad_diameter)
    low = np.maximum(middle - scatter - margin, [west, south])
    high = np.minimum(middle + scatter + margin, [east, north])

    def grid(low: Array, high: Array, posting: float) -> Grid:
        cols, rows = (np.floor((high - low) / posting + 1e-6).astype(int) + 1).tolist()
        return Grid(float(low[0]), float(low[1]), posting, rows, cols)

    near, far = middle - scatter, middle + scatter
    return grid(low, high, _POSTING), grid(near - 2.0, far + 2.0, _RELIEF_POSTING)
