"""Fillets: soil that small impacts pile up against rocks."""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError
from lunarsim.rocks.field import RockField
from lunarsim.world.terrain._fillet_kernels import raise_fillets
from lunarsim.world.terrain.heightfield import Heightfield
from lunarsim.world.terrain.terrain import Terrain

# Width of a fillet, in rock radii.
FILLET_WIDTH_RADII = 0.6


def add_fillets(relief: Heightfield, rocks: RockField, height_ratio: float) -> Heightfield:
    """Raise the relief around rocks by fillets, soil that is piled up against them.

    The soil is highest at the outline, the ellipse of the rock's axes, and falls quadratically to
    zero over 0.6 rock radii; where two fillets overlap, the higher one counts. Rocks do not move. A
    fillet narrower than the grid spacing raises one grid point or none.

    Parameters
    ----------
    relief
        Relief without the fillets.
    rocks
        Rocks on the relief.
    height_ratio
        Height of the soil divided by the exposed height of the rock, from 0 to 0.5.

    Returns
    -------
    Heightfield
        Relief with the soil on the same grid.
    """
    if not 0.0 <= height_ratio <= 0.5:
        raise InputError("rocks.fillet_height_ratio", height_ratio, "must be between 0 and 0.5")
    if height_ratio == 0.0 or len(rocks) == 0:
        return relief
    g = relief.grid
    terrain_height = Terrain(relief).elevation(np.column_stack((rocks.x, rocks.y)))
    height = height_ratio * np.clip(
        np.nan_to_num(rocks.base + rocks.height - terrain_height), 0.0, None
    )
    soil = np.zeros(g.shape, np.float32)
    raise_fillets(
        soil, g.x0, g.y0, g.posting, rocks.x, rocks.y, rocks.a, rocks.b, np.cos(rocks.yaw),
        np.sin(rocks.yaw), height, FILLET_WIDTH_RADII,
    )  # fmt: skip
    return Heightfield(g, relief.z + soil)
