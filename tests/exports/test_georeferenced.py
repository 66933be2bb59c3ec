"""KML and GeoTIFF on the Moon: other readers find the places that spherical formulas give."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pyogrio
import pytest
import rasterio
from click.testing import CliRunner
from rasterio.crs import CRS
from rasterio.warp import transform

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.exports import ExportOptions, export_flight
from tests.exports.tables import columns

RADIUS = 1_737_400.0
PLACE = (-43.25, 179.9999)
POLE = (-90.0, 30.0)


def at(flight, latitude, longitude, tables=""):
    """Return a flight at another place, deg, with more tables."""
    scenario = flight.scenario.split("\n[site]")[0]
    site = f"\n[site]\nlatitude_deg = {latitude}\nlongitude_deg = {longitude}\n"
    return replace(flight, scenario=scenario + site + tables)


def on_sphere(place, position, radius=RADIUS):
    """Return longitude, latitude (deg) and distance from the centre (m) of ENU points (n, 3).

    The point lies at the arc `c` from the site in the azimuth `a`: spherical law of cosines.
    """
    lat0, lon0 = np.deg2rad(place)
    east, north, up = np.asarray(position, float).T
    side = np.hypot(east, north)
    c, a = np.arctan2(side, radius + up), np.arctan2(east, north)
    lat = np.arcsin(np.sin(lat0) * np.cos(c) + np.cos(lat0) * np.sin(c) * np.cos(a))
    lon = lon0 + np.arctan2(
        np.sin(a) * np.sin(c) * np.cos(lat0), np.cos(c) - np.sin(lat0) * np.sin(lat)
    )
    if abs(place[0]) == 90.0:
        lon = lon0 + np.arctan2(east, -np.sign(lat0) * north)
    return np.rad2deg(lon), np.rad2deg(lat), np.hypot(side, radius + up)


def check_places(found, place, position, radius=RADIUS, tolerance=1e-3):
    """Compare longitude, latitude (deg) and altitude (n, 3) with ENU points (n, 3)."""
    lon, lat, distance = on_sphere(place, position, radius)
    turn = (found[:, 0] - lon + 180.0) % 360.0 - 180.0
    east = np.deg2rad(turn) * np.cos(np.deg2rad(lat)) * RADIUS
    assert np.abs(east).max() < tolerance
    assert np.abs(np.deg2rad(found[:, 1] - lat) * RADIUS).max() < tolerance
    assert np.abs(found[:, 2] - (distance - RADIUS)).max() < tolerance
    assert np.abs(found[:, 0]).max() <= 180.0


def coordinates_of(wkb):
    """Return the coordinates (n, 3) of a point (type 1) or a line with a count, as GDAL's WKB."""
    start = 5 if wkb[1] == 1 else 9
    return np.frombuffer(wkb[start:], "<f8").reshape(-1, 3)


def read_kml(path):
    """Return the coordinates (n, 3) of each feature by name, read by GDAL."""
    meta, _, shapes, fields = pyogrio.raw.read(path)
    names = fields[list(meta["fields"]).index("Name")]
    return {name: coordinates_of(shape) for name, shape in zip(names, shapes, strict=True)}


@pytest.mark.parametrize("place", [PLACE, (12.5, 0.0), (0.0, 359.5), POLE, (90.0, -75.0)])
def test_kml_has_the_path_and_the_sites(sited_flight, tmp_path, place):
    flight = at(sited_flight, *place)
    found = read_kml(export_flight(flight, "kml", tmp_path / "a.kml"))
    path = columns(flight.trajectory, "position")
    check_places(found.pop("path"), place, path)
    expected = {"start": path[0], "planned target": flight.target,
                "touchdown": flight.outcome.touchdown.position}  # fmt: skip
    for one in flight.decisions:
        expected[f"site chosen at {one['time']:.1f} s"] = np.array(one["to"]) - flight.map_error
    assert flight.decisions and set(found) == set(expected)
    for name, position in expected.items():
        check_places(found[name], place, position[None])


