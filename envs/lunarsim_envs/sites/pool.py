"""A pool of worlds with what is true of them: made once, kept on disk, shared by all flights."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.campaign.cache import opened, standard_folder
from lunarsim.campaign.grounds import Grounds
from lunarsim.errors import InputError
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.world import World
from lunarsim_envs.descent.worlds import Worlds, with_covers
from lunarsim_envs.sites._map_kernels import Pool
from lunarsim_envs.sites.hazard import UNKNOWN, TruthLayers

# Pools that a process remembers: those used last.
_REMEMBERED = 4
_pools: OrderedDict[str, SitePool] = OrderedDict()


@dataclass(frozen=True)
class SitePool:
    """Worlds of a scenario, and the truth about their sites.

    Attributes
    ----------
    worlds
        As sensors see them.
    grounds
        About where their targets lie, as landers meet them.
    layers
        Class, exact safety and height of all sites, as kernels take them.
    shares
        Share of the sites of each world that is exactly safe (k,).
    """

    worlds: tuple[World, ...]
    grounds: Worlds
    layers: Pool
    shares: NDArray[np.float64]

    @classmethod
    def of(
        cls, scenario: Scenario, count: int, seed: int, covers: Sequence[float] = ()
    ) -> SitePool:
        """Return a pool; one that this process has used of late is not made again.

        Parameters
        ----------
        scenario
            Of which terrain, rocks, vehicle, Sun and the scatter of targets count.
        count, seed
            How many worlds, and their root seed: world k is that of flight k of a campaign with it.
        covers
            Of rocks, of each of which so many are drawn besides.

        Raises
        ------
        InputError
            If there are none, they take too much memory, or targets may lie off the map.
        """
        if count < 1:
            raise InputError("worlds", count, "at least 1")
        tables = ("terrain", "rocks", "vehicle", "target", "sun", "gravity_m_s2")
        held = scenario.to_dict()
        key = repr(([held.get(name) for name in tables], count, seed, tuple(covers)))
        if key not in _pools:
            _pools[key] = _made(scenario, count, seed, covers)
            while len(_pools) > _REMEMBERED:
                _pools.popitem(last=False)
        _pools.move_to_end(key)
        return _pools[key]


def _made(scenario: Scenario, count: int, seed: int, covers: Sequence[float]) -> SitePool:
    worlds: list[World] = []
    layers: list[TruthLayers] = []
    cache = opened(standard_folder())

    def drawn() -> Iterator[World]:
        for one in with_covers(scenario, covers):
            for k in range(count):
                grounds = Grounds(flight_seed(seed, k), {}, cache)
                world, truth = grounds.world_and_truth(one)
                worlds.append(world)
                layers.append(TruthLayers.of(truth))
                yield world

    grounds = Worlds.about(scenario, count, drawn(), covers)
    grid = layers[0].grid
    frame = np.array([grid.x0, grid.y0, grid.posting])
    pool = Pool(
        np.stack([one.kind for one in layers]), np.stack([one.safe for one in layers]),
        np.stack([one.elevation for one in layers]), frame,
    )  # fmt: skip
    shares = np.array([one.safe[one.kind != UNKNOWN].mean() for one in layers])
    return SitePool(tuple(worlds), grounds, pool, shares)
