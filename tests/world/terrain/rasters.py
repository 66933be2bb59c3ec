"""Raster files of an analytic terrain, in all formats, orientations, units and projections.

The maps are computed by textbook formulas on a sphere, not by PROJ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rasterio
from affine import Affine
from scipy.io import netcdf_file

RADIUS = 1_737_400.0
ROWS, COLS = 80, 72
SPHERE = f"+R={RADIUS:.0f} +no_defs"


def terrain(east, north, size):
    """Return heights, m, of a tilted plane with a hill in its north-east; `size` is half a side."""
    hill = np.exp(-((east - 0.25 * size) ** 2 + (north - 0.2 * size) ** 2) / (0.25 * size) ** 2)
    return 0.004 * size + 0.03 * north + 0.015 * east + 0.06 * size * hill


@dataclass(frozen=True)
class Map:
    """A map projection of the sphere.

    Attributes
    ----------
    crs
        Coordinate reference; None for a file without one.
    lon, lat
        Centre of the raster, deg.
    forward, inverse
        From longitude and latitude, rad, to map units, and back.
    step
        Distance between posts, map units.
    true_step
        The same east and north of the centre, m.
    """

    crs: str | None
    lon: float
    lat: float
    forward: object
    inverse: object
    step: float
    true_step: tuple[float, float]

    def local(self, x, y):
        """Return east and north, m, in an azimuthal equidistant frame about the centre."""
        lon, lat = self.inverse(x, y)
        lon0, lat0 = np.radians(self.lon), np.radians(self.lat)
        dl = lon - lon0
        a = np.cos(lat) * np.sin(dl)
        b = np.cos(lat0) * np.sin(lat) - np.sin(lat0) * np.cos(lat) * np.cos(dl)
        c = np.arcsin(np.clip(np.hypot(a, b), 0.0, 1.0))
        with np.errstate(invalid="ignore"):
            k = np.where(c > 1e-12, RADIUS * c / np.sin(np.maximum(c, 1e-12)), RADIUS)
        return k * a, k * b


class Plane(Map):
    """A metric frame that is no map of a sphere."""

    def local(self, x, y):
        """Return east and north, m, of the centre."""
        metres = self.true_step[0] / self.step
        x0, y0 = self.forward(0.0, 0.0)
        return metres * (x - x0), metres * (y - y0)


def plane(crs, step, metres=1.0, origin=(3000.0, -2000.0)):
    """Return a metric frame."""
    return Plane(crs, 0.0, 0.0, lambda a, b: origin, None, step, (metres * step, metres * step))


def equirectangular(lat, lat_ts=0.0, lon=0.0, units="m", metres=1.0, step=10.0):
    """Return an equidistant cylindrical map."""
    k = RADIUS / metres
    c = np.cos(np.radians(lat_ts))
    true = (metres * step * np.cos(np.radians(lat)) / c, metres * step)
    return Map(
        f"+proj=eqc +lat_ts={lat_ts} +units={units} {SPHERE}", lon, lat,
        lambda lo, la: (k * lo * c, k * la), lambda x, y: (x / (k * c), y / k), step, true,
    )  # fmt: skip


def mercator(lat, step=10.0):
    """Return a Mercator map."""
    true = step * np.cos(np.radians(lat))
    return Map(
        f"+proj=merc +units=m {SPHERE}", 20.0, lat,
        lambda lo, la: (RADIUS * lo, RADIUS * np.log(np.tan(np.pi / 4 + la / 2))),
        lambda x, y: (x / RADIUS, 2 * np.arctan(np.exp(y / RADIUS)) - np.pi / 2),
        step, (true, true),
    )  # fmt: skip


def south_polar(lon, lat, step=10.0):
    """Return a south polar stereographic map."""

    def forward(lo, la):
        rho = 2.0 * RADIUS * np.tan(np.pi / 4 + la / 2)
        return rho * np.sin(lo), rho * np.cos(lo)

    def inverse(x, y):
        return np.arctan2(x, y), 2 * np.arctan(np.hypot(x, y) / (2 * RADIUS)) - np.pi / 2

    crs = f"+proj=stere +lat_0=-90 +lon_0=0 +units=m {SPHERE}"
    k = 2.0 / (1.0 + np.sin(np.radians(abs(lat))))
    return Map(crs, lon, lat, forward, inverse, step, (step / k, step / k))


def degrees(lon, lat, step=5e-4):
    """Return a map in degrees."""
    north = np.radians(step) * RADIUS
    return Map(
        f"+proj=longlat {SPHERE}", lon, lat, lambda lo, la: (np.degrees(lo), np.degrees(la)),
        lambda x, y: (np.radians(x), np.radians(y)), step,
        (north * np.cos(np.radians(lat)), north),
    )  # fmt: skip


# Map offset of a step of one column and of one row, in steps.
ORIENTATIONS = {
    "north-up": (1, 0, 0, -1),
    "south-up": (1, 0, 0, 1),
    "east-first": (-1, 0, 0, -1),
    "half-turn": (-1, 0, 0, 1),
    "quarter-turn": (0, 1, 1, 0),
    "quarter-turn-back": (0, -1, -1, 0),
    "transposed": (0, 1, -1, 0),
    "transposed-back": (0, -1, 1, 0),
    "turned": (np.cos(0.5), np.sin(0.5), np.sin(0.5), -np.cos(0.5)),
    "sheared": (1, 0.1, 0.3, -1),
    "unequal": (1, 0, 0, -1.25),
}


METRIC = plane(f"+proj=eqc +units=m {SPHERE}", 10.0, origin=(0.0, 0.0))


@dataclass(frozen=True)
class Case:
    """A raster file and what is expected of it.

    Attributes
    ----------
    driver, dtype
        Format and type of the numbers.
    map, orientation
        Where the posts are.
    scale, offset, unit, metres
        Height = (number * scale + offset) * metres.
    no_data
        Declared number of two posts without a height.
    refused
        Words of the error; empty if the raster is read.
    options
        Of `load_dtm`.
    """

    driver: str = "GTiff"
    map: Map = METRIC
    orientation: str = "north-up"
    dtype: str = "float64"
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    metres: float = 1.0
    no_data: float | None = None
    refused: str = ""
    options: tuple = ()

    @property
    def size(self):
        """Half a side of the terrain, m."""
        return 0.5 * ROWS * max(self.map.true_step)

    @property
    def transform(self):
        """Affine transform of the file."""
        a, d, b, e = (self.map.step * v for v in ORIENTATIONS[self.orientation])
        x, y = self.map.forward(np.radians(self.map.lon), np.radians(self.map.lat))
        centre = Affine(a, b, x, d, e, y)
        return centre @ Affine.translation(-COLS / 2, -ROWS / 2)

    def numbers(self):
        """Return the numbers of the file."""
        rows, cols = np.mgrid[:ROWS, :COLS] + 0.5
        z = terrain(*self.map.local(*(self.transform @ (cols, rows))), self.size)
        numbers = (z / self.metres - self.offset) / self.scale
        if np.dtype(self.dtype).kind in "iu":
            numbers = np.round(numbers)
        if self.no_data is not None:
            numbers[5, 7] = numbers[30, 20] = self.no_data
        return numbers.astype(self.dtype)

    def write(self, folder):
        """Write the file and return its path."""
        return WRITERS[self.driver](self, folder)


def _with_rasterio(case, folder):
    path = folder / {"GTiff": "z.tif", "PDS4": "z.xml", "ENVI": "z.dat"}[case.driver]
    with rasterio.open(
        path, "w", driver=case.driver, height=ROWS, width=COLS, count=1, dtype=case.dtype,
        crs=case.map.crs, transform=case.transform, nodata=case.no_data,
    ) as file:  # fmt: skip
        file.write(case.numbers(), 1)
        if (case.scale, case.offset) != (1.0, 0.0):
            file.scales, file.offsets = (case.scale,), (case.offset,)
        if case.unit is not None:
            file.units = (case.unit,)
    return path


def _pds3(case, folder):
    types = {"int16": ("LSB_INTEGER", 16), "float32": ("PC_REAL", 32), "float64": ("PC_REAL", 64)}
    kind, bits = types[case.dtype]
    optional = {"UNIT": case.unit, "MISSING_CONSTANT": case.no_data}
    more = "".join(f"  {k} = {v}\n" for k, v in optional.items() if v is not None)
    record = COLS * bits // 8
    text = f"""PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = {record}
