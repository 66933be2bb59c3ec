"""OEM and AEM: read by other readers, they have the numbers of the flight."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from oem import OrbitEphemerisMessage
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.exports import ExportOptions, export_flight
from tests.exports.tables import columns
from tests.reference.aem import read_aem

MOON = 1_737_400.0


def read_oem(path):
    """Return seconds since the epoch of the first state, positions, velocities, and the segment."""
    segment = OrbitEphemerisMessage.open(path).segments[0]
    states = list(segment)
    start = states[0].epoch
    time = np.array([(s.epoch - start).sec for s in states])
    return (
        time, 1e3 * np.array([s.position for s in states]),
        1e3 * np.array([s.velocity for s in states]), segment,
    )  # fmt: skip


def with_moon(flight, latitude=20.0, radius=MOON):
    table = f"\n[moon]\nlatitude_deg = {latitude}\nradius_m = {radius}\n"
    return replace(flight, scenario=flight.scenario + table)


def test_an_oem_has_the_true_trajectory(flight, tmp_path):
    time, position, velocity, segment = read_oem(export_flight(flight, "oem", tmp_path / "a.oem"))
    truth = flight.trajectory
    assert np.abs(time - truth["time"]).max() < 1e-8
    assert np.abs(position - columns(truth, "position")).max() < 1e-9
    assert np.abs(velocity - columns(truth, "velocity")).max() < 1e-11
    meta = segment.metadata
    assert (meta["CENTER_NAME"], meta["REF_FRAME"]) == ("MOON", "LUNARSIM_SITE_ENU")
    assert meta["TIME_SYSTEM"] == "UTC"
    assert meta["START_TIME"].isot == "2000-01-01T12:00:00.000000"


def test_an_oem_has_the_given_epoch_and_states_what_it_is(flight, tmp_path):
    options = ExportOptions(epoch="2027-03-01T10:20:30.25Z")
    path = export_flight(flight, "oem", tmp_path / "a.oem", options)
    segment = read_oem(path)[3]
    assert segment.metadata["START_TIME"].isot == "2027-03-01T10:20:30.250000"
    notes = path.read_text()
    for words in ("x east, y north, z up", "True state", "has no date", "given to the export"):
        assert words in notes


def test_an_oem_of_the_estimate_has_its_covariance(flight, tmp_path):
    options = ExportOptions(state="estimate")
    path = export_flight(flight, "oem", tmp_path / "a.oem", options)
    _, position, velocity, segment = read_oem(path)
    found = flight.navigation
    assert np.abs(position - columns(found, "position")).max() < 1e-9
    assert np.abs(velocity - columns(found, "velocity")).max() < 1e-11
    covariances = list(segment.covariances)
    assert len(covariances) == len(found["time"])
    for k in (1, len(covariances) // 2):
        matrix = 1e6 * covariances[k].matrix
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 3), (1, 5), (2, 4), (3, 3), (5, 5), (0, 1)):
            expected = found[f"covariance_{i}{j}"][k]
            assert matrix[i, j] == pytest.approx(expected, rel=1e-12, abs=1e-30)
            assert matrix[j, i] == matrix[i, j]


def with_covariance(flight):
    """Return the flight with a covariance whose elements all differ, and that covariance."""
    full = np.arange(36.0).reshape(6, 6)
    full = full + full.T + 100.0 * np.eye(6)
    table = dict(flight.navigation)
    for i in range(6):
        for j in range(i, 6):
            table[f"covariance_{i}{j}"] = np.full(len(table["time"]), full[i, j])
    return replace(flight, navigation=table), full


def test_a_covariance_in_correct_order(flight, tmp_path):
    changed, full = with_covariance(flight)
    path = export_flight(changed, "oem", tmp_path / "a.oem", ExportOptions(state="estimate"))
    matrix = next(iter(read_oem(path)[3].covariances)).matrix
    np.testing.assert_allclose(1e6 * matrix, full, rtol=1e-12)


def test_coordinates_fixed_to_the_moon(flight, tmp_path):
    """Latitude, longitude and height of the lander follow from its offsets on the sphere."""
    path = export_flight(
        with_moon(flight), "oem", tmp_path / "a.oem", ExportOptions(longitude=30.0)
    )
    _, position, velocity, segment = read_oem(path)
    assert segment.metadata["REF_FRAME"] == "MOON_ME"
    x, y, z = columns(flight.trajectory, "position").T
    radius = np.linalg.norm(position, axis=1)
    latitude = np.arcsin(position[:, 2] / radius)
    longitude = np.arctan2(position[:, 1], position[:, 0])
    # Great circles from the site; at some 100 m the plane and the sphere agree to centimetres.
    assert np.abs(radius - MOON - z - (x**2 + y**2) / (2 * MOON)).max() < 1e-2
    assert np.abs((latitude - np.deg2rad(20.0)) * MOON - y).max() < 0.2
    assert np.abs((longitude - np.deg2rad(30.0)) * MOON * np.cos(np.deg2rad(20.0)) - x).max() < 0.2
    moved = np.gradient(position, flight.trajectory["time"], axis=0)
    assert np.abs(moved - velocity)[1:-2].max() < 0.2
    np.testing.assert_allclose(
        np.linalg.norm(velocity, axis=1),
        np.linalg.norm(columns(flight.trajectory, "velocity"), axis=1), atol=1e-9,
    )  # fmt: skip


def test_the_covariance_turns_with_the_frame(flight, tmp_path):
    changed, full = with_covariance(flight)
    options = ExportOptions(state="estimate", longitude=30.0)
    path = export_flight(with_moon(changed), "oem", tmp_path / "a.oem", options)
    found = 1e6 * list(read_oem(path)[3].covariances)[5].matrix
    lat, lon = np.deg2rad([20.0, 30.0])
    axes = np.array(
        [
            [-np.sin(lon), np.cos(lon), 0.0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )
    for i in range(2):
        for j in range(2):
            rows, columns = slice(3 * i, 3 * i + 3), slice(3 * j, 3 * j + 3)
            for a in range(3):
                for b in range(3):
                    assert axes[a] @ found[rows, columns] @ axes[b] == pytest.approx(
                        full[3 * i + a, 3 * j + b], rel=1e-9
                    )


def test_an_aem_has_the_true_attitudes(flight, tmp_path):
    keywords, rows = read_aem(export_flight(flight, "aem", tmp_path / "a.aem").read_text())
    rows = np.array(rows)
    assert np.abs(rows[:, 0] - flight.trajectory["time"]).max() < 1e-6
    assert keywords["START_TIME"] == "2000-01-01T12:00:00.000000000"
    assert flight.trajectory["time"][0] == 0.0
    assert keywords["ATTITUDE_TYPE"] == "QUATERNION" and keywords["QUATERNION_TYPE"] == "LAST"
    assert (keywords["REF_FRAME_A"], keywords["REF_FRAME_B"]) == ("LUNARSIM_SITE_ENU", "SC_BODY_1")
    assert keywords["ATTITUDE_DIR"] == "A2B"
    found = Rotation.from_quat(rows[:, 1:])
    truth = Rotation.from_quat(columns(flight.trajectory, "attitude", "xyzw"))
    assert (found.inv() * truth).magnitude().max() < 1e-7


def test_the_attitude_is_that_of_the_thrust(flight, tmp_path):
    """Body z, from the definition of the standard, points along the measured acceleration."""
    _, rows = read_aem(export_flight(flight, "aem", tmp_path / "a.aem").read_text())
    time, _, velocity, _ = read_oem(export_flight(flight, "oem", tmp_path / "a.oem"))
    q1, q2, q3, qc = np.array(rows)[:, 1:].T
    # Third row of the matrix from frame A to frame B (CCSDS 504.0-B, annex): body z in frame A.
    z = np.column_stack(
        (2 * (q1 * q3 + q2 * qc), 2 * (q2 * q3 - q1 * qc), -(q1**2) - q2**2 + q3**2 + qc**2)
    )
    thrust = np.gradient(velocity, time, axis=0) + [0.0, 0.0, 1.622]
    thrust /= np.linalg.norm(thrust, axis=1)[:, None]
    angle = np.rad2deg(np.arccos(np.clip((z * thrust).sum(axis=1), -1.0, 1.0)))
    tilted = np.rad2deg(np.arccos(z[:, 2])) > 15.0
    assert tilted.sum() > 20
    assert np.median(angle[tilted]) < 2.0


def test_an_aem_fixed_to_the_moon(flight, tmp_path):
    options = ExportOptions(longitude=30.0)
    path = export_flight(with_moon(flight), "aem", tmp_path / "a.aem", options)
    last = np.array(read_aem(path.read_text())[1])[-1, 1:]
    # The landed lander stands along the local vertical.
    lat, lon = np.deg2rad([20.0, 30.0])
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    z = Rotation.from_quat(last).apply([0.0, 0.0, 1.0])
    expected = Rotation.from_quat(columns(flight.trajectory, "attitude", "xyzw")[-1])
    assert z @ up == pytest.approx(expected.apply([0.0, 0.0, 1.0])[2], abs=1e-9)


def test_a_longitude_needs_a_moon(flight, tmp_path):
    for changed, longitude, words in (
        (flight, 30.0, r"--longitude: must be omitted.*no table \[moon\]"),
        (with_moon(flight), 400.0, "--longitude: must be between -180 and 360"),
        (with_moon(flight), float("nan"), "--longitude: must be between -180 and 360"),
    ):
        with pytest.raises(InputError, match=words):
            export_flight(changed, "oem", tmp_path / "a.oem", ExportOptions(longitude=longitude))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "epoch", ["", "today", "2027-03-01", "2027-13-01T00:00:00", "2027-02-30T00:00:00",
              "1970-12-31T23:59:59", "2027-03-01T12:00:00+02:00", "3000-01-01T00:00:00"],
)  # fmt: skip
def test_a_bad_epoch_is_refused(flight, tmp_path, epoch):
    for name, suffix in (("oem", ".oem"), ("aem", ".aem"), ("mcap", ".mcap")):
        with pytest.raises(InputError, match="--epoch: must be a date and time"):
            export_flight(flight, name, tmp_path / f"a{suffix}", ExportOptions(epoch=epoch))
    assert not list(tmp_path.iterdir())


def test_values_that_are_not_finite_are_omitted(flight, tmp_path):
    table = {name: values.copy() for name, values in flight.navigation.items()}
    table["position_x"][:3] = np.nan
    table["covariance_00"][:5] = np.nan
    changed = replace(flight, navigation=table)
    options = ExportOptions(state="estimate")
    time, _, _, segment = read_oem(export_flight(changed, "oem", tmp_path / "a.oem", options))
    assert len(time) == len(table["time"]) - 3
    assert len(list(segment.covariances)) == len(table["time"]) - 5
    assert "nan" not in (tmp_path / "a.oem").read_text()
    zero = {n: 0.0 * v if n.startswith("covariance") else v for n, v in flight.navigation.items()}
    path = export_flight(replace(flight, navigation=zero), "oem", tmp_path / "a.oem", options)
    assert "COVARIANCE" not in path.read_text()
    table["attitude_w"][:] = np.nan
    with pytest.raises(InputError, match="no value is finite"):
        export_flight(changed, "oem", tmp_path / "a.oem", options)
    with pytest.raises(InputError, match="the record has no estimates"):
        export_flight(replace(flight, navigation={}), "aem", tmp_path / "a.aem", options)


def test_times_increase(flight, tmp_path):
    table = {name: np.append(v, v[-1]) for name, v in flight.trajectory.items()}
    time, *_ = read_oem(export_flight(replace(flight, trajectory=table), "oem", tmp_path / "a.oem"))
    assert (np.diff(time) > 0.0).all() and len(time) == len(table["time"]) - 1


def test_a_hostile_name_stays_on_its_line(flight, tmp_path):
    lines = flight.scenario.splitlines()
    scenario = "\n".join(
        ['name = "x\\nMETA_STOP\\u0000=é"', *(t for t in lines if t[:4] != "name")]
    )
    path = export_flight(replace(flight, scenario=scenario), "oem", tmp_path / "a.oem")
    assert read_oem(path)[3].metadata["OBJECT_NAME"] == "x_META_STOP___"


SITE = '\n[site]\nlatitude_deg = 20.0\nlongitude_deg = 330.0\ntime = "2027-03-01T10:20:30.25Z"\n'


def _dated(flight, *, has_moon, site=SITE):
    """Return a flight whose scenario has a site."""
    # The recorded directions of the Sun would contradict the date.
    keep = re.sub(r"(?m)^(earth_)?(azimuth|elevation)_deg = .*\n", "", flight.scenario)
    moon = f"\n[moon]\nradius_m = {MOON}\n" if has_moon else ""
    return replace(flight, scenario=keep + site + moon)


def test_the_date_of_the_site_is_the_default_epoch(flight, tmp_path):
    path = export_flight(_dated(flight, has_moon=False), "oem", tmp_path / "a.oem")
    segment = read_oem(path)[3]
    assert segment.metadata["START_TIME"].isot == "2027-03-01T10:20:30.250000"
    assert segment.metadata["REF_FRAME"] == "LUNARSIM_SITE_ENU"
    assert "is site.time of the scenario" in path.read_text()
    assert "no date" not in path.read_text()
    options = ExportOptions(epoch="2030-01-01T00:00:00")
    path = export_flight(_dated(flight, has_moon=False), "oem", tmp_path / "b.oem", options)
    assert read_oem(path)[3].metadata["START_TIME"].isot == "2030-01-01T00:00:00.000000"
    assert "given to the export" in path.read_text()


def test_the_place_of_the_site_is_the_default_longitude(flight, tmp_path):
    dated = _dated(flight, has_moon=True)
    for suffix in ("oem", "aem"):
        path = export_flight(dated, suffix, tmp_path / f"a.{suffix}")
        options = ExportOptions(epoch="2027-03-01T10:20:30.250000", longitude=330.0)
        other = export_flight(with_moon(flight), suffix, tmp_path / f"b.{suffix}", options)
        numbers = [
            [line for line in one.read_text().splitlines() if line.startswith("2027")]
            for one in (path, other)
        ]
        assert numbers[0] == numbers[1]
        assert len(numbers[0]) > 10
        assert "MOON_ME" in path.read_text()


def test_a_date_before_the_years_of_exports_needs_an_epoch(flight, tmp_path):
    old = SITE.replace("2027", "1969")
    dated = _dated(flight, has_moon=False, site=old)
    with pytest.raises(InputError, match=r"site\.time: .*from 1971.*got '1969.*--epoch"):
        export_flight(dated, "oem", tmp_path / "a.oem")
    export_flight(dated, "oem", tmp_path / "a.oem", ExportOptions(epoch="1971-07-30T00:00:00"))
