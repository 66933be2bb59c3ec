"""Scenarios of the benchmark are valid."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def test_camera_and_lidar_scenario_is_valid(monkeypatch):
    monkeypatch.syspath_prepend(SCRIPTS)
    scenario = importlib.import_module("bench_parts.navigation").camera_and_lidar()
    assert set(scenario.mappers) == {"rocks"}
    assert scenario.prior_map is not None


@pytest.mark.parametrize("both", [False, True])
def test_all_sensor_scenario_has_the_stated_rates(monkeypatch, both):
    monkeypatch.syspath_prepend(SCRIPTS)
    scenario = importlib.import_module("bench_parts.all_sensors").all_sensors(both)
    looks = {name: part.make() for name, part in scenario.tasking.items()}
    assert {name: part.rate for name, part in looks.items()} == {
        "narrow": 10.0, "wide": 10.0, "flash": 2.0
    }  # fmt: skip
    assert (looks["narrow"].last_altitude == 0.0) == both
    assert scenario.mappers["rocks"].make().sensors == ("narrow", "wide")
    assert scenario.decisions.make().map == "fused"