FILE_RECORDS = {ROWS}
^IMAGE = "z.img"
TARGET_NAME = MOON
OBJECT = IMAGE
  LINES = {ROWS}
  LINE_SAMPLES = {COLS}
  SAMPLE_TYPE = {kind}
  SAMPLE_BITS = {bits}
  SCALING_FACTOR = {case.scale}
  OFFSET = {case.offset}
{more}END_OBJECT = IMAGE
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "SIMPLE CYLINDRICAL"
  A_AXIS_RADIUS = 1737.4 <KM>
  B_AXIS_RADIUS = 1737.4 <KM>
  C_AXIS_RADIUS = 1737.4 <KM>
  POSITIVE_LONGITUDE_DIRECTION = EAST
  CENTER_LATITUDE = 0.0
  CENTER_LONGITUDE = 0.0
  MAP_SCALE = {case.map.step} <METERS/PIXEL>
  LINE_PROJECTION_OFFSET = {case.transform.f / case.map.step - 0.5}
  SAMPLE_PROJECTION_OFFSET = {-case.transform.c / case.map.step - 0.5}
END_OBJECT = IMAGE_MAP_PROJECTION
END
"""
    case.numbers().tofile(folder / "z.img")
    (folder / "z.lbl").write_text(text)
    return folder / "z.img"


def _isis3(case, folder):
    kind = {"int16": "SignedWord", "float32": "Real"}[case.dtype]
    text = f"""Object = IsisCube
  Object = Core
    StartByte = 4097
    Format = BandSequential
    Group = Dimensions
      Samples = {COLS}
      Lines = {ROWS}
      Bands = 1
    End_Group
    Group = Pixels
      Type = {kind}
      ByteOrder = Lsb
      Base = {case.offset}
      Multiplier = {case.scale}
    End_Group
  End_Object
  Group = BandBin
    Name = Elevation
    Unit = {case.unit or "m"}
  End_Group
  Group = Mapping
    ProjectionName = Equirectangular
    CenterLongitude = 0.0
    CenterLatitude = 0.0
    TargetName = Moon
    EquatorialRadius = {RADIUS} <meters>
    PolarRadius = {RADIUS} <meters>
    LatitudeType = Planetocentric
    LongitudeDirection = PositiveEast
    LongitudeDomain = 180
    UpperLeftCornerX = {case.transform.c} <meters>
    UpperLeftCornerY = {case.transform.f} <meters>
    PixelResolution = {case.map.step} <meters/pixel>
    Scale = {np.pi * RADIUS / 180 / case.map.step} <pixels/degree>
  End_Group
