"""Load digital terrain models into a local east, north, up frame.

The formats and rules are described in docs/howto/terrain-files.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rasterio.crs import CRS
from rasterio.io import DatasetReader
from rasterio.windows import Window

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.typing import Array
from lunarsim.world.terrain.heightfield import Heightfield
from lunarsim.world.terrain.raster_file import open_raster
from lunarsim.world.terrain.raster_frame import Frame, frame_of_window, is_placed
from lunarsim.world.terrain.raster_heights import (
    HeightScale,
    HeightStatistics,
    RasterHeights,
    check_count,
)
from lunarsim.world.terrain.spline import GappySpline

# Rows of a resampled terrain that are computed at a time.
_ROWS_PER_BLOCK = 256
# Posts by which a raster is extended before spline interpolation. The spline assumes zero slope at
# its edges; the resulting error falls to a quarter from post to post.
SPLINE_MARGIN = 12
# Larger rasters are described without reading their heights.
_MAX_POSTS_DESCRIBED = 20_000_000


@dataclass(frozen=True)
class DtmInfo:
    """Description of an elevation raster file.

    Attributes
    ----------
    path, driver, rows, cols
        The file, GDAL's name of its format, and the numbers of rows and columns.
    posting
        Grid spacing of the loaded terrain, m; None without georeferencing.
    frame
        Coordinate reference system in words.
    orientation
        Order of rows and columns in words.
    spacing
        True distance between grid points along a row and along a column, m; None without
        georeferencing.
    extent
        Sides of the terrain along east and north, m; None without georeferencing.
    column_direction_deg
        Direction in which column numbers increase, degrees anticlockwise from east at the centre.
    map_scale
        Map distance over true distance, along a row and along a column; None in degrees and
        without georeferencing.
    resampled
        Whether loading interpolates the heights; otherwise they are used unchanged.
    height_scale
        Scale, offset and unit of the heights.
    statistics
        Counts and extreme heights; None if the heights were not read.
    """

    path: Path
    driver: str
    rows: int
    cols: int
    posting: float | None
    frame: str
    orientation: str
    spacing: tuple[float, float] | None
    extent: tuple[float, float] | None
    column_direction_deg: float
    map_scale: tuple[float, float] | None
    resampled: bool
    height_scale: HeightScale
    statistics: HeightStatistics | None

    @property
    def no_data_share(self) -> float:
        """Fraction of grid points without an elevation; NaN if heights were not read."""
        found = self.statistics
        return 1.0 - found.known / found.posts if found else np.nan

    @property
    def z_range(self) -> tuple[float, float]:
        """Minimum and maximum elevation, m; NaN if the heights were not read."""
        return self.statistics.z_range if self.statistics else (np.nan, np.nan)


def read_info(
    path: str | Path,
    *,
    window: tuple[int, int, int, int] | None = None,
    unit: str | None = None,
    nodata: float | Sequence[float] | None = None,
) -> DtmInfo:
    """Describe an elevation raster, or a window of it, without loading it into memory.

    Heights are read for statistics only if a window is given or the raster has at most 20 million
    points. `window` is first and last row, first and last column (the last not included); `unit`
    replaces the file's unit of height; `nodata` are values that mean "no height".

    Raises
    ------
    InputError
        If the file is missing, is refused, or does not contain plausible heights.
    """
    path = Path(path)
    with open_raster(path) as source:
        part = _window(window, source)
        heights = RasterHeights(source, HeightScale.of(source, unit), _values(nodata))
        placed = is_placed(source)
        frame = frame_of_window(source, part, None if placed else 1.0)
        square, steps = frame.square_posting(), np.hypot(*frame.steps)
        (east, _), (north, _) = frame.steps
        spacing = (float(steps[0]), float(steps[1]))
        map_scale = None
        if placed and frame.metres_per_map_unit is not None:
            t = frame.pixel_to_map
            stated = np.hypot([t.a, t.b], [t.d, t.e]) * frame.metres_per_map_unit
            map_scale = (float(stated[0] / steps[0]), float(stated[1] / steps[1]))
        few = part.width * part.height <= _MAX_POSTS_DESCRIBED
        return DtmInfo(
            path,
            source.driver,
            int(part.height),
            int(part.width),
            (square or frame.mean_posting) if placed else None,
            frame.description,
            str(frame.orientation()),
            spacing if placed else None,
            frame.extent() if placed else None,
            float(np.degrees(np.arctan2(north, east))),
            map_scale,
            square is None,
            heights.scale,
            heights.extremes(part) if few or window is not None else None,
        )


class DtmSize(NamedTuple):
    """Number of grid points to read from a raster, and sides of the terrain, m."""

    posts: int
    width: float
    height: float


def read_size(
    path: str | Path,
    *,
    posting: float | None = None,
    window: tuple[int, int, int, int] | None = None,
) -> DtmSize:
    """Read the size of an elevation raster from the header of its file.

    `posting` is the grid spacing of a file without georeferencing, m; `window` is first and last
    row, first and last column (the last not included).

    Raises
    ------
    InputError
        If the file is missing, or its header is refused.
    """
    with open_raster(Path(path)) as source:
        part = _window(window, source)
        width, height = frame_of_window(source, part, posting).extent()
        return DtmSize(int(part.width) * int(part.height), width, height)


def load_terrain(
    path: str | Path,
    *,
    posting: float | None = None,
    window: tuple[int, int, int, int] | None = None,
    unit: str | None = None,
    nodata: float | Sequence[float] | None = None,
) -> Heightfield:
    r"""Load an elevation raster into a local east, north, up frame in true metres.

    The origin is the centre of the raster, or of the window, at its mean elevation. Heights on a
    square grid along east and north keep their values, in any order of rows and columns. All
    other rasters (degrees, rotated or sheared rasters, projections with another scale or another
    north) are interpolated by cubic spline in an azimuthal equidistant frame.

    Parameters
    ----------
    path
        Raster with one band, or its label: GeoTIFF, PDS3, PDS4, ISIS3, ENVI, ASCII grid, netCDF.
    posting
        Grid spacing, m. Required for a file without a coordinate reference system; otherwise the
        spacing of an interpolated raster (omitted: the mean spacing of the file).
    window
        First and last row (in the order of the file) and first and last column, the last not
        included; omitted: the complete raster.
    unit
        Unit of the heights, which replaces the file's: "m", "km", "ft", "us-ft".
    nodata
        Value or values that mean "no height", in addition to those stated by the file; omitted: a
        value that resembles such a marker is refused.

    Returns
    -------
    Heightfield
        Elevations above their mean, m; NaN where missing.

    Raises
    ------
    InputError
        If the file is missing, is refused or has no heights, if it has no coordinate reference
        system and no `posting` is given, or if the window lies outside.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> text = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 2\n1 2 3\n4 5 6\n"
    >>> with TemporaryDirectory() as folder:
    ...     count = (Path(folder) / "site.asc").write_text(text)
    ...     terrain = load_terrain(Path(folder) / "site.asc", posting=2.0)
    >>> terrain.z.tolist(), terrain.bounds  # row 0 of z is the southernmost row
    ([[0.5, 1.5, 2.5], [-2.5, -1.5, -0.5]], (-2.0, 2.0, -1.0, 1.0))
    """
    with open_raster(Path(path)) as source:
        z, step = _square_grid_heights(source, posting, window, unit, nodata)
    rows, cols = z.shape
    grid = Grid(-0.5 * (cols - 1) * step, -0.5 * (rows - 1) * step, step, rows, cols)
    # Heights may be radii of the body: subtract the mean before rounding to single precision.
    mean = float(np.float32(np.nanmean(z)))
    return Heightfield(grid, (z - mean).astype(np.float32))


def mean_elevation(
    path: Path,
    *,
    posting: float | None = None,
    window: tuple[int, int, int, int] | None = None,
    unit: str | None = None,
    nodata: float | Sequence[float] | None = None,
) -> float:
    """Return the mean height in the file, m, which `load_terrain` subtracts.

    The parameters and errors are those of `load_terrain`.
    """
    with open_raster(path) as source:
        return float(np.nanmean(_square_grid_heights(source, posting, window, unit, nodata)[0]))


def read_frame(
    path: Path, *, posting: float | None = None, window: tuple[int, int, int, int] | None = None
) -> tuple[Frame, CRS | None]:
    """Return the frame of an elevation raster and its coordinate reference system.

    The parameters are those of `load_terrain`. The reference system is None without georeferencing.
    """
    with open_raster(path) as source:
        frame = frame_of_window(source, _window(window, source), posting)
        return frame, source.crs if is_placed(source) else None


def load_surroundings(
    path: str | Path, latitude_deg: float, longitude_deg: float, *, max_range: float,
    posting: float | None = None, pixel: tuple[float, float] | None = None,
    nodata: Sequence[float] | None = None,
) -> Heightfield:  # fmt: skip
    """Load the terrain around a place into an azimuthal equidistant frame about it.

    Parameters
    ----------
    path
        Raster with one band, or its label, as for `load_terrain`.
    latitude_deg, longitude_deg
        Place that becomes the origin, deg, positive north and east.
    max_range
        Half the side of the terrain, m, if the raster is larger.
    posting
        Grid spacing, m. Required for a file without a coordinate reference system; otherwise the
        spacing of the result (omitted: the mean spacing of the file at the place).
    pixel
        Row and column of the place, counted from 0, in a file without georeferencing; None: its
        centre.
    nodata
        Values that mean "no height", as for `load_terrain`.

    Returns
    -------
    Heightfield
        Elevations above their mean, m; NaN outside the raster.

    Raises
    ------
    InputError
        If the file is missing, is refused or has no heights, or if the place lies outside.
    """
    with open_raster(Path(path)) as source:
        if not is_placed(source):
            return _shifted(
                source, load_terrain(path, posting=posting, nodata=nodata), posting, pixel
            )
        if pixel is not None:
            raise InputError(
                "pixel", list(pixel), "must be omitted, because the raster is georeferenced"
            )
        origin = latitude_deg, longitude_deg
        outside = _no_height(path, latitude_deg, longitude_deg)
        return _around_origin(source, origin, max_range, (posting, None, nodata), outside)


def _around_origin(
    source: DatasetReader, origin: tuple[float, float], max_range: float,
    options: tuple[float | None, str | None, float | Sequence[float] | None],
    outside: InputError,
) -> Heightfield:  # fmt: skip
    """Load the square around a point of a georeferenced raster into a frame about it.

    `origin` is the origin of the frame as for `frame_of_window`, and `max_range` half the side of
    the square, m. `options` are the grid spacing, m, the unit and the values that mean "no height".
    `outside` is raised if the raster has no height at the origin.
    """
    posting, unit, nodata = options
    complete = frame_of_window(source, _window(None, source), None, origin)
    col, row = (v[0] for v in complete.pixels(np.zeros(1), np.zeros(1)))
    if not (0.0 <= col <= complete.cols and 0.0 <= row <= complete.rows):
        raise outside
    part = _window(window_around(complete, max_range), source)
    frame = frame_of_window(source, part, None, origin)
    heights = RasterHeights(source, HeightScale.of(source, unit), _values(nodata))
    step = posting or frame.mean_posting
    z = _resampled(frame, heights.read(part), step, posting)
    rows, cols = z.shape
    if not np.isfinite(z[rows // 2, cols // 2]):
        raise outside
    grid = Grid(-0.5 * (cols - 1) * step, -0.5 * (rows - 1) * step, step, rows, cols)
    return Heightfield(grid, (z - np.nanmean(z)).astype(np.float32))


def load_around_map(
    path: Path,
    map_frame: tuple[Frame, CRS],
    max_range: float,
    *,
    posting: float | None = None,
    unit: str | None = None,
    nodata: float | Sequence[float] | None = None,
) -> Heightfield:
    """Load an elevation raster into the frame of another raster, the map.

    Parameters
    ----------
    path, posting, unit, nodata
        Raster, as for `load_terrain`.
    map_frame
        Local frame and coordinate reference system of the map.
    max_range
        Half the side of the square around the map's origin to load, m.

    Returns
    -------
    Heightfield
        Elevations above their mean, m; NaN outside the raster.

    Raises
    ------
    InputError
        If the file is refused or does not cover the map's origin, or if its coordinates have no
        relation to those of the map.
    """
    frame, crs = map_frame
    with open_raster(path) as source:
        both = source.crs, crs
        if source.crs != crs and not all(c.is_geographic or c.is_projected for c in both):
            raise InputError(
                "terrain.path", source.name, "must have the local coordinate reference of the map",
                "Give terrain.centre_m.",
            )  # fmt: skip
        outside = InputError(
            "terrain.path", source.name,
            "must cover the origin of the map by its coordinate reference",
            "Choose another raster, or give terrain.centre_m, for instance [0, 0].",
        )  # fmt: skip
        return _around_origin(source, frame.origin, max_range, (posting, unit, nodata), outside)


def _no_height(path: str | Path, latitude_deg: float, longitude_deg: float) -> InputError:
    return InputError(
        "terrain.path", str(path),
        f"must have a height at latitude {latitude_deg:g} and longitude {longitude_deg:g} deg",
    )  # fmt: skip


def _shifted(
    source: DatasetReader, field: Heightfield, posting: float | None,
    pixel: tuple[float, float] | None,
) -> Heightfield:  # fmt: skip
    """Return the terrain of a file without georeferencing with a pixel as its origin."""
    if pixel is None:
        return field
    row, col = pixel
    if not (0 <= row <= source.height - 1 and 0 <= col <= source.width - 1):
        raise InputError(
            "pixel", list(pixel),
            f"must be a row up to {source.height - 1} and a column up to {source.width - 1}",
        )  # fmt: skip
    frame = frame_of_window(source, _window(None, source), posting)
    east, north = (float(v) for v in frame.local(col + 0.5, row + 0.5))
    return Heightfield(
        replace(field.grid, x0=field.grid.x0 - east, y0=field.grid.y0 - north), field.z
    )


def window_around(
    frame: Frame, max_range: float, margin: int = 1, *, beyond_columns: bool = False
) -> tuple[int, int, int, int]:
    """Return the window of a raster within a range, m, of the origin of its frame.

    The window is first and last row, first and last column, with a margin in posts. If
    `beyond_columns`, it may begin before the first column and end after the last.
    """
    side = np.linspace(-max_range, max_range, 65)
    east, north = (v.ravel() for v in np.meshgrid(side, side))
    col, row = (v[np.isfinite(v)] for v in frame.pixels(east, north))
    more = np.array([-margin, margin + 1])
    left, right = (int(v) for v in np.floor([col.min(), col.max()]) + more)
    top, bottom = (int(v) for v in np.clip(np.floor([row.min(), row.max()]) + more, 0, frame.rows))
    if not beyond_columns:
        left, right = (int(v) for v in np.clip([left, right], 0, frame.cols))
    return top, bottom, left, right


def _square_grid_heights(
    source: DatasetReader,
    posting: float | None,
    window: tuple[int, int, int, int] | None,
    unit: str | None,
    nodata: float | Sequence[float] | None,
) -> tuple[Array, float]:
    """Return heights on a square grid, row 0 in the south, and its spacing, m.

    `window` is first and last row, first and last column; `unit` replaces the file's unit;
    `nodata` are values that mean "no height".
    """
    part = _window(window, source)
    if min(part.width, part.height) < 2:
        shape = f"{int(part.height)} x {int(part.width)}"
        raise InputError(
            "terrain.path", source.name, f"must have at least 2 x 2 points, but has {shape}"
        )
    frame = frame_of_window(source, part, posting)
    square = frame.square_posting()
    heights = RasterHeights(source, HeightScale.of(source, unit), _values(nodata))
    if square is not None and _fits(posting, square):
        z, step = frame.orientation().apply(heights.read(part)), square
    elif square is not None and square == frame.nominal_posting:
        raise InputError(
            "terrain.dtm_posting_m",
            posting,
            f"must be omitted, because the file states a grid spacing of {square:.4g} m",
        )
    else:
        step = posting or frame.mean_posting
        z = _resampled(frame, heights.read(part), step, posting)
    if not np.isfinite(z).any():
        raise InputError(
            "terrain.path",
            source.name,
            "must contain elevations, but all its values mean 'no height'",
        )
    return z, step


def _fits(posting: float | None, found: float) -> bool:
    return posting is None or abs(found - posting) <= 1e-3 * found


def _values(nodata: float | Sequence[float] | None) -> tuple[float, ...] | None:
    if nodata is None:
        return None
    return tuple(nodata) if isinstance(nodata, Sequence) else (nodata,)


def _window(window: tuple[int, int, int, int] | None, source: DatasetReader) -> Window:
    rows, cols = source.height, source.width
    if window is None:
        return Window(0, 0, cols, rows)
    top, bottom, left, right = window
    if not (0 <= top < bottom <= rows and 0 <= left < right <= cols):
        raise InputError(
            "terrain.dtm_window", tuple(window),
            "must be [first row, last row, first column, last column], increasing, with rows up to "
            f"{rows} and columns up to {cols}",
        )  # fmt: skip
    return Window(left, top, right - left, bottom - top)


def _resampled(frame: Frame, z: Array, step: float, posting: float | None) -> Array:
    """Interpolate heights of a raster to a centred square grid, row 0 in the south.

    `z` (rows, cols) are the heights in the order of the file, `step` is the spacing of the new
    grid, m, and `posting` the spacing that the user gave (only for error messages).
    """
    wide, high = frame.extent()
    cols, rows = (int(length / step + 1e-6) + 1 for length in (wide, high))
    check_count("terrain.dtm_posting_m", step, rows, cols, "Use a larger spacing.")
    if min(rows, cols) < 2:
        raise InputError(
            "terrain.dtm_posting_m",
            step,
            "must be smaller, because the raster must have at least 2 x 2 points",
        )
    east = np.asarray((np.arange(cols) - 0.5 * (cols - 1)) * step)
    north = np.asarray((np.arange(rows) - 0.5 * (rows - 1)) * step)
    return interpolated(frame, z, east, north)


def interpolated(frame: Frame, z: Array, east: Array, north: Array) -> Array:
    """Interpolate heights of a raster by cubic spline, at a grid in its frame.

    Parameters
    ----------
    frame, z
        Frame of the raster, and its heights (rows, cols), m, in the order of the file.
    east, north
        Coordinates (cols,) and (rows,) of the grid, m.

    Returns
    -------
    Array
        Heights (rows, cols), m; NaN outside the raster and next to missing heights.
    """
    last_row, last_col = z.shape[0] - 1.0, z.shape[1] - 1.0
    spline = GappySpline(np.pad(z, SPLINE_MARGIN, constant_values=np.nan), extrapolate_slopes=True)
    out = np.empty((len(north), len(east)))
    for top in range(0, len(north), _ROWS_PER_BLOCK):
        at = np.meshgrid(east, north[top : top + _ROWS_PER_BLOCK])
        col, row = frame.pixels(*at)
        col, row = col - 0.5, row - 0.5
        # Tolerance, so that rounding does not exclude the outermost posts.
        inside = np.abs(2.0 * col - last_col) <= last_col + 1e-6
        inside &= np.abs(2.0 * row - last_row) <= last_row + 1e-6
        col = np.where(inside, np.clip(col, 0.0, last_col), 0.0) + SPLINE_MARGIN
        row = np.where(inside, np.clip(row, 0.0, last_row), 0.0) + SPLINE_MARGIN
        block = spline(row, col)
        block[~inside | spline.is_gap(row, col)] = np.nan
        out[top : top + _ROWS_PER_BLOCK] = block
    return out
