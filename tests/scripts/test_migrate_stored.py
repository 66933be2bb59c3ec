"""Stored files of earlier versions get the current names and keep their numbers."""

from __future__ import annotations

import json
import shutil
import sys

import numpy as np
import pytest

import lunarsim
from lunarsim.errors import InputError
from lunarsim_envs.sites.surrogate import Surrogate
from tests.worlds import ROOT, TINY_FLIGHT

sys.path.insert(0, str(ROOT / "scripts"))

import migrate_stored
from golden_parts import names

SURROGATE = ROOT / "envs" / "lunarsim_envs" / "sites" / "gaussian_dem.npz"


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown") / "flight"
    return lunarsim.fly(lunarsim.Scenario.from_dict(TINY_FLIGHT), seed=3).save(folder)


def _old(value):
    """Give JSON data the names that an earlier version wrote."""
    keys = {new: old for old, new in names.KEYS.items()}
    events = {new: old for old, new in names.EVENTS.items()}
    if isinstance(value, list):
        return [_old(one) for one in value]
    if not isinstance(value, dict):
        return value
    found = {keys.get(key, key): _old(one) for key, one in value.items()}
    if {"time", "name"} <= set(found):
        found["name"] = events.get(found["name"], found["name"])
    return found


def test_an_old_flight_is_refused_and_reads_after_its_migration(flown, tmp_path, capsys):
    folder = tmp_path / "flight"
    shutil.copytree(flown, folder)
    current = json.loads((folder / "flight.json").read_text())
    old = _old(current)
    assert "verdict" in old and old != current
    (folder / "flight.json").write_text(json.dumps(old))
    with pytest.raises(InputError, match="migrate_stored"):
        lunarsim.Flight.load(folder)
    assert migrate_stored.migrate(folder)
    assert json.loads((folder / "flight.json").read_text()) == current
    flight = lunarsim.Flight.load(folder)
    assert str(flight) == str(lunarsim.Flight.load(flown))
    assert not migrate_stored.migrate(folder)


def test_the_arrays_of_a_surrogate_stay_byte_for_byte(tmp_path):
    current = dict(np.load(SURROGATE))
    tables = json.loads(str(current["made_for"]))
    tables["sensor"]["late_s"] = tables["sensor"].pop("latency_bias_s")
    tables["sensor"]["half_width"] = tables["sensor"].pop("half_fov_tangent")
    old = {**current, "made_for": np.asarray(json.dumps(tables, sort_keys=True))}
    old["claimed"] = old.pop("reported_velocity_sigma")
    path = tmp_path / "surrogate.npz"
    np.savez(path, **old)
    assert migrate_stored.migrate(path)
    found = dict(np.load(path))
    assert set(found) == set(current)
    for name, array in current.items():
        assert found[name].dtype == array.dtype and found[name].tobytes() == array.tobytes(), name
    assert Surrogate.load(path).made_for == Surrogate.load(SURROGATE).made_for
    assert not migrate_stored.migrate(path)


def test_a_calibration_gets_its_names_and_other_json_stays(tmp_path):
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"before": {"all": {"sure": 3.0, "gap": -0.01, "ece": 0.02}}}))
    assert migrate_stored.migrate(path)
    found = json.loads(path.read_text())["before"]["all"]
    assert found == {"confident_sites": 3.0, "bias": -0.01, "ece": 0.02}
    before = path.read_bytes()
    assert not migrate_stored.migrate(path) and path.read_bytes() == before
