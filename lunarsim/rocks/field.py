"""Rocks as arrays, and the shapes of rocks of a given diameter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError, check_types
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.shapes import CUBE, ELLIPSOID, IRREGULAR, IRREGULAR_COUNT, shape_table
from lunarsim.typing import Array, IntArray

Shape = Literal["hemisphere", "ellipsoid", "cube", "irregular", "mixed"]


@dataclass(frozen=True)
class RockField:
    """Set of rocks, stored as arrays: scaled and rotated unit shapes on the relief.

    The base plane of a rock is horizontal; it passes through the relief under the rock's centre, or
    below the relief for a buried rock. Where the relief is below the base, the rock continues
    vertically down, so that the surface is a function of (x, y) without cavities.

    Attributes
    ----------
    x, y
        Centres (n,), m.
    base
        Elevation of the base plane of each rock (n,), m.
    a, b
        Horizontal semi-axes (n,), m; `a` lies along `yaw`.
    height
        Height above the base (n,), m.
    yaw
        Direction of the first semi-axis, counter-clockwise from east (n,), rad.
    shape
        Unit shape of each rock (n,), a row of `lunarsim.rocks.shapes.shape_table`; omitted:
        hemispheres, scaled to half ellipsoids.
    """

    x: Array
    y: Array
    base: Array
    a: Array
    b: Array
    height: Array
    yaw: Array
    shape: IntArray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.shape is None:
            object.__setattr__(self, "shape", np.zeros(self.x.size, np.int64))

    @classmethod
    def empty(cls) -> RockField:
        """Return an empty set of rocks."""
        x, y, base, a, b, height, yaw = np.zeros((7, 0))
        return cls(x, y, base, a, b, height, yaw)

    @classmethod
    def hemispheres(
        cls, x: ArrayLike, y: ArrayLike, base: ArrayLike, radius: ArrayLike
    ) -> RockField:
        """Return hemispherical rocks with given centres, base elevations and radii, m."""
        arrays = [np.array(v, dtype=np.float64, ndmin=1) for v in (x, y, base, radius)]
        cx, cy, cz, r = (np.ascontiguousarray(v) for v in np.broadcast_arrays(*arrays))
        return cls(cx, cy, cz, r, r.copy(), r.copy(), np.zeros_like(r))

    def __len__(self) -> int:
        return int(self.x.size)

    def rows(self) -> Array:
        """Return the rocks as one array (n, 9) for compiled functions.

        The columns are x, y, base, a, b, height, cosine and sine of the yaw, and shape.
        """
        turn = (np.cos(self.yaw), np.sin(self.yaw))
        return np.column_stack(
            (self.x, self.y, self.base, self.a, self.b, self.height, *turn, self.shape)
        )

    def reach(self) -> Array:
        """Return the radius (n,), m, of a disc around each centre that holds the outline."""
        return np.asarray(np.maximum(self.a, self.b) * shape_table().reach[self.shape])


@dataclass(frozen=True)
class RockModel:
    """Statistics of the shapes and burial of rocks.

    Attributes
    ----------
    shape
        "hemisphere"; "ellipsoid" (the top of an ellipsoid); "cube" (side D, as in the shadow EKF
        paper); "irregular" (faceted convex boulders); or "mixed" (equal numbers of ellipsoids and
        irregular boulders).
    height_ratio
        Mean and standard deviation of the exposed height over the diameter, from a normal
        distribution clipped to 0.2 and 1. Not used for hemispheres and cubes. The mean of lunar
        rocks is 0.54 (Demidov and Basilevsky 2014).
    burial
        Minimum and maximum fraction of the rock's height below the terrain, uniformly distributed.
        Not used for hemispheres.
    axis_ratio
        Minimum and maximum ratio of the horizontal axes, uniformly distributed. Not used for
        hemispheres and cubes. The mean ratio of the two longer axes of impact fragments and of
        boulders on Eros is 0.7 (Michikami et al. 2010, 2016), as with limits of 0.5 and 0.9.
    """

    shape: Shape = quantity(
        "hemisphere",
        help="shape of the rocks; irregular: faceted convex boulders; mixed: ellipsoids and "
        "irregular boulders in equal numbers",
    )
    height_ratio: tuple[float, float] = quantity(
        (0.5, 0.1),
        help="exposed height of a rock divided by its diameter: mean and standard deviation; not "
        "used for hemispheres and cubes",
    )
    burial: tuple[float, float] = quantity(
        (0.0, 0.5),
        help="buried fraction of a rock's height: minimum and maximum; not used for hemispheres",
    )
    axis_ratio: tuple[float, float] = quantity(
        (0.6, 1.0),
        help="shorter horizontal axis of a rock divided by its longer one: minimum and maximum; "
        "not used for hemispheres and cubes",
    )

    def __post_init__(self) -> None:
        check_types("rocks", self)
        if self.shape not in {"hemisphere", "ellipsoid", "cube", "irregular", "mixed"}:
            raise InputError(
                "rocks.shape",
                self.shape,
                "must be hemisphere, ellipsoid, cube, irregular or mixed",
            )
        if not (0.2 <= self.height_ratio[0] <= 1.0 and self.height_ratio[1] >= 0.0):
            raise InputError(
                "rocks.height_ratio",
                self.height_ratio,
                "must be a mean between 0.2 and 1, and a standard deviation of 0 or more",
            )
        if not 0.0 <= self.burial[0] <= self.burial[1] <= 0.9:
            raise InputError(
                "rocks.burial", self.burial, "must be a minimum and a maximum between 0 and 0.9"
            )
        if not 0.0 < self.axis_ratio[0] <= self.axis_ratio[1] <= 1.0:
            raise InputError(
                "rocks.axis_ratio",
                self.axis_ratio,
                "must be a minimum above 0 and a maximum of at most 1",
            )

    def draw(self, diameter: Array, rng: np.random.Generator) -> RockField:
        """Sample shapes and burial of rocks with the given diameters (n,), m.

        The rocks are at the origin, with the terrain at elevation 0; they are placed later.

        The diameter is that of a disc with the area that the rock covers at terrain level (for a
        cube: its side).
        """
        n = diameter.size
        zero = np.zeros(n)
        if self.shape == "hemisphere":
            return RockField.hemispheres(zero, zero, zero, 0.5 * diameter)
        burial = rng.uniform(*self.burial, n)
        yaw = rng.uniform(0.0, 2.0 * np.pi, n)
        if self.shape == "cube":
            half = 0.5 * diameter
            cube = np.full(n, CUBE)
            return RockField(zero, zero, -burial * diameter, half, half, diameter, yaw, cube)
        ratio = np.clip(rng.normal(*self.height_ratio, n), 0.2, 1.0)
        stretch = np.sqrt(rng.uniform(*self.axis_ratio, n))
        faceted = {
            "ellipsoid": np.zeros(n, bool),
            "irregular": np.ones(n, bool),
        }.get(self.shape, rng.random(n) < 0.5)
        shape = np.where(
            faceted, rng.integers(IRREGULAR, IRREGULAR + IRREGULAR_COUNT, n), ELLIPSOID
        )
        # The buried part of an ellipsoid is wider than its outline at terrain level.
        widen = np.where(faceted, 1.0, 1.0 / np.sqrt(1.0 - burial**2))
        radius = 0.5 * diameter * widen
        height = ratio * diameter / (1.0 - burial)
        return RockField(
            zero, zero, -burial * height, radius / stretch, radius * stretch, height, yaw, shape
        )
