"""Rocks: how many, how large, where.

The size-frequency law is Golombek and Rapp's (1997): the fraction of the ground covered by rocks
of diameter D or more is ``F(D) = k exp(-q D)`` with ``q = 1.79 + 0.152 / k`` (Eq. 13 of the
shadow EKF paper), where k is the fraction covered by rocks of all sizes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import exp1

from lunarsim.errors import InputError
from lunarsim.terrain._placement_kernels import drop_rocks
from lunarsim.terrain.heightfield import Heightfield
from lunarsim.terrain.shapes import CUBE, ELLIPSOID, IRREGULAR, IRREGULAR_COUNT, shape_table


@dataclass(frozen=True)
class RockField:
    """Rocks as arrays: scaled and turned unit shapes that stand on the relief or sit in it.

    The base plane is level; it passes through the relief under the rock's centre, or below it
    for a buried rock. Where the relief falls away below the base, the outline is carried straight
    down, so that the surface stays a function of (x, y) and nothing is hollow.

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
        Unit shape of each rock (n,), a row of `lunarsim.terrain.shapes.shape_table`; left out:
        half spheres, scaled to hemi-ellipsoids.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    base: NDArray[np.float64]
    a: NDArray[np.float64]
    b: NDArray[np.float64]
    height: NDArray[np.float64]
    yaw: NDArray[np.float64]
    shape: NDArray[np.int64] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.shape is None:
            object.__setattr__(self, "shape", np.zeros(self.x.size, np.int64))

    @classmethod
    def empty(cls) -> RockField:
        """Return a field without rocks."""
        x, y, base, a, b, height, yaw = np.zeros((7, 0))
        return cls(x, y, base, a, b, height, yaw)

    @classmethod
    def hemispheres(
        cls, x: ArrayLike, y: ArrayLike, base: ArrayLike, radius: ArrayLike
    ) -> RockField:
        """Return half-buried spheres."""
        arrays = [np.array(v, dtype=np.float64, ndmin=1) for v in (x, y, base, radius)]
        cx, cy, cz, r = (np.ascontiguousarray(v) for v in np.broadcast_arrays(*arrays))
        return cls(cx, cy, cz, r, r.copy(), r.copy(), np.zeros_like(r))

    def __len__(self) -> int:
        return int(self.x.size)

    def rows(self) -> NDArray[np.float64]:
        """Return the rocks as the kernels take them (n, 9)."""
        turn = (np.cos(self.yaw), np.sin(self.yaw))
        return np.column_stack(
            (self.x, self.y, self.base, self.a, self.b, self.height, *turn, self.shape)
        )

    def reach(self) -> NDArray[np.float64]:
        """Return the radius of a disc about each centre that holds the outline (n,), m."""
        return np.asarray(np.maximum(self.a, self.b) * shape_table().reach[self.shape])


def golombek_exponent(k: float) -> float:
    """Return q of F(D) = k exp(-q D), 1/m."""
    if not 0.0 < k <= 0.5:
        raise InputError("rocks.cover", k, "a fraction between 0 and 0.5")
    return 1.79 + 0.152 / k


def golombek_cover(diameter: ArrayLike, k: float) -> NDArray[np.float64]:
    """Return F(D): the fraction of ground covered by rocks of `diameter` (m) or more."""
    return np.asarray(k * np.exp(-golombek_exponent(k) * np.asarray(diameter, dtype=np.float64)))


def golombek_number(diameter: ArrayLike, k: float) -> NDArray[np.float64]:
    """Return N(D): the number of rocks of `diameter` (m) or more on a square metre.

    From dN = -dF / (pi D^2 / 4): ``N = 4 k q^2 / pi * (exp(-x) / x - E1(x))`` with x = q D.
    """
    q = golombek_exponent(k)
    x = q * np.asarray(diameter, dtype=np.float64)
    return np.asarray(4.0 * k * q * q / np.pi * (np.exp(-x) / x - exp1(x)))


def sample_diameters(
    area: float,
    k: float,
    minimum: float,
    maximum: float,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw the diameters (m) of the rocks on `area` (m^2), largest first.

    Their number is Poisson with the mean that the law gives between `minimum` and `maximum`;
    each diameter is drawn by inverting N(D), so no size is favoured.
    """
    if not 0.0 < minimum < maximum:
        raise InputError(
            "rocks.min_diameter_m", minimum, f"more than 0 and less than the maximum {maximum}"
        )
    # The table is fine enough that linear interpolation in (log D, log N) errs below 1e-6.
    table = np.geomspace(minimum, maximum, 4096)
    number = golombek_number(table, k)
    count = int(rng.poisson(area * (number[0] - number[-1])))
    target = number[-1] + rng.random(count) * (number[0] - number[-1])
    log_d = np.interp(-np.log(target), -np.log(number), np.log(table))
    return np.sort(np.exp(log_d))[::-1].copy()


@dataclass(frozen=True)
class RockModel:
    """How rocks of a given diameter are shaped and how deep they sit.

    Attributes
    ----------
    shape
        "hemisphere"; "ellipsoid" (the top of an ellipsoid); "cube" (side D, the shadow EKF
        paper's); "irregular" (faceted convex boulders); or "mixed" (ellipsoids and irregular
        ones in equal numbers).
    height_ratio
        Mean and standard deviation of the height above ground over the diameter; drawn from a
        normal law cut at 0.2 and 1. Not for hemispheres and cubes.
    burial
        Least and greatest fraction of the rock's height that lies under the ground, drawn
        uniformly. Not for hemispheres.
    axis_ratio
        Least and greatest ratio of the horizontal axes, drawn uniformly. Not for hemispheres and
        cubes.
    """

    shape: Literal["hemisphere", "ellipsoid", "cube", "irregular", "mixed"] = "hemisphere"
    height_ratio: tuple[float, float] = (0.5, 0.1)
    burial: tuple[float, float] = (0.0, 0.5)
    axis_ratio: tuple[float, float] = (0.6, 1.0)

    def __post_init__(self) -> None:
        if self.shape not in {"hemisphere", "ellipsoid", "cube", "irregular", "mixed"}:
            raise InputError(
                "rocks.shape", self.shape, "hemisphere, ellipsoid, cube, irregular or mixed"
            )
        if not (0.2 <= self.height_ratio[0] <= 1.0 and self.height_ratio[1] >= 0.0):
            raise InputError(
                "rocks.height_ratio", self.height_ratio, "a mean from 0.2 to 1 and a deviation"
            )
        if not 0.0 <= self.burial[0] <= self.burial[1] <= 0.9:
            raise InputError("rocks.burial", self.burial, "two rising fractions from 0 to 0.9")
        if not 0.0 < self.axis_ratio[0] <= self.axis_ratio[1] <= 1.0:
            raise InputError("rocks.axis_ratio", self.axis_ratio, "two rising ratios up to 1")

    def draw(self, diameter: NDArray[np.float64], rng: np.random.Generator) -> RockField:
        """Return rocks (n) of the given diameters, all at the origin with the ground at 0.

        The diameter is that of the disc whose area the rock covers at ground level (for a cube:
        its side).
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
        # The buried part of an ellipsoid is the wider one.
        widen = np.where(faceted, 1.0, 1.0 / np.sqrt(1.0 - burial**2))
        radius = 0.5 * diameter * widen
        height = ratio * diameter / (1.0 - burial)
        return RockField(
            zero, zero, -burial * height, radius / stretch, radius * stretch, height, yaw, shape
        )


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
