"""Rasters as the safety tests take them: what is ground, what is unknown, what is refused.

Rule for unknown ground: a height counts as ground if it is a number, its size is under 1e9 m and it
lies within 30 km of the middle of the map, the lower median of at most 4,096 of its heights. The
Moon's whole relief is 20 km, so what lies further off is a mark for missing data (-3.4e38, 1e20) or
a fault; like NaN, infinities and masked cells it makes the footprints that hold it unobserved. A
mark within 30 km of the ground (-9999), or one of less than 1e9 m that fills half of a map, cannot
be told from ground: mask it.

Heights keep their type until a tile's datum, one of its own heights, has been taken off. Height
differences in float32 are therefore as fine at 10,000 km above zero as they are at zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.safety.footprint import Footprint

_FARTHEST = 1e9  # m: no frame puts ground further from zero
_SAMPLES = 64  # rows and columns, at most, that the middle of a map is taken from


@dataclass(frozen=True)
class Ground:
    """Elevation ready for kernels.

    Attributes
    ----------
    z
        Elevation (rows, cols), float32 or float64, C-contiguous, m.
    middle
        Middle of the map, m: what lies far from it is unknown.
    """

    z: NDArray[Any]
    middle: float

    @property
    def double(self) -> NDArray[np.float64]:
        """Elevation as float64, for the kernels that are compiled for nothing else."""
        return self.z.astype(np.float64, copy=False)


def ground(name: str, values: ArrayLike, grid: Grid, footprint: Footprint) -> Ground:
    """Return an elevation raster ready for kernels.

    Raises
    ------
    InputError
        If it holds no real numbers, does not fit the grid, or the grid is smaller than the
        footprint.
    """
    raster = _numbers(name, values)
    if raster.dtype != np.float32:
        raster = _as(np.float64, raster)
    _check_shape(name, raster, grid, footprint)
    return Ground(_own(raster), _middle(raster))


def variances(values: ArrayLike, grid: Grid, footprint: Footprint) -> NDArray[np.float32]:
    """Return a variance raster as float32; NaN and infinity stand for unknown ground.

    Raises
    ------
    InputError
        As `ground`, and if a variance is negative.
    """
    raster = _numbers("variance", values)
    _check_shape("variance", raster, grid, footprint)
    raster = _as(np.float32, raster)
    least = float(np.fmin.reduce(raster, axis=None))
    if least < 0.0:
        raise InputError("variance", least, "must not be negative")
    return _own(raster)


def _numbers(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return real numbers; NaN where masked."""
    raster: NDArray[Any] = np.ma.getdata(values)
    if raster.dtype.kind not in "iuf":
        raise InputError(name, raster.dtype.name, "an array of real numbers")
    mask = np.ma.getmask(values)
    if np.any(mask):
        raster = raster.astype(np.float64)
        raster[mask] = np.nan
    return raster


def _as(kind: Any, raster: NDArray[Any]) -> NDArray[Any]:
    with np.errstate(over="ignore"):  # too large a number becomes infinite, hence unknown
        return raster.astype(kind, copy=False)


def _own(raster: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous raster that may be written to: kernels are compiled for these alone."""
    raster = np.ascontiguousarray(raster)
    return raster if raster.flags.writeable else raster.copy()


def _check_shape(name: str, raster: NDArray[Any], grid: Grid, footprint: Footprint) -> None:
    if raster.shape != grid.shape:
        raise InputError(f"{name}.shape", raster.shape, f"{grid.shape}, as the grid")
    if min(grid.shape) <= 2 * footprint.reach:
        side = (2 * footprint.reach + 1) * grid.posting
        raise InputError(
            "grid.shape", grid.shape, f"must be larger than the footprint, {side:.2f} m"
        )


def _middle(raster: NDArray[Any]) -> float:
    """Return one of the heights in the middle of the map; 0 if there are none."""
    rows, cols = raster.shape
    some = raster[:: -(-rows // _SAMPLES), :: -(-cols // _SAMPLES)].ravel()
    some = some[np.abs(some) < _FARTHEST]
    if some.size == 0:
        some = raster[np.abs(raster) < _FARTHEST]
    if some.size == 0:
        return 0.0
    at = (some.size - 1) // 2
    return float(np.partition(some, at)[at])
