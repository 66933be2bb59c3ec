"""Lander scripts and scenarios on small cases."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from lunarsim.scenario import Scenario
from tests.conftest import SCENARIOS


def test_touchdowns_are_evaluated_both_ways(script, tmp_path):
    study = script("landers", "touchdowns")
    out = tmp_path / "touchdowns.json"
    runs = []
    for jobs in ("1", "1"):
        arguments = ["--touchdowns", "6", "--seed", "5", "--jobs", jobs, "--json", str(out)]
        done = CliRunner().invoke(study.main, arguments)
        assert done.exit_code == 0, done.output
        assert "Static-safe touchdowns that tip over" in done.output
        runs.append(json.loads(out.read_text()))
    assert runs[0] == runs[1]
    assert sum(runs[0]["confusion"].values()) == 6
    assert all(row["stroke_m"] > 0.005 for row in runs[0]["touchdowns"] if row["motion"] == [])


def test_the_lunar_module_can_be_loaded():
    scenario = Scenario.load(SCENARIOS / "landers" / "lunar_module.toml")
    lander = scenario.vehicle.make()
    assert lander.thrusters.count == 16
    # 550 ft lb per thruster, four per direction in pitch and roll.
    assert abs(lander.torque_max[0] / 4.0 - 745.7) < 3.0
    assert lander.engine.gap_lower == 28024.0


def test_failed_thruster_with_and_without_detection(script):
    study = script("landers", "thruster_failure")
    blind, seeing = (study.fly("phase-plane", 1, 1, watch) for watch in (False, True))
    assert blind[2] != blind[2]
    assert seeing[3] == 0
    out = CliRunner().invoke(study.main, ["--help"]).output
    assert "--held-out" in out
    shut = []
    study.fly = lambda control, thruster, seed, detects_faults: (
        shut.append((thruster, seed)) or (True, 1.0, 9.0, int(thruster is None))
    )
    done = CliRunner().invoke(
        study.main, ["--held-out", "--first-seed", "7", "--seeds", "1", "--nominal", "4"]
    )
    assert done.exit_code == 0, done.output
    assert {one for one, _ in shut} == {None} | set(range(16)) - {0, 1, 4, 5}
    assert {seed for _, seed in shut} == {7, 8, 9, 10}
    assert "false alarms in 4" in done.output
    assert "detected 12, after 4.0 s (median; maximum 4.0), false isolations 0" in done.output
    assert 5.0 < seeing[2] < 38.0
    assert seeing[0]
    assert seeing[1] < blind[1]


def test_flights_with_and_without_slosh_are_compared(script, monkeypatch):
    study = script("landers", "slosh")
    still, swinging = (
        study.fly(study.SloshTask("phase-plane", case, 2)) for case in ("none", "smooth, 0.005")
    )
    assert still.slosh_deg == 0.0
    assert 1.0 < swinging.slosh_deg < 30.0
    assert swinging.thruster_kg != still.thruster_kg
    assert swinging.firings > 100
    monkeypatch.setattr(study, "CONTROLS", ("quaternion-feedback",))
    monkeypatch.setattr(study, "CASES", {"none": {}})
    done = CliRunner().invoke(study.main, ["--flights", "1"])
    assert done.exit_code == 0, done.output
    assert "| `quaternion-feedback` | none | 1 of 1 |" in done.output


@pytest.mark.slow
def test_maps_with_thrusters_and_ideal_attitude_are_compared(script, monkeypatch):
    study = script("landers", "thrusters_and_map")
    world = {**study.WORLD, "terrain": {**study.WORLD["terrain"], "size_m": 160.0}}
    sensors = {**world["sensors"], "flash": {"kind": "flash-lidar", "rows": 48, "cols": 48}}
    dem = {"kind": "gaussian-dem", "posting_m": 0.4, "size_m": 60.0}
    monkeypatch.setattr(study, "WORLD", {**world, "sensors": sensors, "mappers": {"dem": dem}})
    ideal, jets = (study.fly(study.ThrusterMapTask(way, 0, 3)) for way in ("ideal", "phase-plane"))
    assert ideal.figures["thruster_kg"] == 0.0
    assert jets.figures["thruster_kg"] > 0.2
    assert jets.figures["rate_deg_s"] > ideal.figures["rate_deg_s"]
    for one in (ideal, jets):
        assert 0.005 < one.figures["height_m"] < 1.0
        assert abs(one.figures["mean_m"]) < one.figures["height_m"]
        assert 0.0 < one.figures["position_m"] < 2.0
        assert 0.0 < one.figures["attitude_mrad"] < 5.0
    monkeypatch.setattr(study, "fly", lambda task: {"ideal": ideal, "phase-plane": jets}[task.way])
    monkeypatch.setattr(study, "WAYS", dict.fromkeys(("ideal", "phase-plane")))
    monkeypatch.setattr(
        study, "collect_results", lambda fly, tasks, *_: [study.fly(t) for t in tasks]
    )
    done = CliRunner().invoke(study.main, ["--flights", "2"])
    assert done.exit_code == 0, done.output
    gained = jets.figures["thruster_kg"]
    assert f"| thruster propellant (kg) | 0.000 | {gained:.3f} | {gained:+.3f} [" in done.output