def test_kml_of_the_estimate(sited_flight, tmp_path):
    options = ExportOptions(state="estimate")
    path = export_flight(sited_flight, "kml", tmp_path / "a.kml", options)
    found = read_kml(path)["path"]
    check_places(found, PLACE, columns(sited_flight.navigation, "position"))
    assert "estimated by navigation" in path.read_text()


def test_kml_states_its_body_and_its_altitudes(sited_flight, tmp_path):
    path = export_flight(sited_flight, "kml", tmp_path / "a.kml")
    root = ET.parse(path).getroot()
    name = "{http://www.opengis.net/kml/2.2}"
    assert root.tag == f"{name}kml" and root.get("hint") == "target=moon"
    note = root.find(f"{name}Document/{name}description").text
    for words in ("the Moon, not the Earth", "Planetocentric", "sphere of 1737400 m", "True path"):
        assert words in note
    modes = [mode.text for mode in root.iter(f"{name}altitudeMode")]
    assert set(modes) == {"absolute"} and len(modes) == len(read_kml(path))


@pytest.mark.parametrize("with_site", [True, False])
def test_kml_with_the_radius_of_the_moon_table(sited_flight, tmp_path, with_site):
    """The frame is that of OEM: its origin is at moon.radius_m."""
    moon = "\n[moon]\nradius_m = 1736000.0\nlatitude_deg = -43.25\n"
    flight = at(sited_flight, *PLACE, moon)
    options = ExportOptions()
    if not with_site:
        flight = replace(flight, scenario=flight.scenario.split("\n[site]")[0] + moon)
        options = ExportOptions(longitude=PLACE[1])
    found = read_kml(export_flight(flight, "kml", tmp_path / "a.kml", options))
    check_places(found["path"], PLACE, columns(flight.trajectory, "position"), 1_736_000.0)


@pytest.mark.parametrize("offset", [-1926.5, RADIUS - 1926.5])
def test_kml_over_measured_terrain_has_altitudes_above_the_sphere(sited_flight, tmp_path, offset):
    """Heights, or distances from the centre, in the raster have a mean that is not 0."""
    z = np.arange(900.0).reshape(30, 30) * 0.01 + offset
    with rasterio.open(
        tmp_path / "z.tif", "w", driver="GTiff", width=30, height=30, count=1, dtype="float64",
        crs=CRS.from_proj4(f"+proj=aeqd +lat_0=-43.25 +lon_0=179.9999 +R={RADIUS}"),
        transform=rasterio.Affine(2.0, 0.0, -30.0, 0.0, -2.0, 30.0),
    ) as file:  # fmt: skip
        file.write(z, 1)
    terrain = f'\n[terrain]\nkind = "dtm"\npath = "{tmp_path / "z.tif"}"\n'
    flight = replace(
        sited_flight, scenario=f"name = 'a'\n[site]\nlatitude_deg = {PLACE[0]}\n"
        f"longitude_deg = {PLACE[1]}\n{terrain}",
    )  # fmt: skip
    found = read_kml(export_flight(flight, "kml", tmp_path / "a.kml"))
    height = z.mean() - (RADIUS if offset > 0.0 else 0.0)
    position = columns(flight.trajectory, "position")
    check_places(found["path"], PLACE, position, RADIUS + height)


def test_kml_needs_a_place(flight, tmp_path):
    with pytest.raises(InputError, match=r"--format: needs the place of the site.*site\.latitude"):
        export_flight(flight, "kml", tmp_path / "a.kml")
    with pytest.raises(InputError, match=r"--longitude: must be omitted"):
        export_flight(flight, "kml", tmp_path / "a.kml", ExportOptions(longitude=5.0))
    assert not list(tmp_path.iterdir())


