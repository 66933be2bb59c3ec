"""Preparation of rasters for the safety tests: valid, unknown and refused values.

Rule for unknown terrain: a height is valid if it is a number, its magnitude is below 1e9 m, and it
lies within 30 km of the middle of the map, which is the lower median of at most 4,096 of its
heights. The complete relief of the Moon is 20 km, so that values farther away are no-data markers
(-3.4e38, 1e20) or faults. Like NaN, infinities and masked cells they make the footprints that
contain them unobserved. A marker within 30 km of the terrain (-9999), or one below 1e9 m that fills
half of a map, cannot be distinguished from terrain: mask it.

Heights keep their type until a tile's datum, one of its heights, has been subtracted. Height
differences in float32 are therefore as precise at 10,000 km above zero as at zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.safety.footprint import Footprint
from lunarsim.typing import Array

_MAX_HEIGHT_M = 1e9  # every frame has terrain heights below this magnitude
_MAX_SAMPLES = 64  # maximum rows and columns used for the middle of a map


@dataclass(frozen=True)
class ElevationRaster:
    """Elevation raster in the form that the compiled kernels require.

    Attributes
    ----------
    z
        Elevation (rows, cols), float32 or float64, C-contiguous, m.
    middle
        Middle of the map's heights, m: heights more than 30 km from it count as unknown.
    """

    z: NDArray[Any]
    middle: float

    @property
    def z_float64(self) -> Array:
        """Elevation as float64 (rows, cols), m, for kernels compiled only for this type."""
        return self.z.astype(np.float64, copy=False)


def prepare_elevation(
    name: str, values: ArrayLike, grid: Grid, footprint: Footprint
) -> ElevationRaster:
    """Return an elevation raster in the form that the compiled kernels require.

    `name` is the argument that an error names, `values` are elevations, m.

    Raises
    ------
    InputError
        If `values` are not real numbers, do not fit the grid, or the grid is smaller than the
        footprint.
    """
    raster = _real_numbers(name, values)
    if raster.dtype != np.float32:
        raster = _cast(np.float64, raster)
    _check_shape(name, raster, grid, footprint)
    return ElevationRaster(_contiguous(raster), _middle(raster))


def prepare_variance(values: ArrayLike, grid: Grid, footprint: Footprint) -> NDArray[np.float32]:
    """Return a variance raster (m^2) as float32; NaN and infinity mean unknown.

    Raises
    ------
    InputError
        If `values` are not real numbers or do not fit the grid, the grid is smaller than the
        footprint, or a variance is negative.
    """
    raster = _real_numbers("variance", values)
    _check_shape("variance", raster, grid, footprint)
    raster = _cast(np.float32, raster)
    minimum = float(np.fmin.reduce(raster, axis=None))
    if minimum < 0.0:
        raise InputError("variance", minimum, "must be 0 or more")
    return _contiguous(raster)


def _real_numbers(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return an array of real numbers, with NaN where masked; reject other types.

    `name` is the argument that the error names.
    """
    raster: NDArray[Any] = np.ma.getdata(values)
    if raster.dtype.kind not in "iuf":
        problem = f"must be an array of real numbers, not of type {raster.dtype.name}"
        raise InputError(name, raster.dtype, problem, show_value=False)
    mask = np.ma.getmask(values)
    if np.any(mask):
        raster = raster.astype(np.float64)
        raster[mask] = np.nan
    return raster


def _cast(kind: Any, raster: NDArray[Any]) -> NDArray[Any]:
    """Convert a raster to the type `kind`; values too large for it become infinite."""
    with np.errstate(over="ignore"):  # overflow becomes infinity, hence unknown
        return raster.astype(kind, copy=False)


def _contiguous(raster: NDArray[Any]) -> NDArray[Any]:
    """Return a raster as a contiguous writable array, as the kernels require."""
    raster = np.ascontiguousarray(raster)
    return raster if raster.flags.writeable else raster.copy()


def _check_shape(name: str, raster: NDArray[Any], grid: Grid, footprint: Footprint) -> None:
    """Raise InputError if a raster differs in shape from its grid or is too small.

    It is too small if the footprint does not fit; `name` is the argument that the error names.
    """
    if raster.shape != grid.shape:
        raise InputError(
            f"{name}.shape", raster.shape, f"must be the shape of the grid, {grid.shape}"
        )
    if min(grid.shape) <= 2 * footprint.reach:
        rows = 2 * footprint.reach + 1
        raise InputError(
            "grid.shape",
            grid.shape,
            f"must have at least {rows} rows and columns, the size of the lander's footprint",
        )


def _middle(raster: NDArray[Any]) -> float:
    """Return the lower median of a sample of a raster's heights, m.

    Heights that are not finite or reach 1e9 m are ignored; if there are no others, it is 0.
    """
    rows, cols = raster.shape
    some = raster[:: -(-rows // _MAX_SAMPLES), :: -(-cols // _MAX_SAMPLES)].ravel()
    some = some[np.abs(some) < _MAX_HEIGHT_M]
    if some.size == 0:
        some = raster[np.abs(raster) < _MAX_HEIGHT_M]
    if some.size == 0:
        return 0.0
    at = (some.size - 1) // 2
    return float(np.partition(some, at)[at])
