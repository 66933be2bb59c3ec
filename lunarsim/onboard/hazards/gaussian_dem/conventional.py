"""The conventional DEM: bilinear splatting, holes filled by their neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import _kernels as k


@dataclass(frozen=True)
class ConventionalDem:
    """Elevations on a grid.

    Attributes
    ----------
    grid
        Places the cells; values belong to cell centres.
    elevation
        Elevation (rows, cols), m; no holes.
    weight
        Sum of the weights of the samples in each cell (rows, cols); 0 where a hole was filled.
    """

    grid: Grid
    elevation: NDArray[np.float32]
    weight: NDArray[np.float32]


def check_points(points: ArrayLike) -> NDArray[np.float64]:
    """Return the finite points (n, 3), or raise ValueError; a masked point is none.

    Raises
    ------
    ValueError
        If the array is not (n, 3) of real numbers, or holds infinities.
    """
    cloud = np.ascontiguousarray(plain(points))
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"points has shape {cloud.shape}: must be (n, 3), east, north, up")
    kept = finite_rows(cloud)
    if kept.all():
        return cloud
    if np.isinf(cloud).any():
        raise ValueError("points holds infinities: mark rays without a return by NaN")
    return cloud[kept]


def plain(values: ArrayLike) -> NDArray[np.float64]:
    """Return real numbers, NaN where they are masked.

    Raises
    ------
    ValueError
        If they are complex, text, or true and false.
    """
    if np.iscomplexobj(values):
        raise ValueError("complex numbers: must be real")
    if np.asarray(values).dtype.kind not in "fiuO":
        raise ValueError(f"values of type {np.asarray(values).dtype}: must be real numbers")
    if isinstance(values, np.ma.MaskedArray):
        return np.asarray(np.ma.filled(values.astype(np.float64), np.nan))
    return np.asarray(values, dtype=np.float64)


def finite_rows(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which points (n, 3) have all three coordinates (n,)."""
    known = np.isfinite(points)
    return np.asarray(known[:, 0] & known[:, 1] & known[:, 2])


def conventional_dem(points: ArrayLike, grid: Grid) -> ConventionalDem:
    """Build a DEM from a point cloud (Eqs. 1 and 2 of the Gaussian DEM paper).

    Each sample is spread over the four nearest cell centres with bilinear weights, which
    accumulate; cells without a sample take the mean of their known neighbours, repeatedly.

    Parameters
    ----------
    points
        East, north, up (n, 3), m; rows with NaN are left out, points off the grid too.
    grid
        The cells.

    Raises
    ------
    ValueError
        If the array is not (n, 3), holds infinities, or no point falls on the grid.
    """
    cloud = check_points(points)
    check_heights(cloud)
    base = base_height(cloud)
    height, weight = k.splat(cloud, base, grid.x0, grid.y0, grid.posting, grid.rows, grid.cols)
    if not weight.any():
        raise ValueError(f"points: none of the {len(cloud)} falls on the grid")
    with np.errstate(invalid="ignore"):
        z = np.where(weight > 0.0, base + height.astype(np.float64) / weight, np.nan)
    k.fill_holes(z)
    return ConventionalDem(grid, z.astype(np.float32), weight)


# Farther up or down float32 tells no millimetres.
_FARTHEST = 8192.0


def check_heights(cloud: NDArray[np.float64]) -> None:
    """Refuse points (n, 3) that a map in float32 cannot hold.

    Raises
    ------
    InputError
        If one lies more than 8 km above or below the frame's origin.
    """
    if not len(cloud):
        return
    worst = float(cloud[np.argmax(np.abs(cloud[:, 2])), 2])
    if abs(worst) > _FARTHEST:
        raise InputError(
            "points", worst,
            f"heights within {_FARTHEST:.0f} m of the frame's origin; take a local frame",
        )  # fmt: skip


def base_height(cloud: NDArray[np.float64]) -> float:
    """Return a height (m) near the cloud's, so that sums of heights above it stay small."""
    return float(cloud[len(cloud) // 2, 2]) if len(cloud) else 0.0
