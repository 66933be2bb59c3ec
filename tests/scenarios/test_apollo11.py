"""The Apollo 11 descent: its load, its record, and (slow) its flights."""

import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.scenario import Scenario

ROOT = Path(__file__).parents[2] / "scenarios"
FILE = ROOT / "landers/apollo11.toml"


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(ROOT))
    try:
        import apollo11_descent

        yield apollo11_descent
    finally:
        sys.path.remove(str(ROOT))


def _close(ours, theirs):
    for key, value in theirs.items():
        if isinstance(value, str | bool) or value is None:
            assert ours[key] == value, key
        else:
            assert np.asarray(ours[key]) == pytest.approx(np.asarray(value), rel=1e-8), key


def test_the_file_holds_the_load(study):
    plain = Scenario.load(FILE)
    loaded = study.apollo11.loaded(plain)
    for table in ("braking", "approach"):
        _close(getattr(plain, table).model_dump(), getattr(loaded, table).model_dump())


def test_masses_are_the_mission_reports(study):
    """33,401.6 lb after descent orbit insertion, which took 268 lb of 8,248 kg."""
    lander, pound = Scenario.load(FILE).vehicle.make(), 0.45359237
    assert lander.wet_mass == pytest.approx(33_401.6 * pound, abs=1.0)
    assert pytest.approx(268.0 * pound, abs=0.1) == study.apollo11.INSERTION
    assert lander.propellant_mass == pytest.approx(8_248.0 - 268.0 * pound, abs=0.5)
    # What was left at landing, less the lander's dry mass here: 16,153.2 lb and 349 kg.
    assert lander.dry_mass + 349.0 == pytest.approx(16_153.2 * pound, abs=60.0)


def test_the_loads_own_ignition_is_the_files_start(study):
    plain = Scenario.load(FILE)
    radius = plain.moon.radius_m
    x, _, z = plain.start.position_m
    arc = radius * np.arctan2(x, z + radius)
    assert arc == pytest.approx(study.apollo11.own_uprange(plain))
    assert arc == pytest.approx(440_907.0, abs=1.0)
    own = study.apollo11.started(plain, arc)
    assert own.start.position_m == pytest.approx(plain.start.position_m, abs=1e-3)
    assert own.start.velocity_m_s == pytest.approx(plain.start.velocity_m_s, abs=1e-4)
    # As fast as the load says, and level there.
    v, up = np.array(own.start.velocity_m_s), np.array([x, 0.0, z + radius])
    assert np.linalg.norm(v) == pytest.approx(1699.52182)
    assert v @ up == pytest.approx(0.0, abs=1.0)


def test_stars_of_the_load_are_what_the_cubic_takes_for_an_eighth_of_the_time(study):
    t = study.apollo11.targets()
    for of in ("BRFG", "APFG"):
        assert t[f"V{of}*"][0] == pytest.approx(18.0 / 8.0 * t[f"V{of}"][0], rel=1e-6)
        assert t[f"A{of}*"][0] == pytest.approx(6.0 * t[f"A{of}"][0], rel=1e-6)


def test_the_record_is_read_as_it_is(study):
    told = study.apollo11.record()
    known = np.isfinite(told.altitude)
    assert (len(told.time), int(known.sum())) == (391, 215)
    assert told.time[0] == study.apollo11.LOCK_ON
    assert told.altitude[0] == pytest.approx(43_753.45 * 0.3048)
    assert np.rad2deg(told.pitch[0]) == pytest.approx(79.1565, abs=1e-4)
    assert abs(told.pitch).max() < np.pi / 2


def test_differences_are_those_put_in(study):
    a = study.apollo11
    told = a.record()
    good = np.isfinite(told.altitude)
    height = np.interp(told.time, told.time[good], told.altitude[good])
    ours = a.Track(told.time, height + 30.0, told.pitch - 0.02)
    found = a.beside(ours, told, a.LOCK_ON, a.P64)
    assert (found.altitude, found.pitch) == pytest.approx((30.0, 0.02))
    assert 0 < found.rows < good.sum()
    # What the flight does not last for is not compared.
    short = a.Track(told.time[:50], height[:50], told.pitch[:50])
    assert np.isnan(a.beside(short, told, a.P66, a.LANDING).altitude)


def test_the_command_tells_of_itself(study):
    said = CliRunner().invoke(study.main, ["--help"])
    assert said.exit_code == 0
    for option in ("--json", "--out", "--isp", "--uprange-km", "--ground"):
        assert option in said.output
    assert CliRunner().invoke(study.main, ["--isp", "311"]).exit_code == 2


@pytest.mark.slow
def test_both_runs_land_beside_the_record(study, tmp_path):
    import json

    out = tmp_path / "a11.json"
    told = CliRunner().invoke(
        study.main, ["--json", str(out), "--out", str(tmp_path), "--no-load-start"]
    )
    assert told.exit_code == 0, told.output
    runs = json.loads(out.read_text())
    for run in runs:
        assert run["safe"]
        assert run["p64_altitude_m"] < 200.0
        assert run["p64_pitch_deg"] < 7.0
        assert 415.0 < run["recovery_s"] < 440.0
        assert run["times_real_time"] > 5.0
        phases = run["braking_kg"] + run["approach_kg"] + run["last_kg"]
        assert phases == pytest.approx(run["propellant_kg"], abs=40.0)  # thrusters' in it
    assert runs[0]["propellant_kg"] == pytest.approx(7_380.0, abs=30.0)
    assert [run["miss_m"] < 60.0 for run in runs] == [True, True, False]
    assert 250.0 < runs[2]["miss_m"] < 460.0
    assert runs[2]["duration_s"] > runs[1]["duration_s"] + 15.0
    assert (tmp_path / "descent.png").exists()


@pytest.mark.slow
def test_from_the_loads_own_ignition_full_tanks_are_too_heavy(study):
    run = study.fly("own", study.scenario_of(440_907.0, 303.0, "drawn"), 1)
    assert not run.told["safe"]