def check_map_places(file, place):
    """Check where the cells of a GeoTIFF lie, by arcs and azimuths about the site."""
    assert file.crs.is_projected and "Moon" in file.crs.to_wkt()
    assert file.crs.to_dict()["proj"] == "aeqd" and file.crs.to_dict()["R"] == RADIUS
    row, col = (v.ravel() for v in np.mgrid[0 : file.height : 7, 0 : file.width : 7])
    x, y = (np.array(v) for v in file.xy(row, col))
    globe = CRS.from_proj4(f"+proj=longlat +R={RADIUS}")
    found = np.array(transform(file.crs, globe, x, y)).T
    arc, azimuth = np.hypot(x, y) / RADIUS, np.arctan2(x, y)
    # The point of the plane of the site below the point of the sphere in this direction.
    side = RADIUS * np.tan(arc)
    plane = np.column_stack((side * np.sin(azimuth), side * np.cos(azimuth), 0.0 * side))
    lon, lat, _ = on_sphere(place, plane)
    turn = (found[:, 0] - lon + 180.0) % 360.0 - 180.0
    assert np.abs(np.deg2rad(turn) * np.cos(np.deg2rad(lat)) * RADIUS).max() < 0.01
    assert np.abs(np.deg2rad(found[:, 1] - lat) * RADIUS).max() < 0.01
    return x, y, row, col


@pytest.mark.parametrize("place", [PLACE, (0.0, 0.0), POLE])
def test_maps_lie_on_the_moon(sited_flight, tmp_path, place):
    flight = at(sited_flight, *place)
    out = export_flight(flight, "maps", tmp_path / "maps")
    assert {p.stem for p in out.iterdir()} == set(flight.maps)
    record = flight.maps["dem"]
    with rasterio.open(out / "dem.tif") as file:
        x, y, row, col = check_map_places(file, place)
        assert file.descriptions[0] == "p_safe" and file.units == ("1", "m")
        p_safe, elevation = (file.read(k)[row, col] for k in (1, 2))
    cells = np.column_stack((x, y)) + record.error[:2]
    grid, found = record.hazard_map.grid, record.hazard_map
    i = np.rint((cells[:, 1] - grid.y0) / grid.posting).astype(int)
    j = np.rint((cells[:, 0] - grid.x0) / grid.posting).astype(int)
    assert np.abs(cells[:, 0] - grid.x0 - j * grid.posting).max() < 1e-6
    assert np.abs(cells[:, 1] - grid.y0 - i * grid.posting).max() < 1e-6
    seen = found.observed[i, j]
    assert seen.any() and not seen.all()
    np.testing.assert_array_equal(p_safe[seen], found.p_safe[i, j][seen])
    assert np.isnan(p_safe[~seen]).all()
    np.testing.assert_allclose(elevation, found.elevation[i, j] - record.error[2], atol=1e-5)


def test_maps_without_a_place_have_a_local_reference(flight, tmp_path):
    out = export_flight(flight, "maps", tmp_path / "maps")
    with rasterio.open(out / "dem.tif") as file:
        assert file.crs.to_wkt().startswith('LOCAL_CS["lunarsim site frame, ENU"')


def test_maps_with_a_given_longitude(flight, tmp_path):
    moon = replace(flight, scenario=flight.scenario + "\n[moon]\nlatitude_deg = 20.0\n")
    out = export_flight(moon, "maps", tmp_path / "maps", ExportOptions(longitude=-60.0))
    with rasterio.open(out / "dem.tif") as file:
        check_map_places(file, (20.0, -60.0))


def test_a_flight_without_maps_is_refused(flight, tmp_path):
    with pytest.raises(InputError, match="--format: needs hazard maps, but the record has none"):
        export_flight(replace(flight, maps={}), "maps", tmp_path / "maps")
    assert not list(tmp_path.iterdir())


def test_the_world_lies_on_the_moon(sited_flight, flight, tmp_path):
    with rasterio.open(export_flight(sited_flight, "world", tmp_path / "a.tif")) as file:
        check_map_places(file, PLACE)
        placed = file.read(1)
    with rasterio.open(export_flight(flight, "world", tmp_path / "b.tif")) as file:
        np.testing.assert_array_equal(file.read(1), placed)


def test_terrain_export_places_a_scenario_with_a_site(sited_flight, tmp_path):
    (tmp_path / "a.toml").write_text(sited_flight.scenario)
    out = tmp_path / "a.tif"
    done = CliRunner().invoke(
        main, ["terrain", "export", str(tmp_path / "a.toml"), "--out", str(out)]
    )
    assert done.exit_code == 0, done.output
    with rasterio.open(out) as file:
        check_map_places(file, PLACE)
