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


def test_scenario_file_contains_the_load(study):
    plain = Scenario.load(FILE)
    loaded = study.apollo11.with_ignition_start(study.apollo11.with_targets(plain))
    for table in ("start", "braking", "approach"):
        _close(getattr(plain, table).model_dump(), getattr(loaded, table).model_dump())
    assert plain.terminal_descent.table == loaded.terminal_descent.table


# Scales of the computer's words by the listing of its sample load: metres 2^24, m/cs 2^10, m/cs^2
# 2^-4, m/cs^3 2^-18, centiseconds 2^14 where a constant stands alone and 2^17 where it is a
# time-to-go; 2^9 for the time constant of P66.
_SCALE = {"m": (24, 1.0), "m/s": (10, 1e2), "m/s^2": (-4, 1e4), "m/s^3": (-18, 1e6)}
_SECONDS = {"ZOOMTIME": 14, "TAUVERT": 14, "TAUROD": 9}


def _decoded(row):
    """Return the values of a row's words: one's complement, 14 bits a word, high word first."""
    words = [int(w, 8) for w in row["words"].split()]
    parts = [-(0o77777 ^ w) if w >= 0o40000 else w for w in words]
    if row["unit"] == "1":
        return [parts[0] * 43_454.6769 / 3467 / 46_706.0]
    power, per = _SCALE.get(row["unit"]) or (_SECONDS.get(row["name"], 17), 1e-2)
    if len(parts) == 1:
        return [parts[0] * 2.0 ** (power - 14) * per]
    pairs = zip(parts[::2], parts[1::2], strict=True)
    return [(high * 2**14 + low) * 2.0 ** (power - 28) * per for high, low in pairs]


def test_values_of_the_flown_load_match_its_words(study):
    import csv

    with (ROOT / "data" / study.apollo11.FLOWN).open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 25
    for row in rows:
        told = [float(row[k]) for k in ("x_up", "y_cross", "z_downrange") if row[k]]
        assert _decoded(row) == pytest.approx(told, rel=2e-4 if row["unit"] == "1" else 1e-7)


def test_masses_match_the_mission_report(study):
    """33,401.6 lb after descent orbit insertion, which took 268 lb of 8,248 kg."""
    lander, pound = Scenario.load(FILE).vehicle.make(), 0.45359237
    assert lander.wet_mass == pytest.approx(33_401.6 * pound, abs=1.0)
    assert pytest.approx(268.0 * pound, abs=0.1) == study.apollo11.INSERTION
    assert lander.propellant_mass == pytest.approx(8_248.0 - 268.0 * pound, abs=0.5)
    # Remaining mass at landing minus the dry mass here: 16,153.2 lb and 349 kg.
    assert lander.dry_mass + 349.0 == pytest.approx(16_153.2 * pound, abs=60.0)


def _leapt(moon, position, velocity, time):
    """Return the end of a coast in ENU by leapfrog integration in an inertial frame."""
    centre = np.array([0.0, 0.0, -moon.radius])
    r, steps = position - centre, 26_000
    v, step = velocity + np.cross(moon.spin, r), time / 26_000

    def pull(r):
        return -moon.magnitude * moon.radius**2 * r / np.linalg.norm(r) ** 3

    for _ in range(steps):
        v = v + 0.5 * step * pull(r)
        r = r + step * v
        v = v + 0.5 * step * pull(r)
    rate = np.linalg.norm(moon.spin)
    x, y, z = moon.spin / rate
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    c, s = np.cos(rate * time), np.sin(rate * time)
    back = np.eye(3) - s * cross + (1.0 - c) * cross @ cross  # rotation of the frame
    r, v = back @ r, back @ v
    return r + centre, v - np.cross(moon.spin, r)


def test_coast_from_ignition_reaches_the_throttle_up_state_of_the_load(study):
    plain = Scenario.load(FILE)
    # The load gives the published ignition point, 260 nautical miles uprange.
    assert study.apollo11.uprange(plain) == pytest.approx(260.0 * 1852.0, rel=1e-3)
    moon = plain.moon.make().gravity(plain.gravity_m_s2)
    start = np.array(plain.start.position_m), np.array(plain.start.velocity_m_s)
    r, v = _leapt(moon, *start, 26.0)
    assert r == pytest.approx([436_655.6875, 0.0, -39_782.4375], abs=0.01)  # RIGNZ, RIGNX
    assert np.linalg.norm(v) == pytest.approx(1690.256118774 + 26.0 * 0.350132708, abs=1e-4)
    assert v @ moon.position_from_centre(r) == pytest.approx(0.0, abs=10.0)  # horizontal there


