"""What asks for too much memory or time is refused at once, with the key to change."""

from __future__ import annotations

import pytest
import rasterio
import tomli_w
from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.resource_estimate import estimate
from tests.security import fuzz
from tests.worlds import TINY_FLIGHT


def call(*arguments):
    with fuzz.at_most(10.0):
        return CliRunner().invoke(main, [str(one) for one in arguments])


def test_a_terrain_of_gigabytes_is_refused(tmp_path):
    for terrain in ({"size_m": 4999.0, "posting_m": 0.25},
                    {"size_m": 4999.0, "posting_m": 5.0, "detail_m": 0.25}):  # fmt: skip
        path = tmp_path / "s.toml"
        path.write_text(tomli_w.dumps(TINY_FLIGHT | {"terrain": terrain}))
        done = call("scenario", "check", path)
        assert done.exit_code == 2, done.output
        for words in ("terrain.size_m", "54.2 GiB", "the limit is 16 GiB", "larger posting_m"):
            assert words in done.stderr
    Scenario.from_dict(TINY_FLIGHT | {"terrain": {"size_m": 2600.0, "posting_m": 0.25}})


@pytest.fixture(scope="module")
def rasters(tmp_path_factory):
    """Return a folder with two rasters of few bytes: many posts, and posts far apart."""
    folder = tmp_path_factory.mktemp("rasters")
    for name, side, step in (("large", 30_000, 1.0), ("coarse", 400, 10.0)):
        with rasterio.open(
            folder / f"{name}.tif", "w", driver="GTiff", width=side, height=side, count=1,
            dtype="float32", crs="+proj=eqc +R=1737400 +units=m", sparse_ok=True, tiled=True,
            transform=rasterio.transform.from_origin(0.0, side * step, step, step),
        ):  # fmt: skip
            pass
    assert (folder / "large.tif").stat().st_size < 1_000_000
    return folder


@pytest.mark.parametrize(
    ("terrain", "words"),
    [
        ({"path": "large.tif", "posting_m": 10.0}, ["terrain.path", "large.tif", "dtm_window"]),
        ({"path": "coarse.tif", "posting_m": 0.25}, ["terrain.posting_m:", "got 0.25", "larger"]),
        ({"path": "coarse.tif", "posting_m": 5.0, "mirrored_size_m": 90_000.0},
         ["terrain.posting_m: ", "got 5.0", "larger value"]),
    ],
)  # fmt: skip
def test_a_raster_of_gigabytes_is_refused_by_its_header(rasters, terrain, words):
    path = rasters / "s.toml"
    tables = {"terrain": {"kind": "dtm"} | terrain, "rocks": {"cover": 0.0}}
    path.write_text(tomli_w.dumps(TINY_FLIGHT | tables))
    for command in (("scenario", "check"), ("fly",)):
        done = call(*command, path)
        assert done.exit_code == 2, done.output
        for word in (*words, "the limit is 16 GiB"):
            assert word in done.stderr


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"terrain": {"size_m": 2500.0, "posting_m": 0.5},
          "rocks": {"cover": 0.2, "min_diameter_m": 0.01}},
         ["rocks.min_diameter_m: ", "got 0.01", "smaller cover"]),
        ({"moon": {}, "far_terrain": {"sizes_m": [40_000.0] * 400, "postings_m": [10.0] * 400,
                                       "rms_slopes_deg": [1.0] * 400}},
         ["far_terrain.sizes_m", "fewer levels"]),
    ],
)  # fmt: skip
def test_rocks_and_surroundings_of_gigabytes_are_refused(tmp_path, tables, words):
    path = tmp_path / "s.toml"
    path.write_text(tomli_w.dumps(TINY_FLIGHT | tables))
    done = call("scenario", "check", path)
    assert done.exit_code == 2, done.output
    for word in (*words, "the limit is 16 GiB"):
        assert word in done.stderr


def test_the_estimate_counts_a_raster(rasters):
    terrain = {"kind": "dtm", "path": "large.tif", "posting_m": 1.0}
    few, many = (
        estimate(Scenario.from_dict({"terrain": terrain | {"dtm_window": [0, n, 0, n]}}, rasters))
        for n in (1000, 2000)
    )
    # Memory for each post of the file and of the terrain, which are as many here.
    more = sum(many.memory[f"terrain.{key}"] - few.memory[f"terrain.{key}"]
               for key in ("path", "posting_m"))  # fmt: skip
    assert more == pytest.approx((32.0 + 144.0) * 3.0 * 1000.0**2, rel=0.01)
    assert many.terrain_time > 3.9 * few.terrain_time


def test_check_states_memory_and_time(tmp_path):
    done = call("scenario", "check", "golombek")
    assert done.exit_code == 0 and "estimate: about" in done.stderr, done.stderr
    small, large = (
        estimate(Scenario.from_dict(TINY_FLIGHT | {"terrain": {"size_m": side, "posting_m": 0.5}}))
        for side in (500.0, 1000.0)
    )
    assert large.terrain_time == pytest.approx(4.0 * small.terrain_time)
    more = large.memory["terrain.size_m"] - small.memory["terrain.size_m"]
    assert more == pytest.approx(144.0 * 3.0 * 1000.0**2)


@pytest.mark.parametrize("flights", [10_000_001, 10**13, 10**30])
def test_flights_without_end_are_refused(tmp_path, flights):
    arms = {"factors": {"rocks.cover": [0.0, 0.1]}}
    spec = {"name": "c", "flights": min(flights, 2**63 - 1), "scenario": TINY_FLIGHT}
    (tmp_path / "c.toml").write_text(tomli_w.dumps(spec))
    (tmp_path / "s.toml").write_text(tomli_w.dumps(TINY_FLIGHT))
    (tmp_path / "d.toml").write_text(tomli_w.dumps(spec | {"flights": 6_000_000} | arms))
    out = "--out", tmp_path / "o"
    for command in (
        ("campaign", "plan", tmp_path / "c.toml"), ("campaign", "plan", tmp_path / "d.toml"),
        ("campaign", "run", tmp_path / "c.toml", *out),
        ("sweep", tmp_path / "s.toml", "--over", "rocks.cover=0,0.1", "--flights", flights, *out),
        ("compare", tmp_path / "s.toml", "--flights", flights, *out),
        ("calibrate", tmp_path / "s.toml", "--flights", flights, "--out", tmp_path / "c.json"),
        ("evaluate", "Retarget-v1", "--agent", "zero", "--episodes", flights),
    ):  # fmt: skip
        done = call(*command)
        assert done.exit_code == 2, (command, done.output)
        assert "flights" in done.stderr or "--episodes" in done.stderr


def test_the_estimate_counts_a_raster_around_the_terrain(rasters):
    around = {"sizes_m": [2000.0], "postings_m": [10.0], "rms_slopes_deg": [1.0]}
    for extra, memory in (({}, 0.0), ({"path": "coarse.tif"}, 32.0 * 400**2)):
        tables = TINY_FLIGHT | {"moon": {}, "far_terrain": around | extra}
        assert estimate(Scenario.from_dict(tables, rasters)).memory["far_terrain.path"] == memory
    tables["far_terrain"]["path"] = "large.tif"
    with pytest.raises(
        InputError, match=r"far_terrain\.path.*the limit is 16 GiB.*\. Use a smaller raster"
    ):
        Scenario.from_dict(tables, rasters)
