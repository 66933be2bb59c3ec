"""Rocks set down at random on the relief."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.world.terrain._placement_kernels import drop_rocks
from lunarsim.world.terrain.heightfield import Heightfield

# Blocks lie from the rim out to so many radii of their crater.
_FARTHEST = 5.0


@dataclass(frozen=True)
class Clusters:
    """Craters with blocks about them.

    About each, blocks thin with the cube of the distance from its middle, as ejecta do (McGetchin,
    Settle and Head 1973), from the rim to five radii; a crater has as many as its area is large.

    Attributes
    ----------
    x, y, radius
        Middles and radii (n,), m.
    share
        Of the rocks, how many lie about them; the others lie anywhere.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    radius: NDArray[np.float64]
    share: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise InputError("rocks.clustered", self.share, "a share from 0 to 1")
        if self.share > 0.0 and not self.radius.size:
            raise InputError("rocks.clustered", self.share, "0 where there is no crater for blocks")

    def rows(self) -> NDArray[np.float64]:
        """Return the craters as the kernel takes them (4, n): x, y, radius, shares summed up."""
        area = np.cumsum(self.radius**2)
        total = area / area[-1] if area.size else area
        return np.stack((self.x, self.y, self.radius, total))


NOWHERE = Clusters(np.zeros(0), np.zeros(0), np.zeros(0), 0.0)


def place_rocks(
    relief: Heightfield,
    diameters: ArrayLike,
    rng: np.random.Generator,
    *,
    model: RockModel | None = None,
    tries: int = 200,
    clusters: Clusters = NOWHERE,
) -> RockField:
    """Place rocks at random on the relief without overlap, widest first.

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
        Draws a rock; one that finds no free spot in so many means that the field is overfull.
    clusters
        Craters with blocks about them; left out: rocks lie anywhere.

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
        reach[order], west, east, south, north, relief.z, g.x0, g.y0, g.posting, seed, tries,
        clusters.share, clusters.rows(), _FARTHEST,
    )  # fmt: skip
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
