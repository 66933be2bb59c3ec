"""Soil banked against rocks: what small impacts throw about piles up at their feet."""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError
from lunarsim.rocks.field import RockField
from lunarsim.world.terrain._fillet_kernels import bank
from lunarsim.world.terrain.heightfield import Heightfield
from lunarsim.world.terrain.terrain import Terrain

# How far from a rock soil lies, in its radii.
REACH = 0.6


def add_fillets(relief: Heightfield, rocks: RockField, share: float) -> Heightfield:
    """Return relief with soil banked against rocks.

    It is highest at the outline, taken as the ellipse of the rock's axes, and falls to nothing in a
    curve that is 0.6 radii long; between two rocks the higher one counts. Rocks stay where they
    are. Soil that is narrower than a post or two shows as a post that is raised, or not at all.

    Parameters
    ----------
    relief
        The ground before.
    rocks
        On it.
    share
        Height of the soil over that of the rock above the ground, from 0 to 0.5.
    """
    if not 0.0 <= share <= 0.5:
        raise InputError("rocks.fillet", share, "a share from 0 to 0.5")
    if share == 0.0 or len(rocks) == 0:
        return relief
    g = relief.grid
    ground = Terrain(relief).elevation(np.column_stack((rocks.x, rocks.y)))
    height = share * np.clip(np.nan_to_num(rocks.base + rocks.height - ground), 0.0, None)
    soil = np.zeros(g.shape, np.float32)
    bank(
        soil, g.x0, g.y0, g.posting, rocks.x, rocks.y, rocks.a, rocks.b, np.cos(rocks.yaw),
        np.sin(rocks.yaw), height, REACH,
    )  # fmt: skip
    return Heightfield(g, relief.z + soil)
