"""Placement of rocks on the relief, at random or at given places."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.rocks.rock_file import GivenRocks
from lunarsim.typing import Array
from lunarsim.world.terrain._placement_kernels import drop_rocks
from lunarsim.world.terrain.heightfield import Heightfield
from lunarsim.world.terrain.terrain import Terrain

# Outer limit of the blocks around a crater, crater radii.
_MAX_CLUSTER_RADII = 5.0


@dataclass(frozen=True)
class CraterClusters:
    """Craters around which rocks ("blocks") are clustered.

    The density of blocks falls with the cube of the distance from the crater's centre, like ejecta
    (McGetchin, Settle and Head 1973), from the rim to five radii. The number of blocks is
    proportional to the crater's area.

    Attributes
    ----------
    x, y, radius
        Centres and radii (n,), m.
    cluster_fraction
        Fraction of the rocks that lie around the craters; the others lie anywhere.
    """

    x: Array
    y: Array
    radius: Array
    cluster_fraction: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.cluster_fraction <= 1.0:
            raise InputError(
                "rocks.cluster_fraction", self.cluster_fraction, "must be between 0 and 1"
            )
        if self.cluster_fraction > 0.0 and not self.radius.size:
            raise InputError(
                "rocks.cluster_fraction",
                self.cluster_fraction,
                "must be 0, because no crater is larger than rocks.min_block_crater_diameter_m",
            )

    def rows(self) -> Array:
        """Return the craters as an array (4, n): x, y, radius, cumulative area fraction."""
        area = np.cumsum(self.radius**2)
        total = area / area[-1] if area.size else area
        return np.stack((self.x, self.y, self.radius, total))


NO_CLUSTERS = CraterClusters(np.zeros(0), np.zeros(0), np.zeros(0), 0.0)


def place_rocks(
    relief: Heightfield,
    diameters: ArrayLike,
    rng: np.random.Generator,
    *,
    model: RockModel | None = None,
    tries: int = 200,
    clusters: CraterClusters = NO_CLUSTERS,
) -> RockField:
    """Place rocks of given diameters at random on a relief, without overlap.

    Parameters
    ----------
    relief
        Relief on which the rocks are placed, widest first.
    diameters
        Diameters of the rocks (n,), m.
    rng
        Source of positions and shapes.
    model
        Shapes and burial; omitted: hemispheres.
    tries
        Attempts per rock; if all attempts for one rock fail, the field is too full.
    clusters
        Craters around which a fraction of the rocks is clustered; omitted: rocks lie anywhere.

    Returns
    -------
    RockField
        The placed rocks.

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
    x, y, terrain_height, placed = drop_rocks(
        reach[order], west, east, south, north, relief.z, g.x0, g.y0, g.posting, seed, tries,
        clusters.cluster_fraction, clusters.rows(), _MAX_CLUSTER_RADII,
    )  # fmt: skip
    if placed < reach.size:
        raise InputError(
            "rocks.cover",
            placed,
            f"must be smaller, because only {placed} of {reach.size} rocks fit without overlap",
            show_value=False,
        )
    return RockField(
        x,
        y,
        terrain_height + field.base[order],
        field.a[order],
        field.b[order],
        field.height[order],
        field.yaw[order],
        field.shape[order],
    )


def place_given_rocks(
    relief: Heightfield, given: GivenRocks, rng: np.random.Generator, model: RockModel
) -> RockField:
    """Place rocks with given positions and diameters on a relief.

    Parameters
    ----------
    relief
        Relief on which the rocks are placed.
    given
        Positions, diameters and exposed heights.
    rng
        Source of shapes, burial and directions, and of the heights that are not given.
    model
        Shapes and burial.

    Raises
    ------
    InputError
        If a rock is outside the relief or over no-data.
    """
    elevation = Terrain(relief).elevation(np.column_stack((given.x, given.y)))
    lost = np.flatnonzero(~np.isfinite(elevation))
    if len(lost):
        k = int(lost[0])
        raise InputError(
            "rocks.path", f"({given.x[k]:g}, {given.y[k]:g}) m",
            f"must contain only rocks on the terrain, because {len(lost)} of {len(given.x)} are "
            "not on it",
        )  # fmt: skip
    field = model.draw(given.diameter, rng)
    exposed = field.height + field.base
    scale = np.where(np.isnan(given.height), 1.0, given.height / exposed)
    return replace(
        field, x=given.x, y=given.y, base=elevation + scale * field.base,
        height=scale * field.height,
    )  # fmt: skip
