"""Lander scripts and scenarios on small cases."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.scenario import Scenario, shipped
from lunarsim.studies import Case, report_study, run_study
from tests.conftest import SCENARIOS


def test_touchdowns_are_evaluated_both_ways(script, capsys):
    study = script("landers", "touchdowns").study
    first, again = (run_study(study, count=1, seed=5) for _ in range(2))
    assert first == again
    assert len(first) == 10
    assert all(row["stroke_m"] > 0.005 for row in first if row["motion"] == [])
    report_study(study, first)
    assert "Static-safe touchdowns that tip over" in capsys.readouterr().out


def test_the_lunar_module_can_be_loaded():
    scenario = Scenario.load(SCENARIOS / "landers" / "lunar_module.toml")
    lander = scenario.vehicle.make()
    assert lander.thrusters.count == 16
    # 550 ft lb per thruster, four per direction in pitch and roll.
    assert abs(lander.torque_max[0] / 4.0 - 745.7) < 3.0
    assert lander.engine.gap_lower == 28024.0


def test_presets_differ_only_in_the_lander(script):
    """World, sensors, navigation, map and decisions are equal; ratios are those of landers."""
    study = script("landers", "presets")
    tables = [study.scenario_of(vehicle, "mare").to_dict() for vehicle in study.VEHICLES]
    own = {"name", "description", "vehicle", "control", "approach", "terminal_descent"}
    assert all(
        {key for key in one | tables[0] if one.get(key) != tables[0].get(key)} <= own
        for one in tables
    )
    for vehicle in study.VEHICLES:
        assert Scenario.load(shipped.path_of(vehicle)) == study.scenario_of(vehicle, "mare")
        lander = study.scenario_of(vehicle, "ridge").vehicle.make()
        weight = 1.622 * np.array([lander.wet_mass, lander.dry_mass])
        assert 1.5 < lander.thrust_max / weight[0] < 4.0
        assert 0.1 < lander.thrust_min / weight[1] < 0.8


def test_a_preset_lands_and_is_reported(script, monkeypatch, capsys):
    module = script("landers", "presets")
    terrain = {"kind": "fractal", "size_m": 300.0, "posting_m": 1.0, "rms_slope_deg": 1.5}
    small = {"terrain": terrain, "rocks": {"cover": 0.02}, "target": {}}
    monkeypatch.setitem(module.TERRAINS, "mare", small)
    study = module.study
    levels = {"vehicle": ["small_lander"], "terrain": ["mare"]}
    (row,) = rows = run_study(study, count=1, seed=2, levels=levels)
    assert row["safe"] and row["causes"] == []
    assert 0.5 < row["vertical_speed"] < 1.5 and row["horizontal_speed"] < 0.5
    assert 40.0 < row["left_kg"] < 60.0
    report_study(study, [*rows, row | {"number": 1, "safe": False, "causes": ["tilt", "rate"]}])
    printed = capsys.readouterr().out
    assert "rate (1), tilt (1)" in printed and "1.82" in printed


def test_failed_thruster_with_and_without_detection(script, capsys):
    module = script("landers", "thruster_failure")
    levels = {"control": "phase-plane", "failure": "tuned"}
    blind, seeing = (
        module.fly_once(Case({**levels, "detection": detection}, 0, 1), 1)
        for detection in ("off", "on")
    )
    assert blind["delay_s"] != blind["delay_s"]
    assert 0.0 < seeing["delay_s"] < 33.0
    assert seeing["safe"] and not seeing["false_alarm"]
    assert seeing["tilt_deg"] < blind["tilt_deg"]
    sets = module.FAILURES
    assert sorted(sets["tuned"] + sets["held-out"]) == list(range(16))
    row = {**levels, "detection": "on", "number": 0}
    report_study(module.study, [row | blind, row | seeing])
    assert f"{seeing['delay_s']:.1f} / {seeing['delay_s']:.1f}" in capsys.readouterr().out


def test_flights_with_and_without_slosh_are_compared(script, capsys):
    study = script("landers", "slosh").study
    levels = {"control": ["phase-plane"], "tanks": ["none", "smooth, 0.005"]}
    rows = run_study(study, count=1, seed=2, levels=levels)
    still, swinging = rows
    assert still["slosh_deg"] == 0.0
    assert 1.0 < swinging["slosh_deg"] < 30.0
    assert swinging["thruster_kg"] != still["thruster_kg"]
    assert swinging["firings"] > 100
    report_study(study, rows)
    assert f"{swinging['slosh_deg']:.1f}" in capsys.readouterr().out


@pytest.mark.slow
def test_maps_with_thrusters_and_ideal_attitude_are_compared(script, monkeypatch, capsys):
    study = script("landers", "thrusters_and_map")
    world = {**study.WORLD, "terrain": {**study.WORLD["terrain"], "size_m": 160.0}}
    sensors = {**world["sensors"], "flash": {"kind": "flash-lidar", "rows": 48, "cols": 48}}
    dem = {"kind": "gaussian-dem", "posting_m": 0.4, "size_m": 60.0}
    monkeypatch.setattr(study, "WORLD", {**world, "sensors": sensors, "mappers": {"dem": dem}})
    levels = {"control": ["ideal", "phase-plane"]}
    rows = run_study(study.study, count=1, seed=3, levels=levels)
    ideal, jets = rows
    assert ideal["thruster_kg"] == 0.0
    assert jets["thruster_kg"] > 0.2
    assert jets["rate_deg_s"] > ideal["rate_deg_s"]
    for one in rows:
        assert 0.005 < one["height_m"] < 1.0
        assert abs(one["mean_m"]) < one["height_m"]
        assert 0.0 < one["position_m"] < 2.0
        assert 0.0 < one["attitude_mrad"] < 5.0
    report_study(study.study, [*rows, *({**row, "number": 1} for row in rows)])
    assert f"{jets['thruster_kg']:+.3f} [" in capsys.readouterr().out