End_Object
Object = Label
  Bytes = 4096
End_Object
End
"""
    path = folder / "z.cub"
    path.write_bytes(text.encode().ljust(4096, b"\0") + case.numbers().tobytes())
    return path


def _ascii_grid(case, folder):
    t, step = case.transform, case.map.step
    head = f"ncols {COLS}\nnrows {ROWS}\nxllcorner {t.c!r}\nyllcorner {t.f - ROWS * step!r}\n"
    head += f"cellsize {step}\n"
    if case.no_data is not None:
        head += f"NODATA_value {case.no_data:g}\n"
    rows = "\n".join(" ".join(repr(float(v)) for v in row) for row in case.numbers())
    (folder / "z.asc").write_text(head + rows + "\n")
    projection = rasterio.crs.CRS.from_string(case.map.crs).to_wkt(morph_to_esri_dialect=True)
    (folder / "z.prj").write_text(projection)
    if case.unit:
        (folder / "z.prj").write_text(
            f"Projection GEOGRAPHIC\nUnits DD\nSpheroid SPHERE\nParameters\nZunits {case.unit}\n"
        )
    return folder / "z.asc"


def _netcdf(case, folder):
    t = case.transform
    kind = {"int16": "h", "float32": "f", "float64": "d"}[case.dtype]
    with netcdf_file(folder / "z.nc", "w") as file:
        file.Conventions = b"CF-1.8"
        file.createDimension("y", ROWS)
        file.createDimension("x", COLS)
        for name, first, step, count in (("y", t.f, t.e, ROWS), ("x", t.c, t.a, COLS)):
            axis = file.createVariable(name, "d", (name,))
            axis[:] = first + (np.arange(count) + 0.5) * step
            axis.units = "m"
            axis.standard_name = f"projection_{name}_coordinate"
        z = file.createVariable("z", kind, ("y", "x"))
        z[:] = case.numbers()
        z.scale_factor, z.add_offset = case.scale, case.offset
        if case.unit:
            z.units = case.unit
        if case.no_data is not None:
            setattr(z, "_FillValue", np.dtype(case.dtype).type(case.no_data))  # noqa: B010
        crs = file.createVariable("crs", "i", ())
        crs.grid_mapping_name = "unknown"
        crs.crs_wkt = rasterio.crs.CRS.from_string(case.map.crs).to_wkt()
        crs.spatial_ref = crs.crs_wkt
        z.grid_mapping = "crs"
    return folder / "z.nc"


WRITERS = {
    "GTiff": _with_rasterio, "PDS4": _with_rasterio, "ENVI": _with_rasterio, "PDS": _pds3,
    "ISIS3": _isis3, "AAIGrid": _ascii_grid, "netCDF": _netcdf,
}  # fmt: skip
