"""Rocks set down at random on the relief."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.world.terrain._placement_kernels import drop_rocks
from lunarsim.world.terrain.heightfield import Heightfield


def place_rocks(
    relief: Heightfield,
    diameters: ArrayLike,
    rng: np.random.Generator,
    *,
    model: RockModel | None = None,
    tries: int = 200,
) -> RockField:
    """Place rocks at random on the relief without overlap, widest first.

    A rock that finds no free spot in `tries` draws means that the field is overfull.

    Parameters
    ----------
    relief
        The ground.
    diameters
        m (n,).
    rng
        Source of places and shapes.
    model
        Shapes and burial; left out: hemispheres.
    tries
        Draws a rock.

    Raises
    ------
    InputError
        If the rocks do not fit.
    """
    diameters = np.sort(np.asarray(diameters, dtype=np.float64))[::-1]
    if diameters.size == 0:
        return RockField.empty()
    field = (model or RockModel()).draw(diameters, rng)
    reach = field.reach()
    order = np.argsort(-reach, kind="stable")
    west, east, south, north = relief.bounds
    g = relief.grid
    seed = int(rng.integers(2**32))
    x, y, ground, placed = drop_rocks(
        reach[order], west, east, south, north, relief.z, g.x0, g.y0, g.posting, seed, tries
    )
    if placed < reach.size:
        raise InputError(
            "rocks.cover",
            f"{placed} of {reach.size} rocks placed",
            "a smaller cover: the rest found no room without overlap",
        )
    return RockField(
        x,
        y,
        ground + field.base[order],
        field.a[order],
        field.b[order],
        field.height[order],
        field.yaw[order],
        field.shape[order],
    )
