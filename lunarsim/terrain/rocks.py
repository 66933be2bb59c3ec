"""Rocks: how many, how large, where.

The size-frequency law is Golombek and Rapp's (1997): the fraction of the ground covered by rocks
of diameter D or more is ``F(D) = k exp(-q D)`` with ``q = 1.79 + 0.152 / k`` (Eq. 13 of the
shadow EKF paper), where k is the fraction covered by rocks of all sizes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import exp1

from lunarsim.errors import InputError
from lunarsim.terrain._placement_kernels import drop_rocks
from lunarsim.terrain.heightfield import Heightfield
from lunarsim.terrain.shapes import shape_table


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
        return cls(*(np.zeros(0) for _ in range(7)))

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


def _exponent(k: float) -> float:
    if not 0.0 < k <= 0.5:
        raise InputError("rocks.cover", k, "a fraction between 0 and 0.5")
    return 1.79 + 0.152 / k


def golombek_cover(diameter: ArrayLike, k: float) -> NDArray[np.float64]:
    """Return F(D): the fraction of ground covered by rocks of `diameter` (m) or more."""
    return np.asarray(k * np.exp(-_exponent(k) * np.asarray(diameter, dtype=np.float64)))


def golombek_number(diameter: ArrayLike, k: float) -> NDArray[np.float64]:
    """Return N(D): the number of rocks of `diameter` (m) or more on a square metre.

    From dN = -dF / (pi D^2 / 4): ``N = 4 k q^2 / pi * (exp(-x) / x - E1(x))`` with x = q D.
    """
    q = _exponent(k)
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


def place_rocks(
    relief: Heightfield, diameters: ArrayLike, rng: np.random.Generator, *, tries: int = 200
) -> RockField:
    """Place hemispheres at random on the relief without overlap, largest first.

    A rock that finds no free spot in `tries` draws means that the field is overfull.

    Raises
    ------
    InputError
        If the rocks do not fit.
    """
    radius = 0.5 * np.sort(np.asarray(diameters, dtype=np.float64))[::-1]
    if radius.size == 0:
        return RockField.empty()
    west, east, south, north = relief.bounds
    seed = int(rng.integers(2**32))
    x, y, base, placed = drop_rocks(
        radius,
        west,
        east,
        south,
        north,
        np.ascontiguousarray(relief.z),
        relief.grid.x0,
        relief.grid.y0,
        relief.grid.posting,
        seed,
        tries,
    )
    if placed < radius.size:
        raise InputError(
            "rocks.cover",
            f"{placed} of {radius.size} rocks placed",
            "a smaller cover: the rest found no room without overlap",
        )
    return RockField.hemispheres(x, y, base, radius)
