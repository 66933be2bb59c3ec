"""Camera images in a flight record: the frames of the flight, with time and pose."""

from __future__ import annotations

import json
import re
import shutil

import cv2
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.flight_execution import build_plan
from lunarsim.campaign.run import run
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.errors import InputError
from lunarsim.messages.measurements import CameraImage
from lunarsim.models.camera import CameraModel
from lunarsim.scenario import Scenario
from lunarsim.scenario.scenario_warnings import warnings_for
from lunarsim.sensors.framing_camera import FramingCamera
from lunarsim.simulation import Flight, Simulation
from lunarsim.simulation.checkpoint import Checkpoint
from lunarsim.simulation.columns import SCHEMA_VERSION
from lunarsim.simulation.flight_files import digest_of
from lunarsim.simulation.image_record import ImageRecorder
from lunarsim.simulation.recorder import MessageRecorder
from tests.worlds import TINY_FLIGHT

CAMERAS = {
    "wide": {"kind": "camera", "width": 64, "height": 48, "exposure_control": "auto"},
    "deep": {
        "kind": "camera", "width": 40, "height": 40, "bits": 12,
        "distortion": [-0.05, 0.01, 0.002, -0.001, 0.003],
    },
}  # fmt: skip


def scenario(images: bool = True, seconds: float = 4.0) -> Scenario:
    return Scenario.from_dict(TINY_FLIGHT).changed(
        sensors=CAMERAS,
        tasking={
            "wide": {"kind": "periodic", "rate_hz": 2.0},
            "deep": {"kind": "periodic", "rate_hz": 1.0},
        },
        start={"position_m": [-90.0, -40.0, 130.0], "velocity_m_s": [9.0, 4.0, -9.0]},
        simulation={"max_time_s": seconds},
        record={"images": images},
    )


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return a flight with its frames by camera, and the folder of its record."""
    tap = MessageRecorder()
    simulation = Simulation(scenario(), 5, "no-divert", tap=tap)
    flight = simulation.run()
    frames: dict[str, list[CameraImage]] = {name: [] for name in CAMERAS}
    for measurements, _, _ in tap.exchanges:
        for sensor, measurement in measurements.items:
            if sensor in frames:
                frames[sensor].append(measurement)
    return flight, frames, flight.save(tmp_path_factory.mktemp("images") / "flight")


@pytest.mark.parametrize(("camera", "dtype"), [("wide", np.uint8), ("deep", np.uint16)])
def test_images_of_the_record_are_the_frames_of_the_flight(flown, camera, dtype):
    _, frames, folder = flown
    loaded = Flight.load(folder).images[camera]
    table = pd.read_parquet(folder / f"images.{camera}.parquet")
    assert len(frames[camera]) >= 4
    # The last frame of the flight can come after the last command.
    assert len(frames[camera]) <= len(loaded) == len(table) <= len(frames[camera]) + 1
    for index, frame in enumerate(frames[camera]):
        other_reader = cv2.imread(str(folder / table["file"][index]), cv2.IMREAD_UNCHANGED)
        for counts in (loaded[index], other_reader):
            assert counts.dtype == frame.counts.dtype == dtype
            assert np.array_equal(counts, frame.counts)
        assert table["time"][index] == frame.time
    assert np.ptp(loaded[0]) > 10


def test_each_image_has_the_true_pose_of_its_camera(flown):
    flight, frames, folder = flown
    truth = pd.DataFrame(flight.trajectory).set_index("time")
    table = pd.read_parquet(folder / "images.wide.parquet")
    for index, frame in enumerate(frames["wide"]):
        lander = truth.loc[frame.time]
        body = Rotation.from_quat(lander[[f"attitude_{a}" for a in "xyzw"]])
        axes = Rotation.from_quat(table.loc[index, [f"attitude_{a}" for a in "xyzw"]])
        assert axes.as_matrix() == pytest.approx(body.as_matrix() @ frame.camera.mount)
        here = lander[[f"position_{a}" for a in "xyz"]] + body.apply(frame.camera.offset)
        there = table.loc[index, [f"position_{a}" for a in "xyz"]]
        assert there.to_numpy() == pytest.approx(here.to_numpy())
    assert table["position_z"].is_monotonic_decreasing


def test_the_pose_includes_the_place_of_the_camera_on_the_lander():
    camera = CameraModel(width=3, height=2, offset=(1.0, 2.0, -3.0))

    class Lander:
        position = np.array([10.0, 20.0, 30.0])
        attitude = Rotation.from_euler("z", 90, degrees=True).as_quat()

    recorder = ImageRecorder("eye")
    assert recorder.add(CameraImage(1.0, np.zeros((2, 3), np.uint8), camera), Lander())
    columns = recorder.record().columns
    assert [columns[f"position_{a}"][0] for a in "xyz"] == pytest.approx([8.0, 21.0, 27.0])
    assert np.isnan(columns["exposure"][0])  # the camera does not report it


def test_the_table_has_exposure_and_geometry_with_units(flown):
    _, frames, folder = flown
    wide, deep = (pd.read_parquet(folder / f"images.{name}.parquet") for name in CAMERAS)
    given = [frame.exposure for frame in frames["wide"]]
    assert list(wide["exposure"][: len(given)]) == given
    assert wide["exposure"].nunique() > 1  # automatic exposure
    assert (deep["exposure"] == 2e-3).all()
    lens = {"k1": -0.05, "k2": 0.01, "p1": 0.002, "p2": -0.001, "k3": 0.003}  # OpenCV's order
    for name, value in lens.items():
        assert (deep[name] == value).all() and (wide[name] == 0.0).all()
    focal = frames["wide"][0].camera.fx
    pinhole = {"fx": focal, "fy": focal, "cx": 31.5, "cy": 23.5}
    for name, value in pinhole.items():
        assert (wide[name] == value).all()
    assert (wide["width"] == 64).all() and (wide["height"] == 48).all()
    metadata = pq.read_schema(folder / "images.wide.parquet").metadata
    assert metadata[b"unit:position_x"] == b"m"
    assert metadata[b"frame:attitude_w"].startswith(b"true ENU")
    assert json.loads((folder / "flight.json").read_text())["schema_version"] == SCHEMA_VERSION


def test_images_are_not_recorded_by_default_and_do_not_change_the_flight(flown):
    flight, _, _ = flown
    plain = Simulation(scenario(images=False), 5, "no-divert").run()
    assert plain.images == {} and plain.readings == flight.readings == {}
    for name, column in plain.trajectory.items():
        assert np.array_equal(column, flight.trajectory[name])


def test_a_record_of_measurements_has_no_images():
    settings = scenario(seconds=0.5).changed(record={"images": False, "measurements": True})
    flight = Simulation(settings, 5, "no-divert").run()
    assert flight.images == {} and "imu" in flight.readings


def test_images_of_a_camera_with_is_recorded_are_always_recorded(monkeypatch):
    monkeypatch.setattr(FramingCamera, "is_recorded", True, raising=False)
    flight = Simulation(scenario(images=False, seconds=0.5), 5, "no-divert").run()
    assert set(flight.images) == set(CAMERAS) and flight.readings == {}


def test_images_survive_a_checkpoint(flown):
    flight, _, _ = flown
    simulation = Simulation(scenario(), 5, "no-divert")
    while simulation.time < 1.5:
        simulation.step()
    kept = Checkpoint(simulation)
    for again in (kept.resumed().run(), simulation.run()):
        for name, images in flight.images.items():
            assert again.images[name].encoded == images.encoded
            for column, values in images.columns.items():
                assert np.array_equal(again.images[name].columns[column], values, equal_nan=True)


def test_a_loaded_record_saves_the_same_images_and_no_older_ones(flown, tmp_path):
    _, _, folder = flown
    other = tmp_path / "flight"
    shutil.copytree(folder, other)
    (other / "images" / "wide" / "notes.png").write_bytes(b"mine")
    short = Simulation(scenario(seconds=1.0), 6, "no-divert").run()
    short.save(other)
    assert sorted(p.name for p in (other / "images" / "deep").iterdir()) == [
        f"{k:06d}.png" for k in range(len(short.images["deep"]))
    ]
    assert (other / "images" / "wide" / "notes.png").read_bytes() == b"mine"
    again = Flight.load(Flight.load(folder).save(tmp_path / "again"))
    assert again.images["deep"].encoded == Flight.load(folder).images["deep"].encoded
    Simulation(scenario(images=False, seconds=1.0), 6, "no-divert").run().save(other)
    assert not list(other.glob("images.*"))


@pytest.mark.parametrize("limit", ["MAX_READINGS_BYTES", "MAX_IMAGES"])
def test_images_beyond_the_maximum_size_are_left_out_with_an_event(tmp_path, monkeypatch, limit):
    value = 2 * 64 * 48 if limit == "MAX_READINGS_BYTES" else 2
    monkeypatch.setattr(f"lunarsim.simulation.image_record.{limit}", value)
    flight = Simulation(scenario(), 5, "no-divert").run()
    full = [event["sensor"] for event in flight.events if event["name"] == "recording-full"]
    # An image of the 12-bit camera has 3200 bytes, so that only one of them fits.
    kept = {"wide": 2, "deep": 1 if limit == "MAX_READINGS_BYTES" else 2}
    assert {name: len(images) for name, images in flight.images.items()} == kept
    assert sorted(full) == ["deep", "wide"]  # once each


def forged(folder, name, data):
    """Write other data into a file of a record, with its digest."""
    (folder / name).write_bytes(data)
    record = json.loads((folder / "flight.json").read_text())
    record["digests"][name] = digest_of(folder / name)
    (folder / "flight.json").write_text(json.dumps(record))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"no image", "not a valid PNG file"),
        (cv2.imencode(".png", np.zeros((48, 65), np.uint8))[1].tobytes(), "another size or type"),
        (cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1].tobytes(), "another size or"),
        (None, "no such file"),
        ("changed", "digest differs"),
    ],
)
def test_a_damaged_image_is_refused_by_its_name(flown, tmp_path, data, words):
    folder = shutil.copytree(flown[2], tmp_path / "flight")
    name = "images/wide/000001.png"
    if data is None:
        (folder / name).unlink()
    elif data == "changed":
        (folder / name).write_bytes((folder / "images/wide/000002.png").read_bytes())
    else:
        forged(folder, name, data)
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        Flight.load(folder)
    assert name in str(caught.value)


def test_an_image_that_cannot_be_decoded_is_refused_when_it_is_read(flown, tmp_path):
    folder = shutil.copytree(flown[2], tmp_path / "flight")
    name = "images/wide/000001.png"
    forged(folder, name, (folder / name).read_bytes()[:60])
    loaded = Flight.load(folder).images["wide"]
    assert loaded[0].shape == (48, 64)
    with pytest.raises(InputError, match="damaged image"):
        loaded[1]


def test_an_image_that_would_fill_the_memory_is_refused_before_it_is_decoded(flown, tmp_path):
    folder = shutil.copytree(flown[2], tmp_path / "flight")
    table = pd.read_parquet(folder / "images.wide.parquet")
    table["width"], table["height"] = 60_000.0, 60_000.0
    table.to_parquet(folder / "images.wide.parquet")
    forged(folder, "images.wide.parquet", (folder / "images.wide.parquet").read_bytes())
    name = "images/wide/000000.png"
    data = bytearray((folder / name).read_bytes())
    data[16:24] = 2 * (60_000).to_bytes(4, "big")
    forged(folder, name, bytes(data))
    with pytest.raises(InputError, match="MiB when decompressed"):
        Flight.load(folder)


def test_names_of_cameras_that_leave_the_folder_are_refused(flown, tmp_path):
    folder = shutil.copytree(flown[2], tmp_path / "flight")
    record = json.loads((folder / "flight.json").read_text())
    (folder / "flight.json").write_text(json.dumps(record | {"images": ["../wide"]}))
    with pytest.raises(InputError, match="name of letters"):
        Flight.load(folder)


@pytest.mark.parametrize(
    "counts", [np.zeros((2, 3)), np.zeros((3, 2), np.uint8), np.zeros((2, 3, 1), np.uint8)]
)
def test_a_custom_camera_with_other_counts_is_refused(counts):
    camera = CameraModel(width=3, height=2)
    image = CameraImage(0.0, counts, camera)
    with pytest.raises(InputError, match=r"sensors\.eye: must give counts of type uint8"):
        ImageRecorder("eye").add(image, None)


def test_a_record_of_images_without_a_camera_has_a_warning():
    no_camera = Scenario.from_dict(TINY_FLIGHT | {"record": {"images": True}})
    assert any(
        text.startswith("record.images = True: no effect") for text in warnings_for(no_camera)
    )
    texts = warnings_for(scenario(images=True))
    assert not any("record" in text for text in texts)
    assert any("record.images = true" in text for text in warnings_for(scenario(images=False)))
    with pytest.raises(InputError, match=r"record\.images"):
        Scenario.from_dict(TINY_FLIGHT | {"record": {"images": "yes"}})


def test_a_resumed_campaign_keeps_the_images_of_all_flights(tmp_path):
    """The arms share the path of a flight up to their decisions, by checkpoints."""
    folder = tmp_path / "campaign"
    spec = {
        "name": "seen", "seed": 3, "records": "all", "scenario": scenario(seconds=2.0).to_dict(),
        "factors": {"policy": ["no-divert", "safest"]},
    }  # fmt: skip
    for flights in (1, 2):
        plan = build_plan(CampaignSpec.from_dict(spec | {"flights": flights}), folder)
        run(plan, InlineEngine(), folder)
    records = sorted((folder / "flights").rglob("flight.json"))
    found = [Flight.load(record.parent).images["wide"] for record in records]
    assert [len(images) for images in found] == [4, 4, 4, 4]
    # The camera is pointed at the site, which is the same in both arms before a divert.
    first, second, *other_arm = (images.encoded[0] for images in found)
    assert other_arm == [first, second] and first != second
