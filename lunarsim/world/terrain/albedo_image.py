"""Load the relative albedo of measured terrain from an image or albedo map."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.io import DatasetReader
from rasterio.windows import Window
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.typing import Array
from lunarsim.world.terrain.albedo_map import AlbedoMap
from lunarsim.world.terrain.raster_file import open_raster
from lunarsim.world.terrain.raster_frame import Frame, frame_of_window, is_placed
from lunarsim.world.terrain.raster_heights import HeightScale, RasterHeights

# Number of cells of a map along its longer side. A finer image is averaged, a coarser one
# interpolated.
_MIN_CELLS, _MAX_CELLS = 64, 4096
# Minimum relative albedo: an image's shadows must not become surfaces that reflect no light.
_MIN_ALBEDO = 0.02
# Points per side at which map coordinates are computed; a spline interpolates between them.
_NODES = 33
# Minimum share of the terrain that an image must cover.
_MIN_COVERED = 0.01

Bounds = tuple[float, float, float, float]


class Placement(NamedTuple):
    """Frame of measured terrain, and where the terrain lies in it.

    Attributes
    ----------
    frame, crs
        Frame of the elevation raster, and its coordinate reference system; None without one.
    measured, complete
        West, east, south and north edge, m, of the raster's terrain, and of the terrain that
        mirroring at its edges makes from it.
    """

    frame: Frame
    crs: CRS | None
    measured: Bounds
    complete: Bounds


def load_albedo_map(path: Path, posting: float | None, terrain: Placement) -> AlbedoMap:
    """Load the image of a terrain as relative albedo.

    Parameters
    ----------
    path
        Raster with one band: an orthoimage or an albedo map.
    posting
        Pixel size, m, of an image without georeferencing: it lies north up, with its centre at
        the centre of the terrain. Omitted: the image is placed by its coordinate reference system.
    terrain
        Terrain under the image. Where the terrain is mirrored, so is the image.

    Raises
    ------
    InputError
        If the image is refused, cannot be placed, has no positive mean or covers less than 1 % of
        the terrain.
    """
    try:
        with open_raster(path) as image:
            origin = _origin(image, posting, terrain)
            full = Window(0, 0, image.width, image.height)
            frame = frame_of_window(image, full, posting, origin)
            grid = _grid(terrain.complete, frame.mean_posting)
            x = _folded(grid.x, *terrain.measured[:2])
            y = _folded(grid.y, *terrain.measured[2:])
            values = _sampled(image, frame, x, y, grid.posting)
    except InputError as error:
        if error.field != "terrain.path":
            raise
        raise InputError(
            "terrain.albedo_path", str(path), error.problem, error.remedy, error.show_value
        ) from None
    return AlbedoMap(grid, _relative(path, values))


def _origin(
    image: DatasetReader, posting: float | None, terrain: Placement
) -> tuple[float, float] | None:
    """Return the origin of the terrain's frame, for an image that is placed by it.

    None: the centre of the image lies at the origin.

    InputError unless exactly one of georeferencing and `posting` (m) places it.
    """
    has_both = is_placed(image) and terrain.crs is not None
    if (posting is None) != has_both:
        problem = "must be omitted, because image and terrain have georeferencing"
        if not has_both:
            problem = "is required, because the image or the terrain has no georeferencing"
        raise InputError("terrain.albedo_posting_m", posting, problem, show_value=False)
    if posting is not None:
        return None
    if image.crs != terrain.crs and not (_is_on_body(image.crs) and _is_on_body(terrain.crs)):
        raise InputError(
            "terrain.path", image.name, "must have the local coordinate reference of the terrain"
        )
    return terrain.frame.origin


def _is_on_body(crs: Any) -> bool:
    """Return whether a reference system has longitudes or is a projection."""
    return bool(crs.is_geographic or crs.is_projected)


def _grid(bounds: Bounds, pixel: float) -> Grid:
    """Return a grid over bounds with cells of about a pixel's size (m)."""
    west, east, south, north = bounds
    side = max(east - west, north - south)
    posting = float(np.clip(pixel, side / (_MAX_CELLS - 2), side / _MIN_CELLS))
    rows, cols = (int(np.ceil(side / posting)) + 1 for side in (north - south, east - west))
    return Grid(west, south, posting, rows, cols)


def _folded(x: Array, low: float, high: float) -> Array:
    """Mirror coordinates (n,) into the interval from `low` to `high`, at its ends."""
    width = high - low
    off = (x - low) % (2.0 * width)
    return low + np.minimum(off, 2.0 * width - off)


def _sampled(image: DatasetReader, frame: Frame, x: Array, y: Array, posting: float) -> Array:
    """Return an image at points east (cols,) and north (rows,), m; NaN: no data.

    Pixels are averaged over squares of about `posting` (m).
    """
    ends = [np.linspace(v.min(), v.max(), _NODES) for v in (y, x)]
    nodes = frame.pixels(*reversed(np.meshgrid(*ends, indexing="ij")))
    (cols, at_cols), (rows, at_rows) = (np.unique(v, return_inverse=True) for v in (x, y))
    col, row = (RectBivariateSpline(*ends, node)(rows, cols) for node in nodes)
    left, top = (max(int(v.min()) - 1, 0) for v in (col, row))
    right, bottom = min(int(col.max()) + 2, image.width), min(int(row.max()) + 2, image.height)
    if left >= right or top >= bottom:
        return np.full((len(y), len(x)), np.nan)
    factor = max(1, round(posting / frame.mean_posting))
    total, known = _averaged(image, Window(left, top, right - left, bottom - top), factor)
    at = [(row - top) / factor - 0.5, (col - left) / factor - 0.5]
    value, weight = (map_coordinates(v, at, order=1, mode="grid-constant") for v in (total, known))
    with np.errstate(invalid="ignore"):
        found = np.where(weight > 0.0, value / weight, np.nan)
    return np.asarray(found[np.ix_(at_rows, at_cols)])


def _averaged(image: DatasetReader, window: Window, factor: int) -> tuple[Array, Array]:
    """Return sums of known values over squares of pixels, and their numbers."""
    shape = [-(-int(side) // factor) for side in (window.height, window.width)]
    total, known = np.zeros(shape), np.zeros(shape)
    columns = np.arange(shape[1]) * factor
    for top, block in RasterHeights(image, HeightScale.of(image, "m"), None).blocks(window):
        rows = (top + np.arange(len(block))) // factor
        np.add.at(total, rows, np.add.reduceat(np.nan_to_num(block), columns, axis=1))
        np.add.at(known, rows, np.add.reduceat(np.isfinite(block) * 1.0, columns, axis=1))
    return total, known


def _relative(path: Path, values: Array) -> NDArray[np.float32]:
    """Return values (rows, cols) over their mean; 1 where they are unknown."""
    known = np.isfinite(values)
    if known.mean() < _MIN_COVERED:
        raise InputError(
            "terrain.albedo_path", str(path),
            f"must cover at least 1 % of the terrain, but covers {100.0 * known.mean():.2g} %",
            "Choose another part of the raster with terrain.dtm_window, or another image.",
        )  # fmt: skip
    mean = float(values[known].mean())
    if mean <= 0.0:
        raise InputError("terrain.albedo_path", str(path), f"must have a positive mean, not {mean}")
    relative = np.where(known, values / mean, 1.0)
    return np.maximum(relative, _MIN_ALBEDO).astype(np.float32)