def test_first_guess_of_braking_solves_its_cubic(study):
    """In the form of the computer: along z, negative time, starred values."""
    plain, t = Scenario.load(FILE), study.apollo11.read_targets()
    time = -plain.braking.time_to_go_s / 8.0
    z, speed = -plain.start.position_m[0], -plain.start.velocity_m_s[0]
    j, a, v = (-t[f"{of}BRFG*"][0] for of in "JAV")
    powers = (
        j * time**3, a * time**2, (6.0 * speed / 8.0 + v) * time,
        -24.0 / 64.0 * (z + t["RBRFG"][0]),
    )  # fmt: skip
    assert sum(powers) == pytest.approx(0.0, abs=1e-6 * max(map(abs, powers)))


@pytest.mark.parametrize("load", ["FLOWN", "SAMPLE"])
def test_starred_values_are_the_cubic_coefficients_for_an_eighth_of_the_time(study, load):
    t = study.apollo11.read_targets(getattr(study.apollo11, load))
    for of in ("BRFG", "APFG"):
        assert t[f"V{of}*"][0] == pytest.approx(18.0 / 8.0 * t[f"V{of}"][0], rel=2e-3)
        assert t[f"A{of}*"][0] == pytest.approx(6.0 * t[f"A{of}"][0], rel=1e-5)


def test_record_is_read_unchanged(study):
    told = study.apollo11.read_flight_record()
    known = np.isfinite(told.altitude)
    assert (len(told.time), int(known.sum())) == (391, 215)
    assert told.time[0] == study.apollo11.LOCK_ON
    assert told.altitude[0] == pytest.approx(43_753.45 * 0.3048)
    assert np.rad2deg(told.pitch[0]) == pytest.approx(79.1565, abs=1e-4)
    assert abs(told.pitch).max() < np.pi / 2


def test_known_differences_are_recovered(study):
    a = study.apollo11
    told = a.read_flight_record()
    good = np.isfinite(told.altitude)
    height = np.interp(told.time, told.time[good], told.altitude[good])
    ours = a.DescentTrack(told.time, height + 30.0, told.pitch - 0.02)
    found = a.record_difference(ours, told, a.LOCK_ON, a.P64)
    assert (found.altitude, found.pitch) == pytest.approx((30.0, 0.02))
    assert 0 < found.samples < good.sum()
    # The record after the end of the flight is not compared.
    short = a.DescentTrack(told.time[:50], height[:50], told.pitch[:50])
    assert np.isnan(a.record_difference(short, told, a.P66, a.LANDING).altitude)


def test_command_has_help(study):
    said = CliRunner().invoke(study.main, ["--help"])
    assert said.exit_code == 0
    for option in ("--json", "--out", "--isp", "--sample", "--terrain"):
        assert option in said.output
    assert CliRunner().invoke(study.main, ["--isp", "311"]).exit_code == 2


@pytest.mark.slow
def test_all_runs_land_and_match_the_record(study, tmp_path):
    import json

    out = tmp_path / "a11.json"
    told = CliRunner().invoke(study.main, ["--json", str(out), "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    *runs, sample = json.loads(out.read_text())
    for run in runs:
        assert run["safe"]
        assert run["p63_altitude_m"] < 650.0
        assert run["p63_pitch_deg"] < 4.5
        assert run["p64_altitude_m"] < 300.0
        assert 405.0 < run["recovery_s"] < 420.0
        assert 485.0 < run["approach_s"] < 495.0
        assert run["times_real_time"] > 5.0
        phases = run["braking_kg"] + run["approach_kg"] + run["last_kg"]
        assert phases == pytest.approx(run["propellant_kg"], abs=40.0)  # includes the thrusters
    # All runs except the plain pilot are within 3 % of the mission report.
    share = [(run["propellant_kg"] + 121.6) / 7_899.0 - 1.0 for run in runs]
    assert [abs(s) < 0.03 for s in share] == [True, False, True]
    assert share[1] == pytest.approx(-0.045, abs=0.004)
    assert [run["miss_m"] < 80.0 for run in runs] == [True, True, False]
    assert 250.0 < runs[2]["miss_m"] < 460.0
    assert runs[2]["duration_s"] > runs[1]["duration_s"] + 15.0
    assert (tmp_path / "descent.png").exists()
    assert sample["safe"]
    assert sample["p63_altitude_m"] > 1_500.0
