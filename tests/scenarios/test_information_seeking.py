"""The study of information-seeking descents: its figures from made flights, and a flight of it."""

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


def test_paths_are_compared_field_by_field(study):
    clear = {"nominal": (0.2, 0.4), "modified": (0.6, 0.9), "seeking": (0.7, 0.8)}
    rows = [{p: made(study, v[k]) for p, v in clear.items()} for k in range(2)]
    line = study.compared(rows)["clear ground called clear"]
    assert line["seeking"].startswith("0.750")
    assert line["seeking - nominal"].startswith("0.450")
    assert line["seeking - modified"].startswith("0.000")
    assert study.compared(rows)["safe sites known"]["seeking"].startswith("0.250")
    assert study.compared(rows)["and in reach"]["seeking"].startswith("0.125")
    console = Console(record=True, width=150)
    study.show("camera", rows, console)
    study.show_losses(rows, console)
    told = console.export_text()
    assert "less clear ground than modified in 1 of 2" in told
    assert "less clear ground than nominal in 0 of 2" in told
    assert "2 of 120" in told
    assert "more than modified in 1 of 2 fields, median +0.000" in told
    assert told.count("no clear win") == 2


def test_a_win_is_one_whose_interval_lies_above_nought(study):
    few = [{p: made(study, v) for p, v in row.items()} for row in (
        {"nominal": 0.20, "modified": 0.60, "seeking": 0.70},
        {"nominal": 0.22, "modified": 0.80, "seeking": 0.71},
        {"nominal": 0.19, "modified": 0.50, "seeking": 0.69},
    )]  # fmt: skip
    assert "by the interval of the mean a clear win" in study.odds(few, "nominal")
    assert "by the interval of the mean no clear win" in study.odds(few, "modified")
    # A figure that is none leaves its field out.
    few[0]["seeking"]["levels"][study.LAST]["clear"] = float("nan")
    assert "in 2 of 2 fields" in study.odds(few, "nominal")


def test_a_field_counts_once_all_paths_have_flown_it(study):
    tasks = [study.Task(p, k, 1) for k in range(2) for p in study.PATHS]
    flights = {t.key: made(study, 0.5) for t in tasks[:5]}
    assert len(study.whole_fields(tasks, flights)) == 1
    assert study.unfinished(tasks, flights) == []
    del flights[tasks[0].key]["levels"][study.LAST]
    assert study.whole_fields(tasks, flights) == []
    assert study.unfinished(tasks, flights) == [tasks[0].key]


def test_points_lie_within_what_is_asked(study):
    points = study.sobol(60, 3)
    assert len(set(points)) == 60
    assert points == study.sobol(60, 3)
    assert points != study.sobol(60, 4)
    rows = np.array([(g.azimuth, g.elevation, g.slope, g.cover) for g in points])
    assert (rows >= [0.0, 5.0, 0.0, 0.02]).all()
    assert (rows <= [360.0, 40.0, 4.0, 0.15]).all()
    assert (np.ptp(rows, axis=0) > 0.9 * np.array([360.0, 35.0, 4.0, 0.13])).all()


def test_it_goes_on_from_its_file_and_refuses_another(study, tmp_path, monkeypatch):
    flown = []

    def fly(task):
        flown.append(task.key)
        return made(study, 0.5)

    monkeypatch.setattr(study, "fly", fly)
    monkeypatch.setattr(study, "outcomes", pool.outcomes)
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
    assert "must hold flights of" in wrong.output
    file.write_text(file.read_text()[:200])
    wrong = CliRunner().invoke(study.main, words)
    assert wrong.exit_code == 2
    assert "must be a" in wrong.output
    assert flown[7:] == []


def test_an_interrupt_keeps_what_is_done(study, tmp_path, monkeypatch):
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
    assert "interrupted; what is done is kept" in done.output
    assert list(json.loads(file.read_text())["flights"]) == flown
    monkeypatch.setattr(study, "fly", lambda task: flown.append(task.key) or made(study, 0.5))
    assert CliRunner().invoke(study.main, words).exit_code == 0
    assert len(flown) == len(set(flown)) == 6


@pytest.mark.parametrize("words", [["--sobol", "2", "--sensors", "lidar"], ["--seed", "-1"],
                                   ["--sobol", "-1"], ["--fields", "0"]])  # fmt: skip
def test_words_that_cannot_be_are_refused(study, words):
    assert CliRunner().invoke(study.main, words).exit_code == 2


@pytest.mark.parametrize("sensors", ["camera", "lidar", "both"])
def test_every_set_of_sensors_is_a_scenario(study, script, sensors):
    flights = script(".", "seeking_flights")
    for path in flights.PATHS:
        scenario = flights.scenario_of(flights.Task(path, 0, 1, sensors))
        kind = "information-seeking" if path == "seeking" else "apollo"
        assert scenario.guidance.kind == kind
        assert ("rocks" in scenario.mappers) == (sensors != "lidar")
        assert ("dem" in scenario.mappers) == (sensors != "camera")


@pytest.mark.slow
def test_it_sees_more_than_the_direct_path_for_less_than_the_modified(script):
    flights = script(".", "seeking_flights")
    flown = {p: flights.fly(flights.Task(p, 0, 41)) for p in flights.PATHS}
    clear = {p: f["levels"]["50"]["clear"] for p, f in flown.items()}
    assert clear["seeking"] > clear["nominal"] + 0.2
    assert clear["seeking"] > clear["modified"] - 0.03
    assert flown["seeking"]["propellant"] < flown["modified"]["propellant"]
    assert flown["seeking"]["safe"]
