"""Cut a landing area out of a terrain product, and fill its small voids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.fill import fillnodata
from rasterio.io import DatasetReader
from rasterio.windows import Window
from scipy import ndimage

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError
from lunarsim.grid import check_raster_size
from lunarsim.typing import Array
from lunarsim.world.terrain.dtm import SPLINE_MARGIN, interpolated, window_around
from lunarsim.world.terrain.raster_file import open_raster
from lunarsim.world.terrain.raster_frame import (
    Frame,
    body_of,
    frame_of_window,
    is_complete_turn,
    is_placed,
)
from lunarsim.world.terrain.raster_heights import HeightScale, RasterHeights

_MIN_POSTS, _MAX_POSTS = 8, 8_000
# Single precision has an error of 0.5 mm at this height, m. Larger ones are written with an offset.
_MAX_EXACT_HEIGHT_M = 8e3
# Lags, in posts, over which the roughness is measured, and limits of the Hurst exponent.
_LAGS, _HURST_RANGE = (1, 2, 4, 8), (0.5, 0.98)
# Largest number of heights from which the quantization step is found.
_MAX_SAMPLE = 500_000


@dataclass(frozen=True)
class LandingArea:
    """Square of terrain around a place, in an azimuthal equidistant frame about it.

    Attributes
    ----------
    heights
        Elevations (n, n), m, as in the source, row 0 south; NaN for no data.
    posting
        Grid spacing, m.
    latitude, longitude
        Planetocentric coordinates of the centre, deg; None for a source without georeferencing.
    body
        Radius (R), or semi-major axis (a) and inverse flattening (rf) of the body, as PROJ
        parameters; empty without georeferencing.
    source, source_posting, reference
        Format and grid spacing (m) of the source at the centre, and its coordinate reference.
    step
        Quantization step of the source's heights, m; None if there is none.
    filled, largest_void, missing
        Number of posts of the source that were filled, size of the largest void of the source,
        posts, and share of the heights that are still missing.
    hurst, rms_slope
        Hurst exponent and RMS slope at 1 m (rad) that continue the roughness of the area.
    """

    heights: Array
    posting: float
    latitude: float | None
    longitude: float | None
    body: dict[str, Any]
    source: str
    source_posting: float
    reference: str
    step: float | None
    filled: int
    largest_void: int
    missing: float
    hurst: float
    rms_slope: float

    def write(self, path: Path) -> None:
        """Write the heights as GeoTIFF (single precision, row 0 north) atomically."""
        n = len(self.heights)
        half = 0.5 * n * self.posting
        crs = None
        if self.latitude is not None:
            crs = rasterio.crs.CRS.from_dict(
                {"proj": "aeqd", "lat_0": self.latitude, "lon_0": self.longitude, "units": "m"}
                | self.body
            )
        known = self.heights[np.isfinite(self.heights)]
        offset = float(np.rint(known.mean())) if np.abs(known).max() > _MAX_EXACT_HEIGHT_M else 0.0
        profile = {
            "driver": "GTiff", "width": n, "height": n, "count": 1, "dtype": "float32", "crs": crs,
            "transform": Affine(self.posting, 0.0, -half, 0.0, -self.posting, half),
            "nodata": np.nan, "compress": "deflate", "predictor": 3, "tiled": n >= 256,
        }  # fmt: skip

        def write(part: Path) -> None:
            with rasterio.open(part, "w", **profile) as file:
                file.write((self.heights[::-1] - offset).astype(np.float32), 1)
                file.offsets = [offset]
                file.units = ["m"]

        atomic_write(path, write)


def import_area(
    path: Path,
    place: tuple[float, float] | None,
    size: float,
    *,
    posting: float | None = None,
    max_void: int = 100,
    unit: str | None = None,
    nodata: Sequence[float] | None = None,
) -> LandingArea:
    """Cut a square out of an elevation raster, and reproject it.

    Only the part around the square is read.

    Parameters
    ----------
    path
        Elevation raster, as for `load_terrain`.
    place
        Planetocentric latitude and longitude of the centre, deg, positive north and east; None:
        the centre of the raster.
    size
        Side of the square, m.
    posting
        Grid spacing, m; omitted: that of the source at the centre. Required for a source without
        georeferencing, whose spacing it is.
    max_void
        Largest number of connected posts without a height that are filled, by GDAL's weighted
        distances.
    unit, nodata
        Unit of the heights, and values that mean "no height", as for `load_terrain`.

    Raises
    ------
    InputError
        If the source is refused, the square leaves it, or a size does not fit.
    """
    if place is not None and not (abs(place[0]) <= 90.0 and -180.0 <= place[1] <= 360.0):
        raise InputError("--at", place, "must be a latitude up to 90 and a longitude up to 360 deg")
    with open_raster(path) as source:
        full = Window(0, 0, source.width, source.height)
        if place is not None and not is_placed(source):
            raise InputError(
                "--at", place, "must be omitted, because the raster has no georeferencing"
            )
        given = None if is_placed(source) else posting
        frame = frame_of_window(source, full, given, place)
        step = posting or frame.mean_posting
        check_raster_size("--size", size, step, _MAX_POSTS, "posts")
        n = round(size / step) + 1
        if n < _MIN_POSTS:
            raise InputError(
                "--size", size, f"must be at least {_MIN_POSTS * step:g} m, 8 postings"
            )
        axis = np.asarray((np.arange(n) - 0.5 * (n - 1)) * step, dtype=np.float64)
        part = _window(source, frame, axis)
        scale = HeightScale.of(source, unit)
        raw = _read(source, part, RasterHeights(source, scale, nodata))
        z, filled, largest = _filled(raw, max_void)
        moved = replace(
            frame, cols=int(part.width), rows=int(part.height),
            pixel_to_map=frame.pixel_to_map @ Affine.translation(part.col_off, part.row_off),
        )  # fmt: skip
        heights = interpolated(moved, z, axis, axis)
        on_body = is_placed(source) and (source.crs.is_geographic or source.crs.is_projected)
        body = body_of(source.crs) if on_body else {}
        driver, source_posting = source.driver, frame.mean_posting
        latitude, longitude = frame.origin if on_body else (None, None)
        integers = np.dtype(source.dtypes[0]).kind in "iu"
        quantum = abs(scale.scale * scale.metres) if integers else quantization_step(raw)
    if not np.isfinite(heights).any():
        raise InputError("terrain.path", str(path), "must have heights in the square")
    hurst, slope = _roughness(heights, step, quantum or 0.0)
    return LandingArea(
        heights, step, latitude, longitude, body, driver, source_posting, frame.description,
        quantum, filled, largest, float(np.mean(~np.isfinite(heights))), hurst, slope,
    )  # fmt: skip


def _window(source: DatasetReader, frame: Frame, axis: Array) -> Window:
    """Return the window around a square with coordinates `axis` (n,), m.

    A map of the complete body continues beyond its edges: the window may then begin before its
    first column, or end after its last. InputError if the square leaves the raster.
    """
    edge = np.concatenate([axis, axis, np.full(axis.size, axis[0]), np.full(axis.size, axis[-1])])
    other = np.concatenate([np.full(axis.size, axis[0]), np.full(axis.size, axis[-1]), axis, axis])
    col, row = frame.pixels(edge, other)
    rows_fit = np.all((row >= 0.5 - 1e-6) & (row <= source.height - 0.5 + 1e-6))
    turns = is_complete_turn(source)
    cols_fit = turns or np.all((col >= 0.5 - 1e-6) & (col <= source.width - 0.5 + 1e-6))
    if not (np.isfinite(col).all() and np.isfinite(row).all() and rows_fit and cols_fit):
        wide, high = frame_of_window(
            source, Window(0, 0, source.width, source.height), frame.nominal_posting
        ).extent()  # fmt: skip
        raise InputError(
            "--size", float(axis[-1] - axis[0]),
            f"must lie inside the raster, which covers {wide:.5g} x {high:.5g} m around its centre",
            "Choose a smaller square, or another centre with --at.",
        )  # fmt: skip
    top, bottom, left, right = window_around(
        frame, float(axis[-1]), SPLINE_MARGIN, beyond_columns=turns
    )
    return Window(left, top, right - left, bottom - top)


def _read(source: DatasetReader, part: Window, heights: RasterHeights) -> Array:
    """Return the heights of a window that may extend beyond the first or last column."""
    first, last = int(part.col_off), int(part.col_off + part.width)
    width, parts = source.width, []
    for turn in (-1, 0, 1):
        low, high = max(first, turn * width), min(last, (turn + 1) * width)
        if low < high:
            parts.append(
                heights.read(Window(low - turn * width, part.row_off, high - low, part.height))
            )
    return np.hstack(parts)


def _filled(z: Array, max_void: int) -> tuple[Array, int, int]:
    """Fill voids of up to `max_void` connected posts.

    Returns the heights, the number of filled posts and that of the largest void.
    """
    label, count = ndimage.label(~np.isfinite(z), np.ones((3, 3)))
    if count == 0:
        return z, 0, 0
    size = np.bincount(label.ravel())
    size[0] = 0
    small = (label > 0) & (size[label] <= max_void)
    if not small.any():
        return z, 0, int(size.max())
    offset = float(np.nanmean(z))  # single precision
    known = np.isfinite(z)
    found = fillnodata(
        np.where(known, z - offset, 0.0).astype(np.float32), known.astype(np.uint8),
        max_search_distance=float(max_void) + 2.0,
    )  # fmt: skip
    out = np.where(small, found.astype(np.float64) + offset, z)
    return out, int(small.sum()), int(size.max())


def quantization_step(z: NDArray[np.floating[Any]]) -> float | None:
    """Return the step of which heights are multiples, up to a constant, m.

    None without one, and for fewer than ten different heights.
    """
    values = z[np.isfinite(z)].ravel()
    values = values[:: max(1, values.size // _MAX_SAMPLE)]
    differences = np.diff(np.unique(values))
    tolerance = 4.0 * np.spacing(np.float32(np.abs(values).max(initial=1.0)))
    differences = differences[differences > tolerance]
    if differences.size < 10:
        return None
    step = float(differences.min())
    if step < 20.0 * tolerance:
        return None
    ratio = differences / step
    return step if np.all(np.abs(ratio - np.rint(ratio)) < 0.05) else None


def _roughness(z: Array, posting: float, quantum: float) -> tuple[float, float]:
    """Return Hurst exponent and RMS slope at 1 m (rad) of heights (n, n), m.

    The RMS slope over a baseline L is proportional to L^(H - 1). The variance of the rounding to
    multiples of `quantum` (m) is subtracted.
    """
    lags = [lag for lag in _LAGS if lag < len(z)]
    slopes = []
    for lag in lags:
        rises = np.concatenate([(z[lag:] - z[:-lag]).ravel(), (z[:, lag:] - z[:, :-lag]).ravel()])
        rises = rises[np.isfinite(rises)]
        tangent = rises / (lag * posting)
        rounding = quantum**2 / 6.0 / (lag * posting) ** 2
        slopes.append(np.sqrt(max(np.var(tangent) - rounding, 0.0)) if rises.size else 0.0)
    if min(slopes) <= 0.0:
        return _HURST_RANGE[1], 0.0
    slope = np.polyfit(np.log(np.multiply(lags, posting)), np.log(slopes), 1)[0]
    hurst = float(np.clip(1.0 + slope, *_HURST_RANGE))
    # Slopes along two directions.
    return hurst, float(np.arctan(np.sqrt(2.0) * slopes[0] * posting ** (1.0 - hurst)))
