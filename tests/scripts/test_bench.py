"""Scenarios that the bench makes of those that come along can be flown."""

from __future__ import annotations

import importlib
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def test_the_flight_with_two_eyes_is_one(monkeypatch):
    monkeypatch.syspath_prepend(SCRIPTS)
    scenario = importlib.import_module("bench_parts.navigation").two_eyes()
    assert set(scenario.mappers) == {"rocks"}
    assert scenario.prior_map is not None
