"""The conventional DEM: bilinear splatting and filling of holes from neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import _kernels as k
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import as_real_array, check_elements


@dataclass(frozen=True)
class ConventionalDem:
    """Elevation raster from splatted samples, with holes filled from neighbours.

    Attributes
    ----------
    grid
        Positions of the cells; values belong to cell centres.
    elevation
        Elevation (rows, cols), m, without holes.
    weight
        Sum of the sample weights of each cell (rows, cols); 0 where a hole was filled.
    """

    grid: Grid
    elevation: NDArray[np.float32]
    weight: NDArray[np.float32]


def check_points(points: ArrayLike) -> Array:
    """Check a point cloud and return its finite points (n, 3).

    Points that are masked or contain NaN are dropped.

    Raises
    ------
    InputError
        If the array is not (n, 3) of real numbers, or contains infinities.
    """
    cloud = np.ascontiguousarray(as_real_array("points", points))
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise InputError(
            "points", cloud.shape, "must have shape (n, 3), with columns east, north, up"
        )
    is_finite = finite_rows(cloud)
    if is_finite.all():
        return cloud
    check_elements(
        "points", cloud, ~np.isinf(cloud), "must not be infinite", "Use NaN for a missing point."
    )
    return cloud[is_finite]


def finite_rows(points: Array) -> BoolArray:
    """Return which points (n, 3) have three finite coordinates (n,)."""
    known = np.isfinite(points)
    return np.asarray(known[:, 0] & known[:, 1] & known[:, 2])


def conventional_dem(points: ArrayLike, grid: Grid) -> ConventionalDem:
    """Build a DEM from a point cloud (Eqs. 1 and 2 of the Gaussian DEM paper).

    Each sample is distributed over the four nearest cell centres with bilinear weights. Cells
    without a sample take the mean of their known neighbours, repeatedly.

    Parameters
    ----------
    points
        East, north, up (n, 3), m; points with NaN or off the grid are ignored.
    grid
        Cells of the DEM.

    Raises
    ------
    ValueError
        If the array is not (n, 3), contains infinities or a height beyond 8 km, or no point falls
        on the grid.
    """
    cloud = check_points(points)
    check_heights(cloud)
    base = base_height(cloud)
    height, weight = k.splat(cloud, base, grid.x0, grid.y0, grid.posting, grid.rows, grid.cols)
    if not weight.any():
        raise InputError(
            "points", points, f"must include a point on the grid, but all {len(cloud)} lie outside",
            show_value=False,
        )  # fmt: skip
    with np.errstate(invalid="ignore"):
        z = np.where(weight > 0.0, base + height.astype(np.float64) / weight, np.nan)
    k.fill_holes(z)
    return ConventionalDem(grid, z.astype(np.float32), weight)


# float32 resolves 1 mm up to this height, m.
_MAX_HEIGHT_M = 8192.0


def check_heights(cloud: Array) -> None:
    """Raise InputError if heights of points (n, 3) exceed the resolution of float32.

    Raises
    ------
    InputError
        If a point lies more than 8 km above or below the origin of the frame.
    """
    if not len(cloud):
        return
    worst = float(cloud[np.argmax(np.abs(cloud[:, 2])), 2])
    if abs(worst) > _MAX_HEIGHT_M:
        raise InputError(
            "points", worst,
            f"heights must be between {-_MAX_HEIGHT_M:.0f} and {_MAX_HEIGHT_M:.0f} m",
            "Use a frame with its origin near the terrain.",
        )  # fmt: skip


def base_height(cloud: Array) -> float:
    """Return the height of the point in the middle of a list, m, as reference height.

    Sums of heights relative to it stay small. `cloud` (n, 3) are the points; without points the
    result is 0.
    """
    return float(cloud[len(cloud) // 2, 2]) if len(cloud) else 0.0
