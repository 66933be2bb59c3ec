"""Ground that slopes, as it is and as a mapper has measured it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.world.terrain import Heightfield


def sloping(gradient, size, posting):
    grid = Grid.centred((0.0, 0.0), size, posting)
    x, y = np.meshgrid(grid.x, grid.y)
    return Heightfield(grid, (gradient[0] * x + gradient[1] * y).astype(np.float32))


class Slope:
    """A mapper of elevations that has measured a plane."""

    def __init__(self, gradient):
        self.asked = 0
        self.grid = Grid.centred((0.0, 0.0), 60.0, 1.0)
        x, y = np.meshgrid(self.grid.x, self.grid.y)
        height = (gradient[0] * x + gradient[1] * y).astype(np.float32)
        self.drawn = replace(
            self.unobserved(), observed=np.ones(self.grid.shape, bool), elevation=height
        )

    def unobserved(self):
        return HazardMap.unobserved(self.grid)

    def terrain_surface(self):
        self.asked += 1
        return self.drawn
