"""`lunarsim calibrate`, from the flights to a map that uses what was fitted."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.campaign import calibrate as campaign
from lunarsim.campaign.calibrate import calibrate, gaussian_mapper
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.scenario_calibration import ScenarioCalibration
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import dem_site_evidence
from lunarsim.rng import calibration_seed, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

DEM = {"kind": "gaussian-dem", "posting_m": 0.5, "size_m": 40.0}
TABLES = {
    "name": "tiny",
    "terrain": {"size_m": 60.0, "rms_slope_deg": 6.0},
    "rocks": {"cover": 0.05, "min_diameter_m": 0.4},
    "target": {"scatter_m": [8.0, 8.0]},
    "sensors": {
        "imu": {"kind": "imu"},
        "fix": {"kind": "navigation-fix"},
        "flash": {"kind": "flash-lidar", "rows": 64, "cols": 64},
    },
    "mappers": {"dem": DEM},
}


def run(*args: object):
    return CliRunner().invoke(main, ["calibrate", *map(str, args)])


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.from_dict(TABLES)


@pytest.fixture(scope="module")
def done(scenario, tmp_path_factory):
    """Return what the command printed, the file and the scenario's file."""
    folder = tmp_path_factory.mktemp("calibrate")
    scenario.save(folder / "tiny.toml")
    out = folder / "c.json"
    result = run(folder / "tiny.toml", "--flights", 2, "--sites", 150, "--jobs", 1, "--out", out)
    assert result.exit_code == 0, result.output
    return result.output, out, folder / "tiny.toml"


def test_the_command_prints_a_table_and_writes_the_file(done):
    output, out, _ = done
    found = ScenarioCalibration.load(out)
    assert (found.scenario, found.mapper, found.flights, found.seed) == ("tiny", "dem", 2, 1)
    # Two scans, so two maps, a flight.
    assert found.sites == 600
    assert f"{found.sites} sites on 4 maps of 2 flights" in output
    assert len(re.findall(r"│ (packaged|refit) +│ (packaged|refit)", output)) == 4
    assert "In the refit domain the refit is" in output
    assert "on held-out flights" in output.replace("\n", " ")
    assert set(found.after) == {"packaged_domain", "refit_domain"}
    assert sorted(p.name for p in out.parent.iterdir()) == ["c.json", "tiny.toml"]


def test_two_processes_and_a_calibration_in_use_give_the_same(scenario, done):
    _, out, _ = done
    used = scenario.changed(mappers={"dem": {"calibration_path": str(out)}})
    counted: list[int] = []
    again = calibrate(used, flights=2, seed=1, sites=150, jobs=2, progress=counted.append)
    assert again.calibration == ScenarioCalibration.load(out)
    assert counted == [1, 1]


def test_no_comparison_flies_what_was_fitted():
    keys = {tuple(f(s, i).generate_state(4)) for f in (flight_seed, calibration_seed)
            for s in range(3) for i in range(5)}  # fmt: skip
    assert len(keys) == 30


def test_a_flight_uses_it(scenario, done):
    _, out, toml = done
    toml.with_name("used.toml").write_text(
        toml.read_text().replace("[mappers.dem]", '[mappers.dem]\ncalibration_path = "c.json"')
    )
    used = Scenario.load(toml.with_name("used.toml"))
    assert Path(used.mappers["dem"].calibration_path) == out
    maps = []
    for one in (scenario, used):
        simulation = Simulation(one, 5, "no-divert")
        while simulation.altitude > 130.0 or not simulation.decision_due:
            simulation.step()
        maps.append(simulation.computer.mapper)
    plain, refitted = maps
    evidence = dem_site_evidence(plain.dem(), plain.lander, plain.rocks)
    p, known = calibrated_safety(evidence, refit=ScenarioCalibration.load(out))
    assert np.array_equal(refitted.hazard_map().p_safe, p)
    assert np.array_equal(refitted.hazard_map().in_domain, known)
    assert known.any()
    assert np.abs(plain.hazard_map().p_safe - p).max() > 0.1


