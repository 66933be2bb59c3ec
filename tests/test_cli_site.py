"""`lunarsim site info`: what it prints and writes."""

from __future__ import annotations

import csv
import json
import math
import re

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from PIL import Image

from lunarsim.cli import main
from lunarsim.models.site import parse_time
from lunarsim.world.ephemeris import sky_at
from tests.worlds import ROOT, SCENARIOS

APOLLO = ["--at", "26.1322", "3.6339", "--time", "1971-07-30T22:16:29Z"]
POLE = ["--at", "-89.6", "0", "--time", "2027-03-01T12:00Z"]


def _run(*arguments):
    done = CliRunner().invoke(main, ["site", "info", *arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


def _results(folder, *arguments):
    out = _run(*arguments, "--json", str(folder / "s.json"))
    return out, json.loads((folder / "s.json").read_text())


def test_a_place_and_a_date_give_directions_and_a_month(tmp_path):
    out, found = _results(tmp_path, *APOLLO, "--sun-elevation", "5", "14")
    sky = sky_at(*np.deg2rad([26.1322, 3.6339]), np.array([parse_time("t", APOLLO[-1])]))
    assert found["sun_elevation_deg"] == pytest.approx(np.rad2deg(sky.sun_elevation[0]))
    assert found["earth_azimuth_deg"] == pytest.approx(np.rad2deg(sky.earth_azimuth[0]))
    assert found["earthshine"] == pytest.approx(sky.earthshine[0])
    assert f"elevation {found['sun_elevation_deg']:.2f} deg" in out
    assert "smooth sphere" in out
    assert found["period_hours"] == 708.0
    assert found["earth_hours"] == 708.0
    first, *others = found["landing_windows"]
    assert first["starts_before"]
    assert 1.0 < first["hours"] < 6.0  # the Sun rises by 0.46 deg per hour
    assert others
    assert out.count("landing window: ") == len(found["landing_windows"])
    assert f"{found['illuminated_hours']:.1f} h of 708.0 h" in out


def test_a_scenario_gives_place_date_and_terrain(tmp_path):
    (tmp_path / "s.toml").write_text(
        "[site]\nlatitude_deg = 26.1322\nlongitude_deg = 3.6339\ntime = 1971-07-30T22:16:29Z\n"
        "[terrain]\nsize_m = 200.0\nrms_slope_deg = 0.0\n[rocks]\ncover = 0.0\n"
    )
    scenario = str(tmp_path / "s.toml")
    out, found = _results(tmp_path, scenario)
    assert found["sun_elevation_deg"] == pytest.approx(12.027, abs=0.001)
    assert "terrain known to 0.1 to 0.1 km" in out
    later = _results(tmp_path, scenario, "--set", "site.time=1971-08-02T17:11Z", "--days", "2")[1]
    assert later["sun_elevation_deg"] == pytest.approx(41.415, abs=0.001)
    assert later["period_hours"] == 48.0


FAR = """
[site]
latitude_deg = -85.0
longitude_deg = 30.0
time = "2027-03-01T12:00Z"
[moon]
[far_terrain]
sizes_m = [8_000.0]
postings_m = [40.0]
rms_slopes_deg = [20.0]
[terrain]
size_m = 100.0
posting_m = 1.0
[rocks]
cover = 0.0
[navigation]
kind = "fixes"
[sensors.fix]
kind = "navigation-fix"
[control]
kind = "ideal"
[tasking]
[mappers]
"""


def test_far_terrain_forms_the_horizon(tmp_path):
    """The map alone is small; the hills are around it."""
    (tmp_path / "far.toml").write_text(FAR)
    (tmp_path / "map.toml").write_text(re.sub(r"\[far_terrain\]\n(.*_.*\n){3}", "", FAR))
    options = ["--range", "3", "--days", "3"]
    far, near = (_run(str(tmp_path / f"{name}.toml"), *options) for name in ("far", "map"))
    assert "terrain known to 3.0 to 3.0 km" in far
    assert "terrain known to 0.0 to 0.1 km" in near
    highest = [float(re.search(r"to (\S+) deg, terrain", text)[1]) for text in (far, near)]
    assert highest[0] > highest[1] + 3.0


def test_a_raster_hides_the_sun(tmp_path):
    """A wall in the north-east, seen from a pixel of a raster without georeferencing."""
    z = np.zeros((60, 60), np.float32)
    z[:20, 40:] = 800.0
    with rasterio.open(
        tmp_path / "wall.tif", "w", driver="GTiff", height=60, width=60, count=1, dtype="float32"
    ) as file:
        file.write(z, 1)
    raster = ["--dtm", str(tmp_path / "wall.tif"), "--posting", "100", "--pixel", "40", "20",
              "--nodata", "-1"]  # fmt: skip
    out, found = _results(tmp_path, "--at", "0", "0", "--time", "2027-03-01T12:00Z", *raster,
                          "--csv", str(tmp_path / "s.csv"))  # fmt: skip
    assert "horizon  " in out
    with (tmp_path / "s.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 709
    assert rows[0]["time_utc"] == "2027-03-01T12:00:00Z"
    hours = sum(float(row["sun_visible"]) for row in rows)
    assert hours == pytest.approx(found["illuminated_hours"], abs=1.5)
    wall = math.degrees(math.atan2(800.0, math.hypot(2_000.0, 2_000.0)))
    low = [float(row["sun_horizon_deg"]) for row in rows]
    assert max(low) < wall + 1.0
    for row in rows:
        lit, up = float(row["sun_visible"]), float(row["sun_elevation_deg"])
        above = up - float(row["sun_horizon_deg"])
        assert (lit > 0.0) == (above > -0.3) or abs(above + 0.27) < 0.3
    # Seen from the equator, the Sun stays near the east-west line, beside the wall.
    assert found["illuminated_hours"] > 340.0


def test_a_higher_observer_sees_more_of_the_sun(tmp_path):
    low = _results(tmp_path, *POLE, "--height", "0")[1]
    high = _results(tmp_path, *POLE, "--height", "500")[1]
    assert high["illuminated_hours"] > low["illuminated_hours"]
    assert high["earth_hours"] > low["earth_hours"]


def test_the_figure_shades_windows(tmp_path):
    out = _run(*APOLLO, "--sun-elevation", "5", "14", "--out", str(tmp_path / "s.png"))
    assert f"wrote {tmp_path / 's.png'}" in out.replace("\n", "")
    _run(*APOLLO, "--out", str(tmp_path / "plain.png"))
    with Image.open(tmp_path / "s.png") as shaded, Image.open(tmp_path / "plain.png") as plain:
        assert shaded.size == plain.size
        assert shaded.size[0] > 1_000
        different = np.asarray(shaded.convert("RGB")) != np.asarray(plain.convert("RGB"))
    assert 0.005 < different.any(-1).mean() < 0.2


def test_long_lists_are_cut(tmp_path):
    out, found = _results(tmp_path, "--at", "0", "0", "--time", "2027-03-01T12:00Z", "--days",
                          "400", "--step", "6")  # fmt: skip
    count = len(found["sunlit"])
    assert count == 14
    assert f"sunrise to sunset: {count - 8} more; --json lists all" in out


def test_the_shipped_ridge_is_a_raster_of_the_command(tmp_path):
    raster = SCENARIOS / "data" / "moon_shackleton_ridge_lola_40m.tif"
    assert raster.is_relative_to(ROOT)
    ridge = ["--dtm", str(raster), "--posting", "40", "--height", "10"]
    top = _results(tmp_path, *POLE, *ridge, "--pixel", "156", "54")[1]
    flank = _results(tmp_path, *POLE, *ridge)[1]
    assert top["earth_hours"] > 1.1 * flank["earth_hours"]
