"""Measured digital terrain models: GeoTIFF and PDS images, read by rasterio."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning, RasterioIOError
from rasterio.transform import array_bounds
from rasterio.warp import Resampling, calculate_default_transform, reproject
from rasterio.warp import transform as warp
from rasterio.windows import Window

from lunarsim.errors import InputError
from lunarsim.grid import Grid, bytes_in_words
from lunarsim.world.terrain.heightfield import Heightfield

# Float rasters from PDS mark missing posts by huge negative numbers, not always declared.
_MISSING_BELOW = -1e30
# No ground is farther from the middle of a body than this, m: the Moon's centre to its surface is
# 1.7e6 m, and files that count heights from there are used as they are.
_FARTHEST = 1e7
# Ground within one file differs by less, m.
_MOST_RELIEF = 1e5
# Elevations read at once: 1.6 GB.
_MOST_READ = 400_000_000
# Grid north may be off true north by as much before a raster is turned, rad.
_LEAST_CONVERGENCE = np.deg2rad(0.1)


@dataclass(frozen=True)
class DtmInfo:
    """What a raster file says of itself, before its elevations are used.

    Attributes
    ----------
    path, driver, rows, cols
        The file and its raster.
    posting
        Distance between posts, m, or None where the file names no metric frame.
    frame
        Coordinate reference in words.
    no_data_share
        Share of posts without an elevation.
    z_range
        Least and greatest elevation, m.
    """

    path: Path
    driver: str
    rows: int
    cols: int
    posting: float | None
    frame: str
    no_data_share: float
    z_range: tuple[float, float]


def _open(path: Path) -> rasterio.io.DatasetReader:
    if not path.is_file():
        raise InputError("terrain.path", str(path), "an existing GeoTIFF or PDS .IMG file")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            source = rasterio.open(path)
        except RasterioIOError as error:
            raise InputError(
                "terrain.path", str(path), f"a raster that GDAL can read ({error})"
            ) from error
    if source.count != 1:
        count = source.count
        source.close()
        raise InputError(
            "terrain.path", str(path),
            f"a raster of one band, the elevations: this one has {count} "
            "(`gdal_translate -b N` takes band N out)",
        )  # fmt: skip
    return source


def _metric_posting(source: rasterio.io.DatasetReader) -> tuple[float | None, str]:
    """Return the posting in metres (None without a metric frame) and the frame in words."""
    transform = source.transform
    if transform.is_identity:
        return None, "none"
    if source.crs is None:
        return None, "a transform without a coordinate reference"
    if not source.crs.is_projected:
        return None, f"geographic, degrees ({source.crs.to_string()[:60]})"
    factor = float(source.crs.linear_units_factor[1])
    dx, dy = abs(transform.a) * factor, abs(transform.e) * factor
    if transform.b != 0.0 or transform.d != 0.0 or abs(dx - dy) > 1e-6 * dx:
        return None, "rotated or with unequal postings"
    name = source.crs.to_wkt().split('"')[1] if '"' in source.crs.to_wkt() else "projected"
    return dx, name


def _elevations(
    source: rasterio.io.DatasetReader, part: Window | None = None
) -> NDArray[np.float32]:
    """Return the elevations of a window, NaN where there are none.

    Raises
    ------
    InputError
        If there are too many, they cannot be read, or they are none of a ground.
    """
    rows, cols = (source.height, source.width) if part is None else (part.height, part.width)
    _check_count("terrain.path", source.name, rows, cols, "give terrain.dtm_window")
    try:
        z: NDArray[np.float32] = (
            source.read(1, masked=True, window=part).astype(np.float32).filled(np.nan)
        )
    except RasterioIOError as error:
        raise InputError(
            "terrain.path",
            source.name,
            f"a whole raster: its elevations end early ({error.__cause__ or error})",
        ) from None
    z[~np.isfinite(z) | (z < _MISSING_BELOW)] = np.nan
    _check_heights(source.name, z)
    return z


def _check_count(field: str, value: object, rows: int, cols: int, remedy: str) -> None:
    """Refuse more posts than memory is asked for."""
    if rows * cols > _MOST_READ:
        raise InputError(
            field, value,
            f"at most {_MOST_READ} posts: {rows} x {cols} of 4 bytes are "
            f"{bytes_in_words(4.0 * rows * cols)}; {remedy}",
        )  # fmt: skip


def _check_heights(path: str, z: NDArray[np.float32]) -> None:
    """Refuse heights that no ground has."""
    known = z[np.isfinite(z)]
    if not known.size:
        return
    low, high = float(known.min()), float(known.max())
    if max(-low, high) > _FARTHEST or high - low > _MOST_RELIEF:
        raise InputError(
            "terrain.path", path,
            f"elevations in metres, within {_MOST_RELIEF:g} m of each other: these reach from "
            f"{low:.6g} to {high:.6g} m; posts without one are marked by the file's no-data value",
        )  # fmt: skip


def read_info(path: str | Path) -> DtmInfo:
    """Return what a raster says of itself.

    Raises
    ------
    InputError
        If the file is missing, no raster of one band, cut short, or holds what no ground has.
    """
    with _open(Path(path)) as source:
        posting, frame = _metric_posting(source)
        z = _elevations(source)
        known = np.isfinite(z)
        low, high = (float(z[known].min()), float(z[known].max())) if known.any() else (np.nan,) * 2
        return DtmInfo(
            Path(path),
            source.driver,
            source.height,
            source.width,
            posting,
            frame,
            1.0 - float(known.mean()),
            (low, high),
        )


def load_dtm(
    path: str | Path,
    *,
    posting: float | None = None,
    window: tuple[int, int, int, int] | None = None,
) -> Heightfield:
    """Load a measured terrain into a local ENU frame.

    The frame's origin is the centre of the raster, or of the window, at its mean elevation; rows
    are flipped so that row 0 is the southernmost. A raster in degrees, turned, or in a projection
    whose grid north at the centre is more than 0.1 deg off true north (as polar ones are), is
    resampled by cubic convolution into an azimuthal equidistant frame about its centre, north up.

    Parameters
    ----------
    path
        A GeoTIFF, a PDS .IMG, or any single-band raster that GDAL reads.
    posting
        Distance between posts (m). Needed for a file without a coordinate reference; wanted
        posting of a resampled one (left out: about that of the file); must be left out otherwise.
    window
        First and last row (from the top) and first and last column, the last not included; left
        out: everything.

    Raises
    ------
    InputError
        If the file is missing, is no whole raster of one band, holds what no ground has, has no
        metric frame and no `posting` is given, holds
        no elevation at all, or the window lies outside.
    """
    path = Path(path)
    with _open(path) as source:
        found, frame = _metric_posting(source)
        part = _window(window, source.height, source.width)
        plain = source.crs is None or source.transform.is_identity
        if plain or (found is not None and abs(_convergence(source, part)) < _LEAST_CONVERGENCE):
            step = _step(path, found, posting, frame)
            z = _elevations(source, part)
        else:
            z, step = _north_up(source, part, posting)
    z = z[::-1]
    if not np.isfinite(z).any():
        raise InputError("terrain.path", str(path), "a raster with at least one elevation")
    if min(z.shape) < 2:
        raise InputError("terrain.path", str(path), f"at least 2 x 2 posts, not {z.shape}")
    rows, cols = z.shape
    grid = Grid(-0.5 * (cols - 1) * step, -0.5 * (rows - 1) * step, step, rows, cols)
    centred = z - np.float32(np.nanmean(z.astype(np.float64)))
    return Heightfield(grid, np.ascontiguousarray(centred, dtype=np.float32))


def _body(crs: CRS) -> dict[str, Any]:
    """Return the body's size, under whichever names a coordinate reference gives it."""
    shape = crs.to_dict()
    return {k: shape[k] for k in ("R", "a", "b", "rf", "ellps", "datum") if k in shape}


