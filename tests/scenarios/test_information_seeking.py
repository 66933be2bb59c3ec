"""Information-seeking study: metrics from synthetic flights, and one flight."""

from __future__ import annotations

import numpy as np
import pytest
from rich.console import Console

from lunarsim import flight_seed
from lunarsim.studies import Case, Report, report_study, run_study


@pytest.fixture
def study(script):
    return script(".", "information_seeking")


def made(study, clear, propellant=8.0, known=100.0):
    level = {
        "known_m2": known, "known_in_reach_m2": 0.5 * known, "safe_m2": 400.0, "in_reach_m2": 900.0,
        "unsafe_called_safe": 1, "unsafe": 50, "place": [30.0, 40.0, 100.0],
        "recall_at_099": clear,
    }  # fmt: skip
    levels = {f"{h:g}": dict(level) for h in study.ALTITUDES}
    levels[study.LAST] |= {"clear": clear, "hazards": 60, "hazards_clear": 1}
    ground = {"azimuth": 10.0, "elevation": 20.0, "slope": 0.0, "cover": 0.05}
    return {
        "ground": ground, "levels": levels, "propellant": propellant, "duration": 50.0,
        "landed": True, "safe": True, "fallbacks": 0, "plans": 9,
    }  # fmt: skip


def test_paths_are_compared_per_field(study):
    clear = {"nominal": (0.2, 0.4), "modified": (0.6, 0.9), "seeking": (0.7, 0.8)}
    rows = [{p: made(study, v[k]) for p, v in clear.items()} for k in range(2)]
    line = study.compare_paths(rows)["clear cells classified as clear"]
    assert line["seeking"].startswith("0.750")
    assert line["seeking - nominal"].startswith("0.450")
    assert line["seeking - modified"].startswith("0.000")
    assert study.compare_paths(rows)["safe sites known"]["seeking"].startswith("0.250")
    known = study.compare_paths(rows)["safe sites known and reachable"]
    assert known["seeking"].startswith("0.125")
    console = Console(record=True, width=150)
    report = Report([], ["sensors"], "fields", {}, False, {}, 1, console)
    study.show("camera", rows, report)
    study.show_losses(rows, report)
    told = console.export_text()
    assert "Worse than modified in 1 of 2" in told
    assert "Worse than nominal in 0 of 2" in told
    assert "2 of 120" in told
    assert "better than modified in 1 of 2 fields, median +0.000" in told
    assert told.count("not significantly positive") == 2


def test_difference_is_significant_if_its_interval_is_above_zero(study):
    few = [{p: made(study, v) for p, v in row.items()} for row in (
        {"nominal": 0.20, "modified": 0.60, "seeking": 0.70},
        {"nominal": 0.22, "modified": 0.80, "seeking": 0.71},
        {"nominal": 0.19, "modified": 0.50, "seeking": 0.69},
    )]  # fmt: skip
    assert "mean difference significantly positive" in study.paired_test_text(few, "nominal")
    assert "mean difference not significantly positive" in study.paired_test_text(few, "modified")
    # A NaN metric excludes its field.
    few[0]["seeking"]["levels"][study.LAST]["clear"] = float("nan")
    assert "in 2 of 2 fields" in study.paired_test_text(few, "nominal")


def test_field_counts_if_all_paths_have_flown_it(study):
    rows = [made(study, 0.5) | {"number": k, "path": p} for k in range(2) for p in study.PATHS]
    assert len(study.complete_fields(rows)) == 2
    assert len(study.complete_fields(rows[:5])) == 1
    del rows[0]["levels"][study.LAST]
    assert study.complete_fields(rows[:5]) == []


def test_sobol_points_lie_within_their_bounds(study):
    points = study.sample_conditions(60, 3)
    assert len(set(points)) == 60
    assert points == study.sample_conditions(60, 3)
    assert points != study.sample_conditions(60, 4)
    assert [study.sample_conditions(n + 1, 3)[-1] for n in range(60)] == points
    rows = np.array([(g.azimuth, g.elevation, g.slope, g.cover) for g in points])
    assert (rows >= [0.0, 5.0, 0.0, 0.02]).all()
    assert (rows <= [360.0, 40.0, 4.0, 0.15]).all()
    assert (np.ptp(rows, axis=0) > 0.9 * np.array([360.0, 35.0, 4.0, 0.13])).all()


def test_paths_of_a_field_share_conditions_and_seed(study, tmp_path, monkeypatch, capsys):
    flown = []

    def fly(path, sensors, conditions, seed):
        flown.append((path, sensors, conditions, str(seed)))
        return made(study, 0.5) | {"path": path}

    monkeypatch.setattr(study, "fly", fly)
    options = {"sobol": True}
    rows = run_study(study.study, count=2, levels={"sensors": ["camera"]}, options=options)
    assert [(r["number"], r["path"]) for r in rows] == [
        (k, p) for k in range(2) for p in study.PATHS
    ]
    assert [f[2] for f in flown[::3]] == study.sample_conditions(2, 1)
    assert {f[2:] for f in flown[:3]} == {flown[0][2:]}
    study.fly_paths(Case({"sensors": "lidar"}, 0, 1, {"sobol": False}))
    assert flown[-1] == ("seeking", "lidar", study.SunAndTerrain(), str(flight_seed(1, 0)))
    report_study(study.study, rows, options=options, out=tmp_path)
    assert "camera: 2 fields" in capsys.readouterr().out
    assert (tmp_path / "known_in_reach_camera.png").stat().st_size > 10_000
    del rows[0]["levels"][study.LAST]
    report_study(study.study, rows)
    assert "did not reach 50 m: 0 / nominal" in capsys.readouterr().out


@pytest.mark.parametrize("sensors", ["camera", "lidar", "both"])
def test_every_sensor_set_is_a_valid_scenario(study, script, sensors):
    flights = script(".", "seeking_flights")
    for path in flights.PATHS:
        scenario = flights.scenario_of(path, sensors, flights.SunAndTerrain())
        kind = "information-seeking" if path == "seeking" else "apollo"
        assert scenario.guidance.kind == kind
        assert ("rocks" in scenario.mappers) == (sensors != "lidar")
        assert ("dem" in scenario.mappers) == (sensors != "camera")


@pytest.mark.slow
def test_seeking_sees_more_than_nominal_for_less_propellant_than_modified(script):
    flights = script(".", "seeking_flights")
    conditions, seed = flights.SunAndTerrain(), flight_seed(41, 0)
    flown = {p: flights.fly(p, "camera", conditions, seed) for p in flights.PATHS}
    clear = {p: f["levels"]["50"]["clear"] for p, f in flown.items()}
    assert clear["seeking"] > clear["nominal"] + 0.2
    assert clear["seeking"] > clear["modified"] - 0.03
    assert flown["seeking"]["propellant"] < flown["modified"]["propellant"]
    assert flown["seeking"]["safe"]
