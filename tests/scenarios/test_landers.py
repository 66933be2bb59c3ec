"""The scripts and scenarios of landers, small."""

from __future__ import annotations

import json

from click.testing import CliRunner

from lunarsim.scenario import Scenario
from tests.conftest import SCENARIOS


def test_touchdowns_are_judged_both_ways(script, tmp_path):
    study = script("landers", "touchdowns")
    out = tmp_path / "touchdowns.json"
    runs = []
    for jobs in ("1", "1"):
        arguments = ["--touchdowns", "6", "--seed", "5", "--jobs", jobs, "--json", str(out)]
        done = CliRunner().invoke(study.main, arguments)
        assert done.exit_code == 0, done.output
        assert "static-safe that tip over" in done.output
        runs.append(json.loads(out.read_text()))
    assert runs[0] == runs[1]
    assert sum(runs[0]["confusion"].values()) == 6
    assert all(row["stroke_m"] > 0.005 for row in runs[0]["touchdowns"] if row["motion"] == [])


def test_the_lunar_module_can_be_loaded():
    scenario = Scenario.load(SCENARIOS / "landers" / "lunar_module.toml")
    lander = scenario.vehicle.make()
    assert lander.thrusters.count == 16
    # 550 ft lb a thruster, four of a sense about pitch and roll.
    assert abs(lander.torque_max[0] / 4.0 - 745.7) < 3.0
    assert lander.engine.gap_from == 28024.0


def test_a_dead_thruster_is_flown_with_and_without_the_watch(script):
    study = script("landers", "dead_thruster")
    blind, seeing = (study.fly("phase-plane", 1, 1, watch) for watch in (False, True))
    assert blind[2] != blind[2]
    assert 5.0 < seeing[2] < 38.0
    assert seeing[0]
    assert seeing[1] < blind[1]


def test_liquid_that_swings_is_flown_beside_liquid_that_does_not(script, monkeypatch):
    study = script("landers", "slosh")
    still, swinging = (
        study.fly(study.Task("phase-plane", case, 2)) for case in ("none", "smooth, 0.005")
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