def _convergence(source: rasterio.io.DatasetReader, part: Window) -> float:
    """Return the angle (rad) from grid north to true north at the middle of a window."""
    x, y = source.window_transform(part) @ (0.5 * part.width, 0.5 * part.height)
    globe = CRS.from_dict({"proj": "longlat"} | _body(source.crs))
    (lon,), (lat,) = warp(source.crs, globe, [x], [y])
    ends = [lat - 1e-4, lat + 1e-4]
    easts, norths = warp(globe, source.crs, [lon, lon], ends)
    return float(np.arctan2(easts[1] - easts[0], norths[1] - norths[0]))


def _step(path: Path, found: float | None, posting: float | None, frame: str) -> float:
    """Return the posting of a raster that is read as it is."""
    if found is None and posting is None:
        raise InputError(
            "terrain.path",
            str(path),
            f"a raster in a north-up metric frame (its frame: {frame}); "
            "give terrain.dtm_posting_m if you know the distance between its posts",
        )
    if found is not None and posting is not None and abs(found - posting) > 1e-3 * found:
        raise InputError("terrain.dtm_posting_m", posting, f"left out: the file says {found:.4g} m")
    step = found if found is not None else posting
    assert step is not None
    return step


def _window(window: tuple[int, int, int, int] | None, rows: int, cols: int) -> Window:
    if window is None:
        return Window(0, 0, cols, rows)
    top, bottom, left, right = window
    if not (0 <= top < bottom <= rows and 0 <= left < right <= cols):
        raise InputError(
            "terrain.dtm_window", tuple(window),
            f"rising rows within 0 to {rows} and rising columns within 0 to {cols}",
        )  # fmt: skip
    return Window(left, top, right - left, bottom - top)


def _north_up(
    source: rasterio.io.DatasetReader, part: Window, posting: float | None
) -> tuple[NDArray[np.float32], float]:
    """Return the elevations of a window resampled to a metric north-up grid, and its posting."""
    transform = source.window_transform(part)
    z = _elevations(source, part)
    rows, cols = z.shape
    x, y = transform @ (0.5 * cols, 0.5 * rows)
    body = _body(source.crs)
    globe = CRS.from_dict({"proj": "longlat"} | body)
    (lon,), (lat,) = warp(source.crs, globe, [x], [y])
    target = CRS.from_dict({"proj": "aeqd", "lat_0": lat, "lon_0": lon, "units": "m"} | body)
    bounds = array_bounds(rows, cols, transform)
    placed, wide, high = calculate_default_transform(
        source.crs, target, cols, rows, *bounds,
        **({} if posting is None else {"resolution": posting}),
    )  # fmt: skip
    _check_count("terrain.dtm_posting_m", posting, high, wide, "a coarser posting takes less")
    out = np.full((high, wide), np.nan, np.float32)
    reproject(
        z, out, src_transform=transform, src_crs=source.crs, src_nodata=np.nan,
        dst_transform=placed, dst_crs=target, dst_nodata=np.nan, resampling=Resampling.cubic,
    )  # fmt: skip
    return out, float(placed.a) * float(target.linear_units_factor[1])
