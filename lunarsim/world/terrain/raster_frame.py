"""Locate the points of an elevation raster in a local frame in true metres."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.io import DatasetReader
from rasterio.warp import transform as warp
from rasterio.windows import Window

from lunarsim.errors import InputError
from lunarsim.typing import Array
from lunarsim.world.terrain.raster_label import wkt2

Mapping = Callable[[Array, Array], tuple[Array, Array]]

# Maximum misplacement of a raster point in a square, north-up grid, over its distance from the
# centre, for which heights are re-indexed without interpolation. Otherwise they are resampled.
MAX_MISPLACEMENT = 1e-3
# Half the distance over which the steps of a raster are measured at its centre, m.
_DIFFERENCE_M = 1.0
# Tolerance of mapping window corners to the local frame and back, grid spacings.
_MAX_ROUND_TRIP_POSTS = 0.1


@dataclass(frozen=True)
class Frame:
    """Local east, north frame of a raster window, with its origin at the centre.

    Attributes
    ----------
    description
        Coordinate reference system in words.
    to_local, to_map
        Mappings from map coordinates to east and north, m, and back.
    pixel_to_map
        Transform from fractional columns and rows of the window to map coordinates; grid point
        (i, j) lies at row i + 0.5 and column j + 0.5.
    cols, rows
        Numbers of columns and rows of the window.
    nominal_posting
        Grid spacing stated by the file, m; None in degrees, and if it differs between the two
        directions.
    metres_per_map_unit
        Length of a map unit as stated by the file, m; None in degrees.
    origin
        Planetocentric latitude and longitude, deg, or map coordinates of a plane map, of the
        frame's origin.
    """

    description: str
    to_local: Mapping
    to_map: Mapping
    pixel_to_map: Affine
    cols: int
    rows: int
    nominal_posting: float | None
    metres_per_map_unit: float | None
    origin: tuple[float, float]

    def local(self, cols: ArrayLike, rows: ArrayLike) -> tuple[Array, Array]:
        """Return east and north, m, at fractional columns and rows of the window."""
        return self.to_local(*_transformed(self.pixel_to_map, np.asarray(cols), np.asarray(rows)))

    def pixels(self, east: Array, north: Array) -> tuple[Array, Array]:
        """Return fractional columns and rows of points `east`, `north` (m)."""
        return _transformed(~self.pixel_to_map, *self.to_map(east, north))

    @property
    def steps(self) -> Array:
        """East and north components (2, 2), m, of a step of one column and of one row.

        The first index is east or north, the second column or row. The steps are the inverse of
        the derivative of raster coordinates with respect to local coordinates, because in the
        other direction PROJ rounds points near a centre on the equator to about 1 mm.
        """
        h = _DIFFERENCE_M
        at = self.pixels(np.array([-h, h, 0.0, 0.0]), np.array([0.0, 0.0, -h, h]))
        per_metre = [[np.diff(v[:2])[0], np.diff(v[2:])[0]] for v in at]
        return np.asarray(np.linalg.inv(np.array(per_metre) / (2.0 * h)), dtype=np.float64)

    def orientation(self) -> Orientation:
        """Return the exchange and reversal of rows and columns that orients the raster."""
        steps = self.steps
        transposed = bool(abs(steps[1, 0]) > abs(steps[0, 0]))
        along = steps[:, ::-1] if transposed else steps
        return Orientation(transposed, bool(along[0, 0] < 0.0), bool(along[1, 1] < 0.0))

    def square_posting(self) -> float | None:
        """Return the grid spacing, m, if the raster is a square north-up grid, else None."""
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
        """Geometric mean of the grid spacings along rows and along columns, m."""
        return float(np.sqrt(abs(np.linalg.det(self.steps))))

    def extent(self) -> tuple[float, float]:
        """Return width and height, m, of the centred rectangle around all grid points."""
        c, r = np.linspace(0.5, self.cols - 0.5, 65), np.linspace(0.5, self.rows - 0.5, 65)
        cols = np.concatenate([c, c, np.full(65, c[0]), np.full(65, c[-1])])
        rows = np.concatenate([np.full(65, r[0]), np.full(65, r[-1]), r, r])
        east, north = (v[np.isfinite(v)] for v in self.local(cols, rows))
        return 2.0 * float(np.abs(east).max()), 2.0 * float(np.abs(north).max())


@dataclass(frozen=True)
class Orientation:
    """Orientation of a raster: how to order its points from south-west to north-east.

    Rows and columns are exchanged first, if necessary, and then reversed.

    Attributes
    ----------
    transposed
        Whether a row of the file runs along north and south; rows and columns are then exchanged.
    eastern_first, northern_first
        Whether, after the exchange, the first column is the eastern one, and the first row the
        northern one.
    """

    transposed: bool
    eastern_first: bool
    northern_first: bool

    def apply(self, z: Array) -> Array:
        """Reorder heights `z` of the file: row 0 in the south, column 0 in the west."""
        z = z.T if self.transposed else z
        return z[:: -1 if self.northern_first else 1, :: -1 if self.eastern_first else 1]

    def __str__(self) -> str:
        rows = "columns" if self.transposed else "rows"
        cols = "rows" if self.transposed else "columns"
        return (
            f"{rows} from {'north to south' if self.northern_first else 'south to north'}, "
            f"{cols} from {'east to west' if self.eastern_first else 'west to east'}"
        )


def frame_of_window(
    source: DatasetReader,
    window: Window,
    posting: float | None,
    origin: tuple[float, float] | None = None,
) -> Frame:
    """Return the local frame of a window of a raster.

    Parameters
    ----------
    source
        Open raster file.
    window
        Rows and columns to use.
    posting
        Grid spacing, m, of a file without a coordinate reference system.
    origin
        Latitude and longitude, deg, of the origin of the frame (map coordinates for a plane map);
        None: the centre of the window.

    Raises
    ------
    InputError
        If the georeferencing is not usable, or if there is none and `posting` is not given or not
        sufficient.
    """
    transform = source.transform @ Affine.translation(window.col_off, window.row_off)
    if source.transform.is_identity:  # GDAL's value for a missing transform
        _check_no_tie_points(source)
        transform = Affine.scale(1.0, -1.0)
    if not (np.isfinite(transform).all() and abs(transform.determinant) > 0.0):
        raise _refusal(source, "has an affine transform that is singular or not finite")
    cols, rows = int(window.width), int(window.height)
    metres: float | None
    centre = origin or transform @ (0.5 * cols, 0.5 * rows)
    if not is_placed(source):
        if posting is None:
            found = [
                "a coordinate reference system but no transform" if source.crs
                else "no georeferencing",
                "a transform but no coordinate reference system",
            ][not source.transform.is_identity]  # fmt: skip
            raise _refusal(
                source, f"has {found}", "Set terrain.dtm_posting_m, the grid spacing of the raster."
            )
        across, along = _step_lengths(transform)
        if abs(across - along) > 1e-6 * across:
            raise _refusal(source, "has no coordinate reference system and unequal steps")
        name, metres = "none", posting / across
        mappings = _plane_mappings(centre, metres)
    elif _is_engineering(source.crs):
        name, metres = _name(source.crs), _engineering_unit(source)
        mappings = _plane_mappings(centre, metres)
    elif source.crs.is_geographic or source.crs.is_projected:
        _check_axes(source)
        name = _name(source.crs) + (", degrees" if source.crs.is_geographic else "")
        metres = None if source.crs.is_geographic else float(source.crs.linear_units_factor[1])
        centre, mappings = _spherical_mappings(source, transform, cols, rows, origin)
    else:
        raise _refusal(
            source,
            f"has a coordinate reference system {_name(source.crs)!r} that is not horizontal",
        )
    across, along = _step_lengths(transform)
    equal = metres is not None and abs(across - along) <= MAX_MISPLACEMENT * across
    nominal = posting if not is_placed(source) else (metres * across if metres and equal else None)
    return Frame(name, *mappings, transform, cols, rows, nominal, metres, centre)


def is_placed(source: DatasetReader) -> bool:
    """Return whether a file has a coordinate reference system and a transform."""
    return source.crs is not None and not source.transform.is_identity


def _refusal(source: DatasetReader, problem: str, remedy: str = "") -> InputError:
    return InputError("terrain.path", source.name, problem, remedy)


def _check_no_tie_points(source: DatasetReader) -> None:
    if source.gcps[0] or source.rpcs:
        raise _refusal(
            source,
            "is georeferenced by control points",
            "Resample the file: `gdalwarp FILE out.tif`.",
        )


def _check_axes(source: DatasetReader) -> None:
    """Raise InputError if coordinates increase to the west or south.

    GDAL does not preserve these axis directions.
    """
    counts_west = re.search(r'AXIS\["[^"]*",WEST', source.crs.to_wkt(), re.IGNORECASE)
    axes = source.crs.to_dict().get("axis", "enu")
    if (source.crs.is_geographic and counts_west) or axes != "enu":
        raise _refusal(
            source, "has coordinates that increase to the west or south",
            "Resample the file: `gdalwarp FILE out.tif`.",
        )  # fmt: skip


def _transformed(transform: Affine, x: Array, y: Array) -> tuple[Array, Array]:
    """Return the points `x`, `y` transformed by an affine transform."""
    a, b, c, d, e, f = transform[:6]
    return a * x + b * y + c, d * x + e * y + f


def _step_lengths(transform: Affine) -> tuple[float, float]:
    """Return the lengths of a step of one column and of one row, map units."""
    return float(np.hypot(transform.a, transform.d)), float(np.hypot(transform.b, transform.e))


def _plane_mappings(centre: tuple[float, float], metres: float) -> tuple[Mapping, Mapping]:
    """Return mappings between a plane map and the local frame, in both directions.

    `centre` are the map coordinates of the local origin, `metres` is the length of a map unit. The
    map's axes point east and north.
    """
    cx, cy = centre

    def to_local(x: Array, y: Array) -> tuple[Array, Array]:
        return metres * (x - cx), metres * (y - cy)

    def to_map(east: Array, north: Array) -> tuple[Array, Array]:
        return cx + east / metres, cy + north / metres

    return to_local, to_map


def _spherical_mappings(
    source: DatasetReader,
    transform: Affine,
    cols: int,
    rows: int,
    origin: tuple[float, float] | None,
) -> tuple[tuple[float, float], tuple[Mapping, Mapping]]:
    """Return origin of a local frame, and mappings between map and frame.

    The frame is an azimuthal equidistant projection about `origin` (planetocentric latitude and
    longitude, deg); None: the centre of `cols` x `rows`. `transform` leads to map coordinates.
    """
    body = body_of(source.crs)
    crs = _on_sphere(source.crs, body)
    cx, cy = transform @ (0.5 * cols, 0.5 * rows)
    globe = CRS.from_dict({"proj": "longlat"} | body)
    (lon,), (lat,) = warp(crs, globe, [cx], [cy])
    if not np.isfinite([lon, lat]).all():
        raise _refusal(source, "has its centre outside the domain of its projection")
    x0 = cx
    if origin is not None:
        lat, lon = planetodetic(origin[0], body), origin[1]
        try:
            (x0,), _ = warp(globe, crs, [lon], [lat])
        except CPLE_BaseError:
            place = f"latitude {origin[0]:g} and longitude {lon:g} deg"
            raise _refusal(source, f"has a projection that excludes {place}") from None
    edge = _refusal(source, "extends beyond the edge of its projection",
                    "Choose a part of the raster with terrain.dtm_window.")  # fmt: skip
    target = CRS.from_dict({"proj": "aeqd", "lat_0": lat, "lon_0": lon, "units": "m"} | body)

    def warped(start: CRS, end: CRS, x: Array, y: Array) -> tuple[Array, Array]:
        try:
            return _reproject(start, end, x, y)
        except CPLE_BaseError:
            raise edge from None

    def to_local(x: Array, y: Array) -> tuple[Array, Array]:
        return warped(crs, target, x, y)

    def back(period: float) -> Mapping:
        near = x0 + (period * np.round((cx - x0) / period) if period else 0.0)

        def to_map(east: Array, north: Array) -> tuple[Array, Array]:
            x, y = warped(target, crs, east, north)
            # Shift by the period: longitudes and cylindrical maps continue beyond 180 deg.
            return (x + period * np.round((near - x) / period) if period else x), y

        return to_map

    period = _longitude_period(crs, globe, lon, lat)
    if origin is not None:
        # A map of the complete body is valid around the origin, not in all of its corners.
        return origin, (to_local, back(period if _is_cylindrical(crs, globe, lon, lat) else 0.0))
    at = np.meshgrid([0.5, cols / 2, cols - 0.5], [0.5, rows / 2, rows - 0.5])
    x, y = _transformed(transform, at[0].ravel(), at[1].ravel())
    east, north = to_local(x, y)
    for step in (0.0, period):
        to_map = back(step)
        again = to_map(east, north)
        off = np.hypot(again[0] - x, again[1] - y) / min(_step_lengths(transform))
        if np.all(off[np.isfinite(off)] < _MAX_ROUND_TRIP_POSTS):
            return (planetocentric(lat, body), lon), (to_local, to_map)
    raise edge


def planetodetic(latitude: float, body: dict[str, Any]) -> float:
    """Return the planetodetic latitude, deg, of a planetocentric one on a body.

    `body` has the PROJ parameters of `body_of`. References on a flattened body, and the projections
    of PROJ, have planetodetic latitudes.
    """
    return _scaled_tangent(latitude, (1.0 - 1.0 / body["rf"]) ** -2) if "rf" in body else latitude


def planetocentric(latitude: float, body: dict[str, Any]) -> float:
    """Return the planetocentric latitude, deg, of a planetodetic one on a body."""
    return _scaled_tangent(latitude, (1.0 - 1.0 / body["rf"]) ** 2) if "rf" in body else latitude


def _scaled_tangent(angle: float, factor: float) -> float:
    """Return the angle, deg, with `factor` times the tangent of `angle`, deg."""
    radians = np.radians(angle)
    return float(np.degrees(np.arctan2(factor * np.sin(radians), np.cos(radians))))


def _is_cylindrical(crs: CRS, globe: CRS, lon: float, lat: float) -> bool:
    """Return whether the first map coordinate depends only on the longitude.

    `crs`, `globe`, `lon` and `lat` are as for `_longitude_period`.
    """
    x, _ = _reproject(globe, crs, np.full(2, lon), np.array([lat, lat - np.copysign(1.0, lat)]))
    return bool(abs(x[1] - x[0]) < 1e-9 * _longitude_period(crs, globe, lon, lat))


def is_complete_turn(source: DatasetReader) -> bool:
    """Return whether the columns of a raster go once around the body."""
    crs = source.crs
    if not is_placed(source) or not (crs.is_geographic or crs.is_projected):
        return False
    body = body_of(crs)
    globe = CRS.from_dict({"proj": "longlat"} | body)
    crs, (x, y) = (
        _on_sphere(crs, body),
        source.transform @ (0.5 * source.width, 0.5 * source.height),
    )
    (lon,), (lat,) = warp(crs, globe, [x], [y])
    if not np.isfinite([lon, lat]).all() or not _is_cylindrical(crs, globe, lon, lat):
        return False
    columns = _longitude_period(crs, globe, lon, lat) / abs(source.transform.a or np.inf)
    return bool(abs(columns - source.width) < 0.5)


def _longitude_period(crs: CRS, globe: CRS, lon: float, lat: float) -> float:
    """Return the length of 360 degrees of longitude at a point, in map units.

    `crs` is the map's reference system, `globe` the longitude and latitude of the same body;
    `lon` and `lat` are the point, deg.
    """
    x, _ = _reproject(globe, crs, lon + np.array([-1e-3, 0.0, 1e-3]), np.full(3, lat))
    # One of the two steps may cross the edge of the map.
    return float(np.abs(np.diff(x)).min()) * 360_000.0


def _reproject(source: CRS, target: CRS, x: Array, y: Array) -> tuple[Array, Array]:
    east, north = warp(source, target, x.ravel(), y.ravel())
    return np.reshape(east, x.shape), np.reshape(north, y.shape)


def body_of(crs: CRS) -> dict[str, Any]:
    """Return the ellipsoid of a coordinate reference system as PROJ parameters.

    Planetary maps in the equidistant cylindrical projection define latitudes on a sphere of the
    equatorial radius; distances on the map are distances on that sphere.
    """
    number = r"([-+.\deE]+)"
    found = re.search(rf'(?:ELLIPSOID|SPHEROID)\["[^"]*",{number},{number}', crs.to_wkt())
    if found is None:
        raise InputError(
            "terrain.path",
            crs.to_string()[:60],
            "must have a coordinate reference system with an ellipsoid",
        )
    radius, inverse_flattening = (float(text) for text in found.groups())
    if inverse_flattening == 0.0 or crs.to_dict().get("proj") == "eqc":
        return {"R": radius}
    return {"a": radius, "rf": inverse_flattening}


def _on_sphere(crs: CRS, body: dict[str, Any]) -> CRS:
    """Replace the ellipsoid of an equidistant cylindrical projection by `body`.

    Only later releases of PROJ compute this projection on the ellipsoid. Other coordinate reference
    systems are returned unchanged.
    """
    terms = crs.to_dict()
    if terms.get("proj") != "eqc":
        return crs
    shape = {"ellps", "datum", "a", "b", "rf", "f", "R"}
    return CRS.from_dict({k: v for k, v in terms.items() if k not in shape} | body)


def _is_engineering(crs: CRS) -> bool:
    return re.match(r"(COMPOUNDCRS\[\"[^\"]*\",)?ENGCRS", wkt2(crs)) is not None


def _engineering_unit(source: DatasetReader) -> float:
    """Return the length, m, of the unit of a local (engineering) reference system."""
    found = re.search(r'LENGTHUNIT\["[^"]*",([-+.\deE]+)', wkt2(source.crs).split("VERTCRS")[0])
    if found is None:
        raise _refusal(source, "has a local coordinate reference system without a unit of length")
    return float(found.group(1))


def _name(crs: CRS) -> str:
    """Return the name of a reference system; PROJ parameters if it has none."""
    names = str(crs.to_wkt()).split('"')
    name = names[1] if len(names) > 1 else "unnamed"
    return crs.to_proj4() or name if name in ("unknown", "unnamed") else name