def test_a_calibration_that_does_not_fit_is_refused(scenario, done, tmp_path):
    _, out, _ = done
    own = {"dem": {"calibration_path": str(out)}}
    with pytest.raises(InputError, match=r"vehicle\.leg_radius_m: .*2\.35"):
        Simulation(scenario.changed(mappers=own, vehicle={"leg_radius_m": 1.8}), 1, "safest")
    for path, says in (("gone.json", "does not exist"), ("tiny.toml", "JSON")):
        given = tmp_path / path
        if path == "tiny.toml":
            given.write_text("x = 1")
        with pytest.raises(InputError, match=rf"mappers\.dem\.calibration_path.*{says}"):
            scenario.changed(mappers={"dem": {"calibration_path": str(given)}})
    data = json.loads(out.read_text())
    (tmp_path / "old.json").write_text(json.dumps(data | {"regression": "0" * 16}))
    with pytest.raises(InputError, match=r"mappers\.dem\.calibration_path.*regression"):
        scenario.changed(mappers={"dem": {"calibration_path": str(tmp_path / "old.json")}})
    with pytest.raises(InputError, match=r"mappers\.dem\.calibration_path.*safety is 'level'"):
        scenario.changed(mappers={"dem": own["dem"] | {"safety": "level"}})


@pytest.mark.parametrize(
    ("tables", "options", "says"),
    [
        ({"mappers": {"dem": DEM | {"safety": "level"}}}, [], r"mappers.dem.safety: must be"),
        ({"mappers": {"q": {"kind": "quadtree"}}}, [], "a mapper of kind 'gaussian-dem'"),
        (
            {"mappers": {"q": {"kind": "quadtree"}, "dem": DEM}},
            ["--mapper", "q"],
            "Mappers of this kind: dem",
        ),
        ({}, ["--mapper", "other"], "Mappers of this kind: dem"),
        ({}, ["--flights", "1"], "2 or more"),
        ({}, ["--sites", "0"], "1 or more"),
        ({}, ["--jobs", "0"], "1 or more"),
        ({}, ["--out", "c.txt"], "ends in .json"),
        ({}, ["--out", "gone/c.json"], "existing folder"),
    ],
)
def test_mistakes_end_with_code_2_and_write_nothing(tmp_path, monkeypatch, tables, options, says):
    monkeypatch.chdir(tmp_path)
    Scenario.from_dict(TABLES | tables).save("s.toml")
    result = run("s.toml", "--out", "c.json", *options)
    assert result.exit_code == 2, result.output
    assert says in result.output.replace("\n", "")
    assert [p.name for p in tmp_path.iterdir()] == ["s.toml"]


def test_which_mapper_is_meant():
    two = {"a": DEM, "b": DEM, "q": {"kind": "quadtree"}}
    assert gaussian_mapper(Scenario.from_dict(TABLES | {"mappers": two})) == "a"
    decides = TABLES | {"mappers": two, "decisions": {"map": "b"}}
    assert gaussian_mapper(Scenario.from_dict(decides)) == "b"
    decides = Scenario.from_dict(TABLES | {"mappers": two, "decisions": {"map": "q"}})
    with pytest.raises(InputError, match=r"several mappers of kind 'gaussian-dem' .a, b."):
        gaussian_mapper(decides)
    assert gaussian_mapper(decides, "b") == "b"
    one = TABLES | {"mappers": {"q": {"kind": "quadtree"}, "b": DEM}}
    assert gaussian_mapper(Scenario.from_dict(one)) == "b"


def test_a_file_that_is_there_is_kept_unless_asked(done):
    _, out, toml = done
    old = out.read_bytes()
    result = run(toml, "--out", out)
    assert result.exit_code == 2
    assert "--force" in result.output
    assert out.read_bytes() == old


def test_an_interrupt_writes_nothing(done, tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(campaign, "iterate_results", stop)
    _, _, toml = done
    result = run(toml, "--out", tmp_path / "c.json")
    assert result.exit_code == 130
    assert "no file was written" in result.output
    assert not list(tmp_path.iterdir())


def test_terrain_that_is_all_alike_is_an_error(tmp_path):
    flat = TABLES | {"terrain": {"size_m": 60.0, "rms_slope_deg": 0.0}, "rocks": {"cover": 0.0}}
    Scenario.from_dict(flat).save(tmp_path / "flat.toml")
    out = tmp_path / "c.json"
    result = run(tmp_path / "flat.toml", "--flights", 2, "--sites", 30, "--jobs", 1, "--out", out)
    assert result.exit_code == 2, result.output
    assert "safe and 20 unsafe" in result.output.replace("\n", "")
    assert not out.exists()
