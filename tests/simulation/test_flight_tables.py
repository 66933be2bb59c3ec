"""Tables of a flight record: estimates with covariance, commands, actuators, measurements."""

from __future__ import annotations

import json
import pickle
import shutil
from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.evaluation.consistency import normalised_squared_error
from lunarsim.onboard.policies.library import Safest, SafestOrAbort
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight, Simulation
from lunarsim.simulation.columns import ACTUATORS, COLUMN_TABLES, SCHEMA_VERSION
from lunarsim.simulation.recorder import MessageRecorder, Recorder
from tests.conftest import SCENARIOS
from tests.flight_comparison import assert_same, assert_the_same, replayed
from tests.navigation_errors import error_of

SEED = 4


def scenario_with(measurements: bool) -> Scenario:
    return Scenario.load(SCENARIOS / "instruments.toml").changed(
        terrain={"size_m": 160.0},
        rocks={"min_diameter_m": 0.6},
        start={"position_m": [-140.0, 0.0, 180.0], "velocity_m_s": [11.0, 0.0, -9.0]},
        initial_uncertainty={"position_m": 5.0, "attitude_deg": 0.5},
        sensors={"flash": {"rows": 32, "cols": 24}},
        tasking={"flash": {"kind": "periodic", "rate_hz": 2.0}},
        mappers={"dem": {"posting_m": 0.5, "size_m": 50.0}},
        simulation={"max_time_s": 14.0},
        record={"measurements": measurements},
    )


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return a flight with all measurements, its messages, its NEES in flight, and its folder."""
    tap = MessageRecorder()
    simulation = Simulation(scenario_with(True), SEED, "safest", tap=tap)

    def now():
        covariance = simulation.estimate.covariance
        return covariance, normalised_squared_error(error_of(simulation), covariance)

    live = [now()]
    while not simulation.done:
        simulation.step()
        live.append(now())
    flight = simulation.flight()
    folder = flight.save(tmp_path_factory.mktemp("tables") / "flight")
    return simulation, tap, flight, live, folder


def covariances(table: pd.DataFrame) -> np.ndarray:
    full = np.empty((len(table), 9, 9))
    i, j = np.triu_indices(9)
    full[:, i, j] = full[:, j, i] = table.filter(like="covariance_")
    return full


def test_nees_of_the_saved_flight_is_that_of_the_flight_itself(flown):
    """From the files alone, by pandas and SciPy."""
    simulation, _, _, live, folder = flown
    truth = pd.read_parquet(folder / "trajectory.parquet")
    found = pd.read_parquet(folder / "navigation.parquet")
    assert simulation.computer.navigation.has_local_azimuth
    assert len(found) == len(live) > 100
    assert (found["time"] == truth["time"]).all()
    recorded = covariances(found)
    expected = np.array([covariance for covariance, _ in live])
    upper = np.triu_indices(9)
    assert np.array_equal(recorded[:, *upper], expected[:, *upper])
    columns = [f"{name}_{axis}" for name in ("position", "velocity") for axis in "xyz"]
    quaternion = [f"attitude_{axis}" for axis in "xyzw"]
    turn = Rotation.from_quat(truth[quaternion]) * Rotation.from_quat(found[quaternion]).inv()
    error = np.hstack((truth[columns] - found[columns], turn.as_rotvec()))
    nees = (error * np.linalg.solve(recorded, error[..., None])[..., 0]).sum(axis=1)
    assert nees == pytest.approx([square for _, square in live], rel=1e-6)
    assert np.ptp(nees) > 1.0


def test_commands_are_those_that_the_vehicle_received(flown):
    simulation, tap, flight, _, _ = flown
    c = flight.commands
    assert len(c["time"]) == len(tap.exchanges)
    for n, (measurements, command, torques) in enumerate(tap.exchanges):
        assert c["time"][n] == measurements.time
        assert c["thrust"][n] == command.thrust
        assert np.array_equal([c[f"attitude_{a}"][n] for a in "xyzw"], command.attitude)
        assert np.array_equal([c[f"torque_{a}"][n] for a in "xyz"], torques.mean(axis=0))
    assert np.ptp(c["torque_x"]) > 0.0
    approach = flight.trajectory["phase"][1:] == 0
    end = simulation.computer.approach.end(np.zeros(3), simulation.lander).position
    above_site = c["target_position_z"] - flight.trajectory["site_z"][:-1]
    # A divert, or a new height of the terrain, changes the target in the cycle itself.
    assert np.median(above_site[approach]) == pytest.approx(end[2])
    assert np.isfinite(c["acceleration_z"]).all()


def test_readings_are_what_the_sensors_measured(flown):
    simulation, tap, flight, _, folder = flown
    readings = Flight.load(folder).readings
    assert set(readings) == set(simulation.scenario.sensors)
    given: dict[str, list] = {}
    for measurements, _, _ in tap.exchanges:  # the last ones come after the last command
        for sensor, measurement in measurements.items:
            given.setdefault(sensor, []).append(measurement)
    imu, scans = readings["imu"], given["flash"]
    for field in ("angle", "velocity"):
        measured = np.vstack([getattr(m, field) for m in given["imu"]])
        recorded = np.column_stack([imu[f"{field}_{k}"] for k in range(3)])
        assert recorded[: len(measured)].tobytes() == measured.tobytes()
        assert len(recorded) - len(measured) <= 10
    assert np.diff(imu["sample"]).max() == 1
    assert len(imu["time"]) > 9 * len(flight.trajectory["time"])
    for field in ("range", "sigma"):
        measured = np.concatenate([getattr(m, field) for m in scans])
        recorded = readings["flash"][field][: len(measured)]
        assert np.array_equal(recorded, measured, equal_nan=True)
    mounts = np.column_stack([readings["flash"][f"mount_{k}"] for k in range(9)])
    assert np.array_equal(mounts[::768][: len(scans)], [m.mount.ravel() for m in scans])
    speeds = np.column_stack([readings["velocimeter"][f"speed_{k}"] for k in range(3)])
    measured = np.array([m.speed for m in given["velocimeter"]])
    assert np.array_equal(speeds[: len(measured)], measured, equal_nan=True)
    attitudes = np.column_stack([readings["stars"][f"attitude_{k}"] for k in range(4)])
    measured = np.array([m.attitude for m in given["stars"]])
    assert np.array_equal(attitudes[: len(measured)], measured, equal_nan=True)


def test_a_flight_with_measurements_comes_back_to_the_last_bit(flown):
    _, _, flight, _, folder = flown
    before, after = asdict(flight), asdict(Flight.load(folder))
    for record in (before, after):
        record["first_map"].pop("covariance")
    assert_same(before, after)


def test_the_record_does_not_change_the_flight(flown):
    """The computer gets the same briefing, and the flight has the same bits again."""
    simulation, tap, flight, _, _ = flown
    other = MessageRecorder()
    again = Simulation(scenario_with(False), SEED, "safest", tap=other)
    assert pickle.dumps(other.briefing) == pickle.dumps(tap.briefing)
    plain = again.run()
    assert plain.readings == {} and flight.readings
    for table in COLUMN_TABLES:
        assert_same(getattr(plain, table.name), getattr(flight, table.name), table.name)
    assert plain.actuators == {}
    assert (
        simulation.scenario.changed(record=None).to_dict()
        == again.scenario.changed(record=None).to_dict()
    )


def test_the_computer_flies_the_same_from_its_measurements_without_a_world(flown, tmp_path):
    """What is recorded of the truth cannot have entered a command."""
    _, tap, *_ = flown
    assert_the_same(tap.exchanges, replayed(tap, Safest(), tmp_path))


def test_files_state_unit_and_frame_of_every_column(flown):
    *_, folder = flown
    for table in COLUMN_TABLES:
        if table is ACTUATORS:
            continue
        schema = pq.read_schema(folder / f"{table.name}.parquet")
        assert schema.names == list(table.columns())
        for name, group in table.columns().items():
            assert schema.metadata[f"unit:{name}".encode()] == group.unit.encode()
    assert schema.metadata[b"frame:target_position_x"].startswith(b"local ENU")


def test_a_record_of_schema_version_1_loads_without_the_new_tables(flown, tmp_path):
    _, _, flight, _, _ = flown
    folder = flight.save(tmp_path / "old")
    text = json.loads((folder / "flight.json").read_text(encoding="utf-8"))
    for name in ("navigation", "commands"):
        (folder / f"{name}.parquet").unlink()
        del text["digests"][f"{name}.parquet"]
    del text["schema_version"], text["tables"]
    (folder / "flight.json").write_text(json.dumps(text), encoding="utf-8")
    old = Flight.load(folder)
    assert old.navigation == old.commands == old.actuators == {}
    assert_same(old.trajectory, flight.trajectory)
    # Saved again, it still has no estimates, also where another flight was.
    again = Flight.load(old.save(flight.save(tmp_path / "again")))
    assert again.navigation == {} and not (tmp_path / "again" / "navigation.parquet").exists()


@pytest.mark.parametrize("damage", ["rows", "times"])
def test_a_table_that_does_not_fit_its_trajectory_is_refused(flown, tmp_path, damage):
    _, _, flight, _, _ = flown
    rows = {name: column.copy() for name, column in flight.navigation.items()}
    if damage == "rows":
        rows = {name: column[:3] for name, column in rows.items()}
    else:
        rows["time"][5] = np.nan
    folder = replace(flight, navigation=rows).save(tmp_path / "other")
    with pytest.raises(InputError, match="navigation") as caught:
        Flight.load(folder)
    assert ("rows" if damage == "rows" else "times are not finite") in str(caught.value)


def test_there_is_no_guidance_target_during_an_abort():
    policy = SafestOrAbort(p_safe_min=1.0, abort_altitude=170.0)
    commands = Simulation(scenario_with(False), SEED, policy).run().commands
    aborts = commands["abort"] == 1.0
    assert 0 < aborts.sum() < len(aborts)
    for name in ("target_position_x", "target_velocity_z"):
        assert np.isnan(commands[name][aborts]).all()
        assert np.isfinite(commands[name][~aborts]).any()


def test_commands_to_thrusters_after_the_touchdown_are_not_recorded(flown):
    simulation, _, flight, _, _ = flown
    end = simulation.computer.time
    rows = [np.full(6, end - 0.02), np.full(6, end), np.full(6, end + 0.02)]
    made = Recorder(flight.target).flight(
        simulation.computer, scenario="", seed={}, policy="", outcome=flight.outcome, actuators=rows
    )
    assert list(made.actuators["time"]) == [end - 0.02, end]
    assert list(made.actuators)[-1] == "on_time_0"


@pytest.mark.parametrize(
    ("version", "tables"), [(2, []), (2, ["trajectory", "commands"]), (0, []), (-1, [])]
)
def test_a_record_without_the_tables_of_its_version_is_refused(flown, tmp_path, version, tables):
    folder = tmp_path / "flight"
    shutil.copytree(flown[4], folder)
    record = json.loads((folder / "flight.json").read_text())
    changed = record | {"schema_version": version, "tables": tables}
    (folder / "flight.json").write_text(json.dumps(changed))
    with pytest.raises(InputError, match="flight"):
        Flight.load(folder)


def test_readings_beyond_the_maximum_size_are_left_out_with_an_event(tmp_path, monkeypatch):
    monkeypatch.setattr("lunarsim.simulation.recorder.MAX_READINGS_BYTES", 20_000)
    simulation = Simulation(scenario_with(True), SEED, "safest")
    while simulation.time < 4.0:
        simulation.step()
    flight = Flight.load(simulation.flight().save(tmp_path / "flight"))
    full = [event["sensor"] for event in flight.events if event["name"] == "recording-full"]
    assert sorted(full) == ["flash", "imu"]  # once each; the others have few numbers
    sizes = {
        name: sum(c.nbytes for c in columns.values()) for name, columns in flight.readings.items()
    }
    assert 10_000 < sizes["imu"] <= 20_000
    assert len(flight.readings["stars"]["time"]) > 3


def test_a_record_of_a_later_schema_version_is_refused(flown, tmp_path):
    _, _, flight, _, _ = flown
    folder = flight.save(tmp_path / "new")
    text = json.loads((folder / "flight.json").read_text(encoding="utf-8"))
    text["schema_version"] = SCHEMA_VERSION + 1
    (folder / "flight.json").write_text(json.dumps(text), encoding="utf-8")
    with pytest.raises(InputError, match=f"schema version {SCHEMA_VERSION} or lower, not"):
        Flight.load(folder)
