"""Terrain of a flight and its true landing safety, shared by all arms and cached.

Terrain and rocks are generated again for each flight index, which takes hundredths of a second.
The safe fraction of the target area takes longer; it is what the cache stores.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.campaign.cache import Arrays, DiskCache
from lunarsim.campaign.factors import GROUND_TABLES, TRUTH_TABLES, tables_as_text
from lunarsim.campaign.provenance import file_digests
from lunarsim.rng import RandomStreams
from lunarsim.safety import SafetyMap
from lunarsim.scenario import Scenario
from lunarsim.simulation import build_world
from lunarsim.world import World
from lunarsim.world.truth import TerrainTruth

# Share of the target area that is exactly safe, at any heading and at one heading.
SAFE_SHARE_COLUMNS = ("safe_share", "safe_share_at_heading")


@dataclass(frozen=True)
class WorldTruthProvider:
    """Provider of the true terrain and its landing safety for one flight index.

    Attributes
    ----------
    seed
        Seed of the flight.
    memory
        Worlds and safety maps of this index computed in this process so far; extended here.
    cache
        Disk cache, or None.
    """

    seed: np.random.SeedSequence
    memory: dict[Any, Any]
    cache: DiskCache | None = None

    def world_and_truth(self, scenario: Scenario) -> tuple[World, TerrainTruth]:
        """Return the true world of a scenario and its landing safety for the lander."""
        terrain_key = ("ground", tables_as_text(scenario, GROUND_TABLES))
        world = build_world(scenario, RandomStreams(self.seed), self.memory.get(terrain_key))
        self.memory.setdefault(terrain_key, world.terrain)
        known = ("truth", tables_as_text(scenario, TRUTH_TABLES))
        if known not in self.memory:
            self.memory[known] = TerrainTruth.of(world, scenario.vehicle.make())
        return world, self.memory[known]

    def raster(self, scenario: Scenario) -> tuple[World, SafetyMap, NDArray[np.float32]]:
        """Return the world, the safety of its raster, and its elevation.

        The safety is that of `TerrainTruth.raster_safety`, the elevation (rows, cols) that of its
        cells, m.
        """
        world, truth = self.world_and_truth(scenario)
        key = ("truth", tables_as_text(scenario, TRUTH_TABLES))
        found = self._cached(key, scenario, lambda: _raster_arrays(truth))
        maps = (found[name] for name in ("slope", "roughness", "safe", "observed"))
        return world, SafetyMap(truth.grid, *maps), found["elevation"]

    def shares(self, scenario: Scenario, truth: TerrainTruth) -> dict[str, float]:
        """Return the fractions of the target area that are truly safe to land on.

        They are for all headings of the lander and for the heading of the start, by column name.
        """
        tables = tables_as_text(scenario, (*TRUTH_TABLES, "target"))
        key = ("shares", tables, scenario.start.heading_deg)
        if key not in self.memory:
            found = self._cached(key, scenario, lambda: _compute_shares(scenario, truth))
            self.memory[key] = {name: float(found[name]) for name in SAFE_SHARE_COLUMNS}
        return self.memory[key]  # type: ignore[no-any-return]

    def _cached(self, key: tuple[Any, ...], scenario: Scenario, make: Any) -> Arrays:
        """Return arrays from the disk cache; compute them with `make` if they are missing.

        `key` identifies the arrays, together with the scenario's files and the seed.
        """
        tables = {name: scenario.to_dict().get(name) for name in TRUTH_TABLES}
        # Changes in the code of external parts are not detected, so they are not cached.
        if self.cache is None or any(":" in str((t or {}).get("kind")) for t in tables.values()):
            return make()  # type: ignore[no-any-return]
        files = file_digests(tables)
        seed = (self.seed.entropy, self.seed.spawn_key)
        return self.cache.get(key[0], repr((key, sorted(files.items()), seed)), make)


def _raster_arrays(truth: TerrainTruth) -> Arrays:
    safety = truth.raster_safety()
    return {
        "slope": safety.slope,
        "roughness": safety.roughness,
        "safe": safety.safe,
        "observed": safety.observed,
        "elevation": truth.terrain.raster(truth.grid),
    }


def _compute_shares(scenario: Scenario, truth: TerrainTruth) -> Arrays:
    # A scatter of zero still means a spot: evaluate a footprint's width around it.
    half = np.maximum(scenario.target.scatter_m, 2.0)
    centre = scenario.target.position_m
    heading = float(np.deg2rad(scenario.start.heading_deg))
    values = truth.safe_fraction(centre, half), truth.safe_fraction(centre, half, heading)
    return {name: np.array(value) for name, value in zip(SAFE_SHARE_COLUMNS, values, strict=True)}
