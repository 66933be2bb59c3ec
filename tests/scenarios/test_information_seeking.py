"""Information-seeking study: metrics from synthetic flights, and one flight."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from lunarsim.campaign import pool


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
    assert study.compare_paths(rows)["known and reachable"]["seeking"].startswith("0.125")
    console = Console(record=True, width=150)
    study.show("camera", rows, console)
    study.show_losses(rows, console)
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
    tasks = [study.SeekingFlightTask(p, k, 1) for k in range(2) for p in study.PATHS]
    flights = {t.key: made(study, 0.5) for t in tasks[:5]}
    assert len(study.complete_fields(tasks, flights)) == 1
    assert study.unfinished(tasks, flights) == []
    del flights[tasks[0].key]["levels"][study.LAST]
    assert study.complete_fields(tasks, flights) == []
    assert study.unfinished(tasks, flights) == [tasks[0].key]


def test_sobol_points_lie_within_their_bounds(study):
    points = study.sample_conditions(60, 3)
    assert len(set(points)) == 60
    assert points == study.sample_conditions(60, 3)
    assert points != study.sample_conditions(60, 4)
    rows = np.array([(g.azimuth, g.elevation, g.slope, g.cover) for g in points])
    assert (rows >= [0.0, 5.0, 0.0, 0.02]).all()
    assert (rows <= [360.0, 40.0, 4.0, 0.15]).all()
    assert (np.ptp(rows, axis=0) > 0.9 * np.array([360.0, 35.0, 4.0, 0.13])).all()


def test_study_resumes_from_its_file_and_rejects_another(study, tmp_path, monkeypatch):
    flown = []

    def fly(task):
        flown.append(task.key)
        return made(study, 0.5)

    monkeypatch.setattr(study, "fly", fly)
    monkeypatch.setattr(study, "iterate_results", pool.iterate_results)
    file = tmp_path / "study.json"
    words = ["--fields", "2", "--sensors", "camera", "--json", str(file)]
    assert CliRunner().invoke(study.main, words).exit_code == 0
    assert len(flown) == 6
    data = json.loads(file.read_text())
    del data["flights"]["camera / 1 / seeking"]
    file.write_text(json.dumps(data))
    picture = tmp_path / "figure.png"
    done = CliRunner().invoke(study.main, [*words, "--figure", str(picture)])
    assert done.exit_code == 0
    assert flown[6:] == ["camera / 1 / seeking"]
    assert (tmp_path / "figure_camera.png").stat().st_size > 10_000
    wrong = CliRunner().invoke(study.main, [*words, "--seed", "7"])
    assert wrong.exit_code == 2
    assert "must contain flights with the same settings" in wrong.output
    file.write_text(file.read_text()[:200])
    wrong = CliRunner().invoke(study.main, words)
    assert wrong.exit_code == 2
    assert "must be a" in wrong.output
    assert flown[7:] == []


def test_interrupt_keeps_finished_flights(study, tmp_path, monkeypatch):
    flown = []

    def fly(task):
        if len(flown) == 4:
            raise KeyboardInterrupt
        flown.append(task.key)
        return made(study, 0.5)

    monkeypatch.setattr(study, "fly", fly)
    file = tmp_path / "study.json"
    words = ["--sobol", "2", "--json", str(file)]
    done = CliRunner().invoke(study.main, words)
    assert "Interrupted. The finished flights are saved" in done.output
    assert list(json.loads(file.read_text())["flights"]) == flown
    monkeypatch.setattr(study, "fly", lambda task: flown.append(task.key) or made(study, 0.5))
    assert CliRunner().invoke(study.main, words).exit_code == 0
    assert len(flown) == len(set(flown)) == 6


@pytest.mark.parametrize("words", [["--sobol", "2", "--sensors", "lidar"], ["--seed", "-1"],
                                   ["--sobol", "-1"], ["--fields", "0"]])  # fmt: skip
def test_invalid_options_are_rejected(study, words):
    assert CliRunner().invoke(study.main, words).exit_code == 2


@pytest.mark.parametrize("sensors", ["camera", "lidar", "both"])
def test_every_sensor_set_is_a_valid_scenario(study, script, sensors):
    flights = script(".", "seeking_flights")
    for path in flights.PATHS:
        scenario = flights.scenario_of(flights.SeekingFlightTask(path, 0, 1, sensors))
        kind = "information-seeking" if path == "seeking" else "apollo"
        assert scenario.guidance.kind == kind
        assert ("rocks" in scenario.mappers) == (sensors != "lidar")
        assert ("dem" in scenario.mappers) == (sensors != "camera")


@pytest.mark.slow
def test_seeking_sees_more_than_nominal_for_less_propellant_than_modified(script):
    flights = script(".", "seeking_flights")
    flown = {p: flights.fly(flights.SeekingFlightTask(p, 0, 41)) for p in flights.PATHS}
    clear = {p: f["levels"]["50"]["clear"] for p, f in flown.items()}
    assert clear["seeking"] > clear["nominal"] + 0.2
    assert clear["seeking"] > clear["modified"] - 0.03
    assert flown["seeking"]["propellant"] < flown["modified"]["propellant"]
    assert flown["seeking"]["safe"]
