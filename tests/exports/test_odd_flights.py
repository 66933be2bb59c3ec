"""Flights that end early or lack data: each format is complete, or refused in one sentence."""

from __future__ import annotations

import dataclasses
import os
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from oem import OrbitEphemerisMessage

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.exports import FORMATS, ExportOptions, export_flight
from lunarsim.onboard.policies import Decision
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight, Simulation
from tests.worlds import TINY_FLIGHT

BLIND = {
    "name": "blind",
    "simulation": {"cycle_s": 0.2},
    "terrain": {"size_m": 60.0, "posting_m": 1.0},
    "rocks": {"cover": 0.0},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix"}},
    "tasking": {},
    "mappers": {},
}


class Abort:
    """Policy that aborts at its first decision."""

    name = "abort"

    def decide(self, observation):
        """Return the decision to abort."""
        return Decision.climb_away("test")


def run(scenario, policy="no-divert"):
    return Simulation(scenario, flight_seed(2, 0), policy).run()


def blind(**tables):
    return Scenario.from_dict(BLIND | tables)


ODD = ("without scans", "aborted", "two states", "one state", "round moon", "slosh")


@cache
def odd_flight(name):
    """Return the flight with a name of `ODD`."""
    if name == "aborted":
        return run(Scenario.from_dict(TINY_FLIGHT), Abort())
    if name == "round moon":
        return run(blind(moon={"latitude_deg": -70.0}))
    if name == "slosh":
        slosh = {"tanks_m": [[0.4, 0.0, -0.3], [-0.4, 0.0, -0.3]]}
        return run(
            blind(vehicle={"kind": "jet-lander", "slosh": slosh}, control={"kind": "phase-plane"})
        )
    rows = {"two states": 2, "one state": 1}.get(name)
    return run(blind()) if rows is None else _first_rows(odd_flight("without scans"), rows)


def _first_rows(flight, rows):
    """Return a flight with only its first rows."""
    tables = {
        name: {c: v[:rows] for c, v in getattr(flight, name).items()}
        for name in ("trajectory", "navigation", "commands")
    }
    return dataclasses.replace(flight, **tables)


def output(folder, name):
    found = FORMATS[name]
    return folder / (f"flight{found.suffixes[0]}" if found.suffixes else "tables")


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("odd", ODD)
def test_each_format_is_complete_or_refused(odd, name, tmp_path):
    flight = Flight.load(odd_flight(odd).save(tmp_path / "saved"))
    out = output(tmp_path, name)
    lacks = {
        "kml": "needs the place of the site, but the scenario has no table",
        "maps": None if flight.maps else "needs hazard maps, but the record has none",
        "pointcloud": None if len(flight.scans) else "needs LiDAR scans, but the record has none",
    }
    if lacks.get(name):
        with pytest.raises(InputError, match=lacks[name]):
            export_flight(flight, name, out)
        assert not out.exists()
        return
    assert export_flight(flight, name, out) == out
    assert out.exists()
    if name == "oem":
        states = list(OrbitEphemerisMessage.open(out).segments[0])
        assert len(states) == len(flight.trajectory["time"])
    if name == "mcap":
        with out.open("rb") as file:
            assert make_reader(file).get_summary().statistics.message_count > 4


def test_a_moon_flight_in_moon_fixed_coordinates(tmp_path):
    out = tmp_path / "a.oem"
    export_flight(odd_flight("round moon"), "oem", out, ExportOptions(longitude=-120.0))
    first = next(iter(OrbitEphemerisMessage.open(out).segments[0]))
    latitude = np.rad2deg(np.arcsin(first.position[2] / np.linalg.norm(first.position)))
    longitude = np.rad2deg(np.arctan2(first.position[1], first.position[0]))
    assert (latitude, longitude) == pytest.approx((-70.0, -120.0), abs=0.2)


@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_left_of_an_export_that_fails(name, sited_flight, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        export_flight(sited_flight, name, output(tmp_path, name))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [name for name in FORMATS if FORMATS[name].suffixes])
def test_a_failure_keeps_the_file_that_was_there(name, sited_flight, tmp_path, monkeypatch):
    out = output(tmp_path, name)
    out.write_text("earlier")
    export_flight(sited_flight, name, out)
    assert out.read_bytes() != b"earlier"
    out.write_text("earlier")
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "full")))
    with pytest.raises(OSError, match="No space left"):
        export_flight(sited_flight, name, out)
    assert out.read_text() == "earlier"


@pytest.mark.parametrize("name", FORMATS)
def test_the_command_writes_each_format(name, saved_sited_flight, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["export", str(saved_sited_flight), "--format", name])
    assert done.exit_code == 0, done.output
    suffixes = FORMATS[name].suffixes
    expected = f"one{suffixes[0]}" if suffixes else f"one_{name}"
    assert [path.name for path in tmp_path.iterdir()] == [expected]
    assert done.stdout.startswith(expected)


def test_the_help_lists_the_formats():
    text = CliRunner().invoke(main, ["export", "--help"]).output
    for name, found in FORMATS.items():
        assert f"\n  {name} " in text and found.summary in text


def test_formats_that_do_not_exist(flight, tmp_path):
    with pytest.raises(InputError, match=r"--format: must be a known format, got 'ome'.*'oem'"):
        export_flight(flight, "ome", tmp_path / "a.oem")
    with pytest.raises(InputError, match="--state: must be true or estimate"):
        export_flight(flight, "oem", tmp_path / "a.oem", ExportOptions(state="both"))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"--out: must be a file name that ends in \.tif or \.ply"):
        export_flight(flight, "world", tmp_path / "a.obj")


@pytest.mark.parametrize("time", [np.nan, np.inf, 1e300, -1e300])
def test_impossible_times_are_refused(flight, tmp_path, time):
    table = {name: values.copy() for name, values in flight.commands.items()}
    table["time"][3] = time
    event = {"time": time, "name": "touchdown"}
    for changed in ({"commands": table}, {"events": [event]}):
        with pytest.raises(InputError, match="flight: must contain only times of at most 1e"):
            export_flight(dataclasses.replace(flight, **changed), "mcap", tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_a_scenario_that_is_not_toml(flight, tmp_path):
    broken = dataclasses.replace(flight, scenario="[[[")
    for name in ("oem", "aem", "matlab"):
        assert export_flight(broken, name, output(tmp_path, name)).is_file()
    for name in ("mcap", "world"):
        with pytest.raises(InputError, match="TOML"):
            export_flight(broken, name, output(tmp_path, name))
    with pytest.raises(InputError, match="TOML"):
        export_flight(broken, "oem", tmp_path / "b.oem", ExportOptions(longitude=1.0))
