"""MCAP: the package mcap reads the messages, and their own schemas decode them."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import util

import cv2
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.exports import ExportOptions, export_flight
from lunarsim.scenario import Scenario
from lunarsim.simulation.worlds import rebuild_world

EPOCH_NS = 946_728_000_000_000_000  # 2000-01-01T12:00:00


def decode(schema, data):
    """Return a message by the schema in the file, not by installed classes."""
    if schema.encoding == "jsonschema":
        return json.loads(data)
    files = FileDescriptorSet.FromString(schema.data)
    pool = DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString(data)


def read(path):
    """Return pairs of time since the epoch, s, and message, by topic."""
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            time = 1e-9 * (message.log_time - EPOCH_NS)
            found.setdefault(channel.topic, []).append((time, decode(schema, message.data)))
    return found


@pytest.fixture(scope="module")
def recording(flight, tmp_path_factory):
    return read(export_flight(flight, "mcap", tmp_path_factory.mktemp("mcap") / "a.mcap"))


def vector(message, axes="xyz"):
    return np.array([getattr(message, axis) for axis in axes])


def columns(table, name, axes="xyz"):
    return np.column_stack([table[f"{name}_{axis}"] for axis in axes])


def stamp(message):
    return message.timestamp.seconds + 1e-9 * message.timestamp.nanos - 1e-9 * EPOCH_NS


def test_the_topics(recording):
    assert set(recording) == {
        "/tf", "/path", "/scene", "/scans", "/map/dem", "/events", "/trajectory", "/navigation",
        "/commands", "/camera/camera/image", "/camera/camera/calibration",
    }  # fmt: skip


@pytest.mark.parametrize("name", ["trajectory", "navigation", "commands"])
def test_tables_have_the_numbers_of_the_flight(recording, flight, name):
    table, rows = getattr(flight, name), recording[f"/{name}"]
    assert len(rows) == len(table["time"])
    assert [time for time, _ in rows] == pytest.approx(table["time"], abs=1e-6)
    for column, values in table.items():
        found = np.array([row[column] for _, row in rows], dtype=float)
        np.testing.assert_array_equal(found, np.where(np.isfinite(values), values, np.nan))


def test_true_poses(recording, flight):
    poses = [(time, m) for time, m in recording["/tf"] if m.child_frame_id == "lander"]
    table = flight.trajectory
    assert [t for t, _ in poses] == pytest.approx(table["time"], abs=1e-6)
    assert [stamp(m) for _, m in poses] == pytest.approx(table["time"], abs=1e-6)
    position = np.array([vector(m.translation) for _, m in poses])
    np.testing.assert_array_equal(position, columns(table, "position"))
    turn = Rotation.from_quat([vector(m.rotation, "xyzw") for _, m in poses])
    truth = Rotation.from_quat(columns(table, "attitude", "xyzw"))
    assert (turn.inv() * truth).magnitude().max() < 1e-7
    assert all(m.parent_frame_id == "site" for _, m in poses)
    ((_, path),) = recording["/path"]
    assert len(path.poses) == len(poses)
    np.testing.assert_array_equal(vector(path.poses[-1].position), position[-1])
    along = Rotation.from_quat([vector(pose.orientation, "xyzw") for pose in path.poses])
    assert (along.inv() * truth).magnitude().max() < 1e-7 and np.ptp(along.as_quat()[:, 1]) > 0.1


def test_each_message_and_entity_is_stamped_with_its_log_time(recording):
    count = 0
    for topic, rows in recording.items():
        for time, message in rows:
            if isinstance(message, dict):
                continue
            for stamped in message.entities if topic == "/scene" else [message]:
                assert stamp(stamped) == pytest.approx(time, abs=1e-6), topic
                count += 1
    assert count > 100


def test_scans_lie_on_the_true_terrain(recording, flight):
    clouds = recording["/scans"]
    assert [t for t, _ in clouds] == pytest.approx(np.unique(flight.scans[:, 3]), abs=1e-4)
    terrain = rebuild_world(flight).terrain
    points = []
    for _, cloud in clouds:
        assert [(f.name, f.offset, f.type) for f in cloud.fields] == [
            ("x", 0, 7), ("y", 4, 7), ("z", 8, 7),
        ]  # fmt: skip
        assert cloud.point_stride == 12 and cloud.frame_id == "site"
        points.append(np.frombuffer(cloud.data, "<f4").reshape(-1, 3))
    points = np.concatenate(points)
    assert len(points) == len(flight.scans)
    error = points[:, 2] - terrain.elevation(points[:, :2])
    assert np.nanmedian(np.abs(error)) < 0.2


def test_the_hazard_map_is_where_the_map_is(recording, flight):
    ((time, grid),) = recording["/map/dem"]
    record = flight.maps["dem"]
    layers, where = record.hazard_map, record.hazard_map.grid
    assert time == pytest.approx(record.time, abs=1e-6) and time < flight.duration - 1.0
    types = {"p_safe": "<f4", "elevation": "<f4", "observed": "u1"}
    rows = len(grid.data) // grid.row_stride
    raw = np.frombuffer(grid.data, np.uint8).reshape(rows, grid.column_count, grid.cell_stride)
    layer = {
        f.name: raw[..., f.offset :][..., : np.dtype(types[f.name]).itemsize]
        .copy().view(types[f.name])[..., 0]
        for f in grid.fields
    }  # fmt: skip
    corner, size = vector(grid.pose.position), grid.cell_size.x
    for x, y in ((where.x[5], where.y[50]), (where.x[30], where.y[12]), (where.x[60], where.y[40])):
        # The centre of a cell of the onboard map, in the true frame, in cells from the corner.
        col = int(np.floor((x - record.error[0] - corner[0]) / size))
        row = int(np.floor((y - record.error[1] - corner[1]) / size))
        i, j = int(np.argmin(np.abs(where.y - y))), int(np.argmin(np.abs(where.x - x)))
        assert layer["p_safe"][row, col] == layers.p_safe[i, j]
        assert layer["observed"][row, col] == layers.observed[i, j]
    seen = layers.observed & np.isfinite(layers.elevation)
    expected = layers.elevation[seen] - np.float32(record.error[2])
    np.testing.assert_allclose(layer["elevation"][seen], expected, atol=1e-5)
    terrain = rebuild_world(flight).terrain
    i, j = np.nonzero(seen)
    centres = corner[:2] + size * (np.column_stack((j, i)) + 0.5)
    error = layer["elevation"][seen] - terrain.elevation(centres)
    assert np.nanmedian(np.abs(error)) < 0.2


def test_images_with_their_poses(recording, flight):
    images = flight.images["camera"]
    found = recording["/camera/camera/image"]
    assert len(found) == len(images) > 5
    for k, (time, message) in enumerate(found):
        assert time == pytest.approx(images.columns["time"][k], abs=1e-6)
        assert (message.format, message.frame_id) == ("png", "camera.camera")
        counts = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(counts, images[k])
    poses = [m for _, m in recording["/tf"] if m.child_frame_id == "camera.camera"]
    for name, axes, part in (("position", "xyz", "translation"), ("attitude", "xyzw", "rotation")):
        rows = [vector(getattr(m, part), axes) for m in poses]
        np.testing.assert_array_equal(rows, columns(images.columns, name, axes))
    calibration = recording["/camera/camera/calibration"][0][1]
    assert (calibration.width, calibration.height) == (48, 32)
    c = {name: values[0] for name, values in images.columns.items()}
    assert list(calibration.K) == [c["fx"], 0.0, c["cx"], 0.0, c["fy"], c["cy"], 0.0, 0.0, 1.0]


def test_a_calibration_projects_as_the_camera_does(flight, tmp_path):
    """Each parameter differs from all others; `plumb_bob` has the order k1, k2, p1, p2, k3."""
    given = {"fx": 101.0, "fy": 102.0, "cx": 23.0, "cy": 15.0, "k1": 0.1, "k2": -0.02, "p1": 3e-3,
             "p2": -4e-3, "k3": 5e-4}  # fmt: skip
    images = flight.images["camera"]
    columns = {n: np.full_like(v, given.get(n, v[0])) for n, v in images.columns.items()}
    changed = replace(flight, images={"camera": replace(images, columns=columns)})
    found = read(export_flight(changed, "mcap", tmp_path / "a.mcap"))
    calibration = found["/camera/camera/calibration"][0][1]
    assert calibration.distortion_model == "plumb_bob"
    assert list(calibration.D) == [given[name] for name in ("k1", "k2", "p1", "p2", "k3")]
    projection = np.array(calibration.P).reshape(3, 4)
    np.testing.assert_array_equal(projection[:, :3], np.array(calibration.K).reshape(3, 3))
    np.testing.assert_array_equal(projection[:, 3], 0.0)
    u, v, _ = projection @ [0.1, 0.2, 1.0, 1.0]
    assert (u, v) == pytest.approx((0.1 * 101.0 + 23.0, 0.2 * 102.0 + 15.0))


def test_events_and_diverts_are_in_the_log(recording, flight):
    found = [(time, m.name) for time, m in recording["/events"]]
    expected = [(e["time"], e["name"]) for e in flight.events]
    expected += [(d["time"], "divert") for d in flight.decisions]
    assert sorted(n for _, n in found) == sorted(n for _, n in expected)
    assert [t for t, _ in found] == pytest.approx(sorted(t for t, _ in expected), abs=1e-6)
    texts = [m.message for _, m in recording["/events"] if m.name == "divert"]
    for text, decision in zip(texts, flight.decisions, strict=True):
        details = json.loads(text.removeprefix("divert: "))
        assert details["reason"] == decision["reason"]
        assert details["to"] == pytest.approx(list(decision["to"]))


def test_the_scene_has_lander_target_and_candidates(recording, flight):
    entities = {e.id: e for _, m in recording["/scene"] for e in m.entities}
    assert entities["lander"].frame_id == "lander"
    times = {e.id: time for time, m in recording["/scene"] for e in m.entities}
    decided = flight.decisions[-1]["time"]
    assert times == pytest.approx(
        {"lander": 0.0, "target": 0.0, "site": decided, "candidates": decided}, abs=1e-6
    )
    assert decided > 1.0
    (body,) = entities["lander"].cylinders
    vehicle = Scenario.world_from_toml(flight.scenario).vehicle.make()
    assert vector(body.size) == pytest.approx(
        (2.0 * vehicle.leg_radius, 2.0 * vehicle.leg_radius, 2.0 * vehicle.com_height)
    )
    target = vector(entities["target"].spheres[0].pose.position)
    np.testing.assert_array_equal(target, flight.target)
    candidates = entities["candidates"].spheres
    assert len(candidates) == len(flight.candidates)
    k = int(np.argmax(flight.candidates[:, 3]))
    expected = flight.candidates[k, :3] - flight.map_error
    assert vector(candidates[k].pose.position) == pytest.approx(expected, abs=1e-5)
    last = flight.decisions[-1]["to"] - flight.map_error
    assert vector(entities["site"].spheres[0].pose.position) == pytest.approx(last, abs=1e-9)
    assert candidates[k].color.g == pytest.approx(flight.candidates[k, 3], abs=1e-6)


def test_schemas_of_tables_have_the_units(flight, tmp_path):
    with export_flight(flight, "mcap", tmp_path / "a.mcap").open("rb") as file:
        schemas = {s.name: s for s in make_reader(file).get_summary().schemas.values()}
    fields = json.loads(schemas["lunarsim.trajectory"].data)["properties"]
    assert "; m/s" in fields["velocity_x"]["description"]
    assert "true ENU" in fields["velocity_x"]["description"]


def test_the_epoch(flight, tmp_path):
    options = ExportOptions(epoch="2000-01-01T12:00:10")
    found = read(export_flight(flight, "mcap", tmp_path / "a.mcap", options))
    assert found["/trajectory"][0][0] == pytest.approx(10.0, abs=1e-6)


def test_numbers_that_are_not_finite_are_null(flight, tmp_path):
    table = {name: values.copy() for name, values in flight.commands.items()}
    table["torque_x"][:] = np.inf
    found = read(export_flight(replace(flight, commands=table), "mcap", tmp_path / "a.mcap"))
    assert found["/commands"][0][1]["torque_x"] is None


@pytest.mark.parametrize("module", ["mcap", "foxglove_schemas_protobuf"])
def test_a_missing_package_is_named(flight, tmp_path, module, monkeypatch):
    find = util.find_spec
    monkeypatch.setattr(
        "lunarsim.exports.mcap_recording.find_spec",
        lambda name: None if name == module else find(name),
    )
    with pytest.raises(InputError, match="Install the extra `mcap`"):
        export_flight(flight, "mcap", tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())
