"""Rocks at given places from CSV files."""

from __future__ import annotations

import os

import numpy as np
import pandas as pd
import pytest

from lunarsim.errors import InputError
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.rocks.rock_file import load_rocks
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.worlds import build_world, rebuild_world
from tests.worlds import TINY_FLIGHT

ROCKS = pd.DataFrame(
    {
        "x (m)": [3.0, -5.5, 10.25], "y (m)": [-2.0, 7.0, 12.0], "diameter (m)": [1.2, 0.5, 2.0],
        "height (m)": [0.4, np.nan, 1.5],
    }
)  # fmt: skip


def world(tmp_path, rocks=ROCKS, **tables):
    rocks.to_csv(tmp_path / "rocks.csv", index=False, na_rep="nan")
    table = {"path": str(tmp_path / "rocks.csv")} | tables
    return Scenario.from_dict({"terrain": {"size_m": 60.0}, "rocks": table})


def built(scenario, seed=1):
    return build_world(scenario, RandomStreams(flight_seed(seed, 0))).terrain


@pytest.mark.parametrize("shape", ["hemisphere", "ellipsoid", "cube", "irregular", "mixed"])
def test_rocks_stand_where_they_are_given(tmp_path, shape):
    terrain = built(world(tmp_path, shape=shape))
    np.testing.assert_array_equal(terrain.rocks.x, ROCKS["x (m)"])
    np.testing.assert_array_equal(terrain.rocks.y, ROCKS["y (m)"])
    # The exposed height is that above the relief under the centre.
    centres = ROCKS[["x (m)", "y (m)"]].to_numpy()
    bare = type(terrain)(terrain.relief).elevation(centres)
    top = terrain.rocks.base + terrain.rocks.height - bare
    assert top[[0, 2]] == pytest.approx([0.4, 1.5], abs=1e-9)
    assert top[1] > 0.05
    assert (terrain.elevation(centres) > bare).all()


def test_an_outline_has_the_given_diameter(tmp_path):
    terrain = built(world(tmp_path))
    for (x, y), diameter in zip(((3.0, -2.0), (10.25, 12.0)), (1.2, 2.0), strict=True):
        bare = type(terrain)(terrain.relief)
        along = np.column_stack((np.linspace(x - 3, x + 3, 6001), np.full(6001, y)))
        covered = terrain.elevation(along) > bare.elevation(along) + 1e-4
        assert covered.sum() * 1e-3 == pytest.approx(diameter, rel=0.1)


def test_flights_with_given_rocks_have_the_same_rocks_and_their_record_too(tmp_path):
    rocks = {"path": world(tmp_path).rocks.path}
    scenario = Scenario.from_dict(TINY_FLIGHT).changed(rocks=rocks, simulation={"max_time_s": 1.0})
    flight = Simulation(scenario, flight_seed(5, 1), "no-divert").run()
    again = rebuild_world(flight).terrain
    np.testing.assert_array_equal(again.rocks.x, ROCKS["x (m)"])
    assert len(built(scenario, 2).rocks) == len(built(scenario, 3).rocks) == 3


def test_a_path_is_relative_to_the_scenario_file(tmp_path):
    ROCKS.to_csv(tmp_path / "rocks.csv", index=False, na_rep="nan")
    (tmp_path / "a.toml").write_text('[rocks]\npath = "rocks.csv"\n')
    assert len(built(Scenario.load(tmp_path / "a.toml")).rocks) == 3


def test_the_height_may_be_absent_and_columns_in_any_order(tmp_path):
    rocks = ROCKS[["diameter (m)", "y (m)", "x (m)"]].assign(name="boulder")
    rocks.to_csv(tmp_path / "rocks.csv", index=False)
    found = load_rocks(tmp_path / "rocks.csv")
    np.testing.assert_array_equal(found.x, ROCKS["x (m)"])
    assert np.isnan(found.height).all()


def test_empty_cells_of_heights_and_empty_rows(tmp_path):
    text = "x (m),y (m),diameter (m),height (m)\n1,2,3,\n,,,\n\n4,5,6,2\n"
    (tmp_path / "rocks.csv").write_text(text)
    found = load_rocks(tmp_path / "rocks.csv")
    np.testing.assert_array_equal(found.x, [1.0, 4.0])
    np.testing.assert_array_equal(found.height, [np.nan, 2.0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"no column 'x \(m\)'"),
        ("x (m),y (m)\n1,2\n", r"no column 'diameter \(m\)'"),
        ("x (m),y (m),diameter (cm)\n1,2,3\n", "has the unit 'cm', not 'm'"),
        ("x,y,diameter\n1,2,3\n", r"no column 'x \(m\)'"),
        ("x (m),y (m),diameter (m)\n1,2\n", "line 2 has a value that is not a number"),
        ("x (m),y (m),diameter (m)\n1,2,big\n", "line 2 has a value that is not a number"),
        ("x (m),y (m),diameter (m)\n1,nan,3\n", r"finite coordinates(?s:.*)because\s+rock 1 has"),
        ("x (m),x (m),y (m),diameter (m)\n1,2,3,1\n", "more than one column 'x'"),
        ("x (m),y (m),diameter (m)\n,2,3\n", "finite coordinates"),
        ("x (m),y (m),diameter (m)\n1,2,0\n", "diameter between 0.01 and 100 m"),
        ("x (m),y (m),diameter (m)\n1,2,nan\n", "diameter between 0.01 and 100 m"),
        ("x (m),y (m),diameter (m),height (m)\n1,2,3,-1\n", "positive height"),
        ("x (m),y (m),diameter (m)\n0,0,1\n500,0,1\n", r"1 of 2 are\s+not on it"),
        ('x (m),y (m),diameter (m)\n"1,2,3\n', "is not CSV"),
    ],
)
def test_bad_files_are_refused(tmp_path, text, words):
    (tmp_path / "rocks.csv").write_text(text)
    with pytest.raises(InputError, match=rf"rocks\.path: (?s:.*)({words})"):
        built(Scenario.from_dict({"rocks": {"path": str(tmp_path / "rocks.csv")}}))


def test_files_of_strangers(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "long.csv").write_text("x (m),y (m),diameter (m)\n" + "1,2,3\n" * 12)
    monkeypatch.setattr("lunarsim.csv_columns.MAX_ROWS", 10)
    for name, words in (
        ("gone.csv", "existing file"), ("pipe.csv", "existing file"), (".", "existing file"),
        ("bytes.csv", "not text in UTF-8"), ("long.csv", "more than 10 rows"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            load_rocks(tmp_path / name)
