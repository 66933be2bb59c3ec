"""Place the posts of a raster in a local east, north frame in true metres."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.io import DatasetReader
from rasterio.warp import transform as warp
from rasterio.windows import Window

from lunarsim.errors import InputError
from lunarsim.world.terrain.raster_label import wkt2

Array = NDArray[np.float64]
Mapping = Callable[[Array, Array], tuple[Array, Array]]

# Posts are re-indexed without interpolation if none is farther from its place in a square,
# north-up grid than this share of its distance from the centre. Otherwise they are resampled.
MAX_MISPLACEMENT = 1e-3
# Half the distance, m, over which the steps of a raster are measured at its centre.
_DIFFERENCE_M = 1.0
# Window corners must map to the local frame and back within this many posts.
_MAX_ROUND_TRIP_POSTS = 0.1


@dataclass(frozen=True)
class Frame:
    """The local frame of a window; its origin is the centre of the window.

    Attributes
    ----------
    description
        Coordinate reference in words.
    to_local, to_map
        From map coordinates to east and north, m, and back.
    pixel_to_map
        Map coordinates of the fractional columns and rows of the window; a post has its centre
        at half a column and row.
    cols, rows
        Size of the window.
    nominal_posting
        Distance between posts that the file states, m; None in degrees, and if the two
        directions differ.
    metres_per_map_unit
        Length of a unit of the map, m, as the file states it; None in degrees.
    """

    description: str
    to_local: Mapping
    to_map: Mapping
    pixel_to_map: Affine
    cols: int
    rows: int
    nominal_posting: float | None
    metres_per_map_unit: float | None

    def local(self, cols: ArrayLike, rows: ArrayLike) -> tuple[Array, Array]:
        """Return east and north, m, of fractional columns and rows of the window."""
        return self.to_local(*_moved(self.pixel_to_map, np.asarray(cols), np.asarray(rows)))

    def pixels(self, east: Array, north: Array) -> tuple[Array, Array]:
        """Return fractional columns and rows of places in the local frame."""
        return _moved(~self.pixel_to_map, *self.to_map(east, north))

    @property
    def steps(self) -> Array:
        """East and north component (2, 2), m, of a step of one column and of one row.

        Found from the local frame to the raster: the other way, PROJ rounds places near a
        centre on the equator to about 1 mm.
        """
        h = _DIFFERENCE_M
        at = self.pixels(np.array([-h, h, 0.0, 0.0]), np.array([0.0, 0.0, -h, h]))
        per_metre = [[np.diff(v[:2])[0], np.diff(v[2:])[0]] for v in at]
        return np.asarray(np.linalg.inv(np.array(per_metre) / (2.0 * h)), dtype=np.float64)

    def orientation(self) -> Orientation:
        """Return how rows and columns are exchanged and reversed so that the raster is north-up."""
        steps = self.steps
        transposed = bool(abs(steps[1, 0]) > abs(steps[0, 0]))
        along = steps[:, ::-1] if transposed else steps
        return Orientation(transposed, bool(along[0, 0] < 0.0), bool(along[1, 1] < 0.0))

    def square_posting(self) -> float | None:
        """Return the posting, m, if the posts are a square north-up grid; see MAX_MISPLACEMENT."""
        at = np.meshgrid([0.5, 0.5 * self.cols, self.cols - 0.5], [0.5, 0.5 * self.rows,
                                                                  self.rows - 0.5])  # fmt: skip
        east, north = self.local(*(v.ravel() for v in at))
        right, down = at[0].ravel() - 0.5 * self.cols, at[1].ravel() - 0.5 * self.rows
        turned = self.orientation()
        e, n = (down, right) if turned.transposed else (right, down)
        e = -e if turned.eastern_first else e
        n = -n if turned.northern_first else n
        for posting in (self.nominal_posting, self.mean_posting):
            if posting is None:
                continue
            off = np.hypot(east - posting * e, north - posting * n)
            if np.all(off <= MAX_MISPLACEMENT * posting * np.hypot(e, n) + 1e-9 * posting):
                return posting
        return None

    @property
    def mean_posting(self) -> float:
        """Geometric mean of the distances between posts along rows and columns, m."""
        return float(np.sqrt(abs(np.linalg.det(self.steps))))

    def extent(self) -> tuple[float, float]:
        """Return the width and height, m, of the rectangle about the centre with all posts."""
        c, r = np.linspace(0.5, self.cols - 0.5, 65), np.linspace(0.5, self.rows - 0.5, 65)
        cols = np.concatenate([c, c, np.full(65, c[0]), np.full(65, c[-1])])
        rows = np.concatenate([np.full(65, r[0]), np.full(65, r[-1]), r, r])
        east, north = (v[np.isfinite(v)] for v in self.local(cols, rows))
        return 2.0 * float(np.abs(east).max()), 2.0 * float(np.abs(north).max())


@dataclass(frozen=True)
class Orientation:
    """How a raster lies: exchange rows and columns first, then reverse them.

    Attributes
    ----------
    transposed
        Whether a row of the file runs from south to north.
    eastern_first, northern_first
        Whether the first column is the eastern one, and the first row the northern one.
    """

    transposed: bool
    eastern_first: bool
    northern_first: bool

    def apply(self, z: Array) -> Array:
        """Return posts with row 0 in the south and column 0 in the west."""
        z = z.T if self.transposed else z
        return z[:: -1 if self.northern_first else 1, :: -1 if self.eastern_first else 1]

    def __str__(self) -> str:
        rows = "columns" if self.transposed else "rows"
        cols = "rows" if self.transposed else "columns"
        return (
            f"{rows} from {'north to south' if self.northern_first else 'south to north'}, "
            f"{cols} from {'east to west' if self.eastern_first else 'west to east'}"
        )


def frame_of(source: DatasetReader, window: Window, posting: float | None) -> Frame:
    """Return the local frame of a window of a raster.

    Parameters
    ----------
    source
        The open file.
    window
        The part that is used.
    posting
        Distance between posts, m, of a file without a coordinate reference.

    Raises
    ------
    InputError
        If the file does not say where its posts lie, and `posting` does not help.
    """
    transform = source.transform @ Affine.translation(window.col_off, window.row_off)
    if source.transform.is_identity:  # GDAL's sign for: none
        _check_no_tie_points(source)
        transform = Affine.scale(1.0, -1.0)
    if not (np.isfinite(transform).all() and abs(transform.determinant) > 0.0):
        raise _refusal(source, "its affine transform is singular or not finite")
    cols, rows = int(window.width), int(window.height)
    metres: float | None
    centre = transform @ (0.5 * cols, 0.5 * rows)
    if not is_placed(source):
        if posting is None:
            found = [
                "a coordinate reference, but no transform" if source.crs else "no georeference",
                "a transform, but no coordinate reference",
            ][not source.transform.is_identity]
            raise _refusal(
                source, f"it has {found}. Set terrain.dtm_posting_m, the distance of its posts"
            )
        across, along = _step_lengths(transform)
        if abs(across - along) > 1e-6 * across:
            raise _refusal(source, "it has no coordinate reference and unequal steps")
        name, metres = "none", posting / across
        mappings = _plane(centre, metres)
    elif _is_engineering(source.crs):
        name, metres = _name(source.crs), _engineering_unit(source)
        mappings = _plane(centre, metres)
    elif source.crs.is_geographic or source.crs.is_projected:
        _check_axes(source)
        name = _name(source.crs) + (", degrees" if source.crs.is_geographic else "")
        metres = None if source.crs.is_geographic else float(source.crs.linear_units_factor[1])
        mappings = _globe(source, transform, cols, rows)
    else:
        raise _refusal(source, f"its coordinate reference {_name(source.crs)!r} is not horizontal")
    across, along = _step_lengths(transform)
    equal = metres is not None and abs(across - along) <= MAX_MISPLACEMENT * across
    nominal = posting if not is_placed(source) else (metres * across if metres and equal else None)
    return Frame(name, *mappings, transform, cols, rows, nominal, metres)


def is_placed(source: DatasetReader) -> bool:
    """Whether a file says where its posts lie; GDAL returns the identity for no transform."""
    return source.crs is not None and not source.transform.is_identity


def _refusal(source: DatasetReader, problem: str) -> InputError:
    return InputError("terrain.path", source.name, problem)


def _check_no_tie_points(source: DatasetReader) -> None:
    if source.gcps[0] or source.rpcs:
        raise _refusal(
            source, "it is placed by control points. Resample it: `gdalwarp FILE out.tif`"
        )


def _check_axes(source: DatasetReader) -> None:
    """Refuse references whose axes GDAL does not pass on as they are meant."""
    counts_west = re.search(r'AXIS\["[^"]*",WEST', source.crs.to_wkt(), re.IGNORECASE)
    axes = source.crs.to_dict().get("axis", "enu")
    if (source.crs.is_geographic and counts_west) or axes != "enu":
        raise _refusal(
            source, "its coordinates count west or south. Resample it: `gdalwarp FILE out.tif`"
        )


def _moved(transform: Affine, x: Array, y: Array) -> tuple[Array, Array]:
    """Return places moved by an affine transform."""
    a, b, c, d, e, f = transform[:6]
    return a * x + b * y + c, d * x + e * y + f


def _step_lengths(transform: Affine) -> tuple[float, float]:
    """Return the length of a step of one column and of one row, map units."""
    return float(np.hypot(transform.a, transform.d)), float(np.hypot(transform.b, transform.e))


def _plane(centre: tuple[float, float], metres: float) -> tuple[Mapping, Mapping]:
    """Return the mappings of a plane whose axes point east and north."""
    cx, cy = centre

    def to_local(x: Array, y: Array) -> tuple[Array, Array]:
        return metres * (x - cx), metres * (y - cy)

    def to_map(east: Array, north: Array) -> tuple[Array, Array]:
        return cx + east / metres, cy + north / metres

    return to_local, to_map


def _globe(
    source: DatasetReader, transform: Affine, cols: int, rows: int
) -> tuple[Mapping, Mapping]:
    """Return the mappings to an azimuthal equidistant frame about the centre of a window."""
    body = _body(source.crs)
    crs = _on_sphere(source.crs, body)
    cx, cy = transform @ (0.5 * cols, 0.5 * rows)
    globe = CRS.from_dict({"proj": "longlat"} | body)
    (lon,), (lat,) = warp(crs, globe, [cx], [cy])
    if not np.isfinite([lon, lat]).all():
        raise _refusal(source, "its centre lies outside the domain of its projection")
    edge = _refusal(
        source, "it reaches over the edge of its projection. Choose a part: terrain.dtm_window"
    )
    target = CRS.from_dict({"proj": "aeqd", "lat_0": lat, "lon_0": lon, "units": "m"} | body)

    def warped(start: CRS, end: CRS, x: Array, y: Array) -> tuple[Array, Array]:
        try:
            return _warped(start, end, x, y)
        except CPLE_BaseError:
            raise edge from None

    def to_local(x: Array, y: Array) -> tuple[Array, Array]:
        return warped(crs, target, x, y)

    def back(period: float) -> Mapping:
        def to_map(east: Array, north: Array) -> tuple[Array, Array]:
            x, y = warped(target, crs, east, north)
            # Longitudes go on beyond 180 deg, and a cylindrical map with them.
            return (x + period * np.round((cx - x) / period) if period else x), y

        return to_map

    at = np.meshgrid([0.5, cols / 2, cols - 0.5], [0.5, rows / 2, rows - 0.5])
    x, y = _moved(transform, at[0].ravel(), at[1].ravel())
    east, north = to_local(x, y)
    for period in (0.0, _turn(crs, globe, lon, lat)):
        to_map = back(period)
        again = to_map(east, north)
        off = np.hypot(again[0] - x, again[1] - y) / min(_step_lengths(transform))
        if np.all(off[np.isfinite(off)] < _MAX_ROUND_TRIP_POSTS):
            return to_local, to_map
    raise edge


def _turn(crs: CRS, globe: CRS, lon: float, lat: float) -> float:
    """Return the map units of 360 degrees of longitude."""
    x, _ = _warped(globe, crs, lon + np.array([-1e-3, 0.0, 1e-3]), np.full(3, lat))
    # One of the two steps may pass the edge of the map.
    return float(np.abs(np.diff(x)).min()) * 360_000.0


def _warped(source: CRS, target: CRS, x: Array, y: Array) -> tuple[Array, Array]:
    east, north = warp(source, target, x.ravel(), y.ravel())
    return np.reshape(east, x.shape), np.reshape(north, y.shape)


def _body(crs: CRS) -> dict[str, Any]:
    """Return the ellipsoid of a coordinate reference, in PROJ's terms.

    Planetary maps in the equidistant cylindrical projection count their latitudes on a sphere of
    the equatorial radius: distances are those of that sphere.
    """
    number = r"([-+.\deE]+)"
    found = re.search(rf'(?:ELLIPSOID|SPHEROID)\["[^"]*",{number},{number}', crs.to_wkt())
    if found is None:
        raise InputError("terrain.path", crs.to_string()[:60], "it names no ellipsoid")
    radius, inverse_flattening = (float(text) for text in found.groups())
    if inverse_flattening == 0.0 or crs.to_dict().get("proj") == "eqc":
        return {"R": radius}
    return {"a": radius, "rf": inverse_flattening}


def _on_sphere(crs: CRS, body: dict[str, Any]) -> CRS:
    """Return an equidistant cylindrical reference on a body; any other reference as it is.

    Later releases of PROJ compute this projection on the ellipsoid.
    """
    terms = crs.to_dict()
    if terms.get("proj") != "eqc":
        return crs
    shape = {"ellps", "datum", "a", "b", "rf", "f", "R"}
    return CRS.from_dict({k: v for k, v in terms.items() if k not in shape} | body)


def _is_engineering(crs: CRS) -> bool:
    return re.match(r"(COMPOUNDCRS\[\"[^\"]*\",)?ENGCRS", wkt2(crs)) is not None


def _engineering_unit(source: DatasetReader) -> float:
    """Return the metres of the unit of a local (engineering) reference."""
    found = re.search(r'LENGTHUNIT\["[^"]*",([-+.\deE]+)', wkt2(source.crs).split("VERTCRS")[0])
    if found is None:
        raise _refusal(source, "its local coordinate reference gives no unit of length")
    return float(found.group(1))


def _name(crs: CRS) -> str:
    names = str(crs.to_wkt()).split('"')
    return names[1] if len(names) > 1 else "unnamed"
