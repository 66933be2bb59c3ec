"""Generate and cache a pool of worlds with their true safety."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lunarsim.campaign.cache import default_cache_folder, open_cache
from lunarsim.campaign.world_truth import WorldTruthProvider
from lunarsim.errors import InputError
from lunarsim.rng import world_seed
from lunarsim.scenario import Scenario
from lunarsim.typing import Array
from lunarsim.world import World
from lunarsim_envs.descent.worlds import WorldPool, scenarios_by_cover
from lunarsim_envs.sites._map_kernels import TrueTerrains
from lunarsim_envs.sites.hazard import UNKNOWN, TruthLayers

# Number of pools that a process keeps in memory (the oldest are dropped).
_REMEMBERED = 4
_pools: OrderedDict[str, SiteWorldPool] = OrderedDict()


@dataclass(frozen=True)
class SiteWorldPool:
    """Pool of k simulated terrains (worlds) of a scenario, with their true safety.

    Attributes
    ----------
    worlds
        Complete worlds, for sensor models.
    terrains
        Terrain around the target areas, for touchdown.
    layers
        Hazard class, true safety and height of all cells, for kernels.
    shares
        Truly safe fraction of each world (k,).
    """

    worlds: tuple[World, ...]
    terrains: WorldPool
    layers: TrueTerrains
    shares: Array

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        count: int,
        seed: int,
        covers: Sequence[float] = (),
        split: str = "train",
    ) -> SiteWorldPool:
        """Generate a pool of worlds, or return it if this process has used it recently.

        Parameters
        ----------
        scenario
            Scenario with terrain, rocks, vehicle, Sun and target area.
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
            If the count is less than 1, the worlds need too much memory, or the target area is not
            inside the map.
        """
        if count < 1:
            raise InputError("worlds", count, "must be 1 or more")
        tables = ("terrain", "rocks", "vehicle", "target", "sun", "gravity_m_s2")
        held = scenario.to_dict()
        key = repr(([held.get(name) for name in tables], count, seed, tuple(covers), split))
        if key not in _pools:
            _pools[key] = _generate_pool(scenario, count, seed, covers, split)
            while len(_pools) > _REMEMBERED:
                _pools.popitem(last=False)
        _pools.move_to_end(key)
        return _pools[key]


def _generate_pool(
    scenario: Scenario, count: int, seed: int, covers: Sequence[float], split: str
) -> SiteWorldPool:
    """Generate a pool of worlds; the cache of campaigns supplies known true maps."""
    worlds: list[World] = []
    layers: list[TruthLayers] = []
    cache = open_cache(default_cache_folder())

    def drawn() -> Iterator[World]:
        for one in scenarios_by_cover(scenario, covers):
            for k in range(count):
                provider = WorldTruthProvider(world_seed(seed, k, split), {}, cache)
                world, safety, elevation = provider.raster(one)
                worlds.append(world)
                layers.append(TruthLayers.of(safety, elevation, one.vehicle.make()))
                yield world

    terrains = WorldPool.rasterize(scenario, count, drawn(), covers)
    grid = layers[0].grid
    frame = np.array([grid.x0, grid.y0, grid.posting])
    pool = TrueTerrains(
        np.stack([one.kind for one in layers]), np.stack([one.safe for one in layers]),
        np.stack([one.elevation for one in layers]), frame,
    )  # fmt: skip
    shares = np.array([one.safe[one.kind != UNKNOWN].mean() for one in layers])
    return SiteWorldPool(tuple(worlds), terrains, pool, shares)
