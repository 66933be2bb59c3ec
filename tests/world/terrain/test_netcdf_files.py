"""Axes of netCDF files, which GDAL takes as they come."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
import xarray as xr

from lunarsim.errors import InputError
from lunarsim.world.terrain.dtm import load_terrain
from tests.world.terrain.rasters import RADIUS, SPHERE

N = 40
STEPS = np.arange(N) - 0.5 * (N - 1)
EAST, NORTH = np.meshgrid(STEPS, STEPS[::-1])
PEAK = np.exp(-((EAST - 8.5) ** 2 + (NORTH - 6.5) ** 2) / 20.0)
EQUIRECTANGULAR = f"+proj=eqc +units=m {SPHERE}"
POLAR = {
    "grid_mapping_name": "polar_stereographic", "latitude_of_projection_origin": -90.0,
    "straight_vertical_longitude_from_pole": 0.0, "standard_parallel": -90.0,
    "semi_major_axis": RADIUS, "inverse_flattening": 0.0,
}  # fmt: skip
UNKNOWN = {"grid_mapping_name": "oblique_something", "semi_major_axis": RADIUS}


def write(path, x=STEPS, y=STEPS[::-1], *, z=PEAK, dims=("y", "x"), unit="m", crs=EQUIRECTANGULAR,
          engine="h5netcdf", **attributes):  # fmt: skip
    mapping = crs
    if isinstance(crs, str):
        mapping = {"crs_wkt": rasterio.crs.CRS.from_string(crs).to_wkt()}
    axes = {
        name: (name, places, {"units": unit, "standard_name": f"projection_{name}_coordinate"})
        for name, places in (("x", x), ("y", y))
    }
    ends = {"grid_mapping": "crs"} | attributes
    file = xr.Dataset({"z": (dims, z, ends), "crs": ((), 0, mapping)}, coords=axes)
    file.to_netcdf(path, engine=engine)
    return path


def peak(path):
    loaded = load_terrain(path)
    return loaded.grid.centre_of(*np.unravel_index(loaded.z.argmax(), loaded.z.shape))


@pytest.mark.parametrize(
    "change",
    [{}, {"y": STEPS, "z": PEAK[::-1]}, {"x": STEPS[::-1], "z": PEAK[:, ::-1]},
     {"engine": "scipy"}, {"crs": POLAR},
     {"crs": POLAR, "unit": "km", "x": STEPS / 1e3, "y": STEPS[::-1] / 1e3},
     {"crs": f"+proj=eqc +units=km {SPHERE}", "unit": "km", "x": STEPS / 1e3,
      "y": STEPS[::-1] / 1e3},
     {"x": (1e5 + STEPS).astype("f4")}],
    ids=["plain", "y up", "x down", "classic", "polar", "polar in km", "km", "float32"],
)  # fmt: skip
def test_axes_place_the_posts(tmp_path, change):
    assert peak(write(tmp_path / "z.nc", **change)) == pytest.approx([8.5, 6.5], abs=0.1)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"dims": ("x", "y"), "z": PEAK.T}, r"\(x, y\).*ncpdq -a y,x"),
     ({"unit": "km", "x": STEPS / 1e3, "y": STEPS[::-1] / 1e3}, "in 'km'.*metre"),
     ({"crs": UNKNOWN}, "crs_wkt"),
     ({"crs": f"+proj=longlat {SPHERE}", "unit": "radian", "x": STEPS / 1e4,
       "y": STEPS[::-1] / 1e4}, "in 'radian'.*degree"),
     ({"y": STEPS[::-1] + 0.3 * np.cos(STEPS)}, "'y' that is not evenly spaced"),
     ({"x": STEPS * np.abs(STEPS)}, "'x' that is not evenly spaced"),
     ({"positive": "down"}, "increase upwards, not depths")],
    ids=["order", "km", "unknown mapping", "radians", "jitter", "stretched", "depth"],
)  # fmt: skip
def test_other_axes_are_refused(tmp_path, change, words):
    with pytest.raises(InputError, match=words):
        load_terrain(write(tmp_path / "z.nc", **change))


def test_longitudes_that_start_again_within_the_raster(tmp_path):
    crs = f"+proj=longlat {SPHERE}"
    for x in (STEPS * 1e-3 % 360.0, (STEPS * 1e-3 + 360.0) % 360.0 - 180.0):
        path = write(tmp_path / "z.nc", x, 1e-3 * STEPS[::-1], crs=crs, unit="degrees_east")
        assert peak(path) == pytest.approx(np.radians([8.5e-3, 6.5e-3]) * RADIUS, abs=20.0)


def test_longitudes_that_count_west_are_refused(tmp_path):
    path = write(tmp_path / "z.nc", 1e-3 * STEPS, 1e-3 * STEPS[::-1], crs="IAU_2015:49901",
                 unit="degrees")  # fmt: skip
    with pytest.raises(InputError, match="increase to the west or south"):
        load_terrain(path)


@pytest.mark.parametrize(
    ("names", "attributes"),
    [("xy", {}), ("ab", {"axis": "XY"}),
     ("ab", {"standard_name": ("projection_x_coordinate", "projection_y_coordinate")})],
)  # fmt: skip
def test_the_direction_of_an_axis_is_its_name_or_attribute(tmp_path, names, attributes):
    axes = {
        name: (name, places, {key: value[number] for key, value in attributes.items()})
        for number, (name, places) in enumerate(zip(names, (STEPS, STEPS[::-1]), strict=True))
    }
    path = tmp_path / "z.nc"
    xr.Dataset({"z": (tuple(names), PEAK.T)}, coords=axes).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match="rows must be northings"):
        load_terrain(path, posting=1.0)
