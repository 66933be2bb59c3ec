"""A mapper whose map is set by hand, for maps that are made of others."""

from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.fusion import FusionPriors
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.map_evidence import TerrainEvidence
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.rocks.population import RockExpectation

TERMS = FusionPriors(Lander(), RockExpectation())
GRID = Grid.centred((0.0, 0.0), 8.0, 0.5)


class Made(HazardMapper):
    """A mapper whose map is set by hand."""

    def __init__(self):
        self.p, self.seen, self.asked = np.zeros(GRID.shape, np.float32), False, 0
        self.grid, self.observed = GRID, None

    def update(self, measurement, estimate):
        self.p = np.full(GRID.shape, measurement, np.float32)
        self.seen = True

    def hazard_map(self):
        shape = self.grid.shape
        seen = np.full(shape, self.seen) if self.observed is None else self.observed
        return HazardMap(self.grid, self.p, seen, np.full(shape, 3.0, np.float32))

    def evidence(self):
        self.asked += 1
        return TerrainEvidence(self.hazard_map()) if self.seen else None

    @property
    def is_empty(self):
        return not self.seen


class Slow(Made):
    """One whose ground takes 3 s to draw by a clock of one entry, s, and its judgement 4 s."""

    def __init__(self, clock):
        super().__init__()
        self.clock = clock

    def terrain_surface(self):
        self.clock[0] += 3.0
        return super().hazard_map()

    def hazard_map(self):
        self.clock[0] += 4.0
        return super().hazard_map()
