"""Recordings, read back by the chunk reader of Rerun, which shares no code with the writer."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import create_autospec

import cv2
import matplotlib as mpl
import numpy as np
import pytest
import rerun
from click.testing import CliRunner
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.rocks.field import RockField
from lunarsim.simulation.flight import Flight
from lunarsim.view import save_recording, viewer
from lunarsim.view.meshes import rock_mesh
from lunarsim.view.recording import Recording
from lunarsim.view.viewer import view_flight
from lunarsim.world.terrain import AlbedoMap, Terrain


def read(path):
    """Return times, s, and rows of each component, by entity and component."""
    found, static = {}, {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = [n for n in batch.schema.names if ":" in n]
        assert chunk.is_static or chunk.timeline_names == ["time"]
        times = None
        if not chunk.is_static:
            times = batch.column("time").cast("int64").to_numpy() / 1e9
        for name in names:
            rows = batch.column(name).to_pylist()
            key = str(chunk.entity_path), name
            if chunk.is_static:
                static[key] = rows[-1]
            else:
                found.setdefault(key, []).extend(zip(times, rows, strict=True))
    columns = {}
    for key, rows in found.items():
        rows.sort(key=lambda row: row[0])
        columns[key] = np.array([t for t, _ in rows]), [values for _, values in rows]
    return columns, static


@pytest.fixture(scope="session")
def recorded(flown, tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "flight.rrd"
    assert save_recording(flown.flight, path, flown.world) == path
    return read(path)


@pytest.fixture(scope="session")
def live(flown, tmp_path_factory):
    """Return the same flight, logged cycle by cycle."""
    path = tmp_path_factory.mktemp("live") / "flight.rrd"
    stream = rerun.RecordingStream("live")
    source = stream.binary_stream()
    recording = Recording(stream, flown.world, flown.lander)
    for part in flown.parts:
        recording.add(part)
    path.write_bytes(source.read(flush=True))
    return read(path)


def vectors(columns, entity, component):
    """Return times (n,) and the first value of each row (n, k)."""
    times, rows = columns[entity, component]
    return times, np.array([row[0] for row in rows])


def table(columns, name, axes="xyz"):
    return np.column_stack([columns[f"{name}_{axis}"] for axis in axes])


def test_true_pose_and_times(flown, recorded):
    columns, _ = recorded
    t = flown.flight.trajectory
    times, places = vectors(columns, "/world/lander", "Transform3D:translation")
    assert times == pytest.approx(t["time"], abs=1e-6)
    assert places == pytest.approx(table(t, "position"), abs=1e-3)
    _, found = vectors(columns, "/world/lander", "Transform3D:quaternion")
    expected = Rotation.from_quat(table(t, "attitude", "xyzw"))
    forward = Rotation.from_quat(found).apply([1.0, 0.2, 0.5])  # quaternions of Rerun are xyzw
    assert forward == pytest.approx(expected.apply([1.0, 0.2, 0.5]), abs=1e-5)
    assert np.ptp(forward, axis=0).max() > 0.1


def test_true_and_estimated_paths_are_connected_segments(flown, recorded):
    columns, _ = recorded
    expected = {
        "true_path": flown.flight.positions,
        "estimated_path": table(flown.flight.navigation, "position"),
    }
    assert np.abs(expected["true_path"] - expected["estimated_path"]).max() > 0.05
    for name, positions in expected.items():
        _, strips = columns[f"/world/{name}", "LineStrips3D:strips"]
        segments = np.array([row[0] for row in strips])
        assert segments[:, 1] == pytest.approx(positions, abs=1e-3)
        assert segments[1:, 0] == pytest.approx(positions[:-1], abs=1e-3)


def test_ellipsoid_has_three_sigma_of_the_position(flown, recorded):
    columns, _ = recorded
    n = flown.flight.navigation
    _, half = vectors(columns, "/world/covariance", "Ellipsoids3D:half_sizes")
    _, turn = vectors(columns, "/world/covariance", "Ellipsoids3D:quaternions")
    axes = Rotation.from_quat(turn).as_matrix()
    covariance = np.einsum("nij,nj,nkj->nik", axes, (half / 3.0) ** 2, axes)
    for name, i, j in (("00", 0, 0), ("01", 0, 1), ("02", 0, 2), ("12", 1, 2), ("22", 2, 2)):
        assert covariance[:, i, j] == pytest.approx(n[f"covariance_{name}"], rel=1e-3, abs=1e-7)


def test_hazard_map_has_the_colour_of_p_safe_at_each_cell(flown, recorded):
    columns, _ = recorded
    record = flown.flight.maps["dem"]
    m, g = record.hazard_map, record.hazard_map.grid
    (time,), (texture,) = columns["/world/hazard_map", "Mesh3D:albedo_texture_buffer"]
    assert time == pytest.approx(record.time, abs=1e-6)
    image = np.array(texture[0], np.uint8).reshape(g.rows, g.cols, 3)
    vertices = np.array(columns["/world/hazard_map", "Mesh3D:vertex_positions"][1][0])
    place = np.array(columns["/world/hazard_map", "Mesh3D:vertex_texcoords"][1][0])
    # Texture coordinates are linear in east and north: fit them.
    design = np.column_stack((vertices[:, :2], np.ones(len(vertices))))
    fit = np.linalg.lstsq(design, place, rcond=None)[0]
    assert design @ fit == pytest.approx(place, abs=1e-4)
    east, north = np.meshgrid(g.x - record.error[0], g.y - record.error[1])
    uv = np.column_stack((east.ravel(), north.ravel(), np.ones(east.size))) @ fit
    pixels = uv * (g.cols, g.rows) - 0.5
    assert np.abs(pixels - pixels.round()).max() < 0.02  # cell centres are pixel centres
    col, row = pixels.round().astype(int).T
    viridis = (255 * np.array(mpl.colormaps["viridis"].colors)).astype(int)
    expected = viridis[np.minimum((m.p_safe * 256).astype(int), 255)].reshape(-1, 3)
    expected[~m.observed.ravel()] = 128
    assert m.observed.any() and not m.observed.all() and np.ptp(m.p_safe) > 0.5
    assert np.abs(image[row, col].astype(int) - expected).max() <= 1
    ground = Terrain(flown.world.terrain.relief).elevation(vertices[:, :2])
    known = np.isfinite(ground)
    assert np.abs(vertices[known, 2] - ground[known]).max() < 0.05


def test_terrain_is_cut_out_where_the_hazard_map_is(flown, recorded):
    columns, _ = recorded
    vertices = np.array(columns["/world/terrain", "Mesh3D:vertex_positions"][1][0])
    ground = Terrain(flown.world.terrain.relief).elevation(vertices[:, :2])
    assert vertices[:, 2] == pytest.approx(ground, abs=1e-3)
    times, triangles = columns["/world/terrain", "Mesh3D:triangle_indices"]
    assert times[0] == 0.0 and times[1] == pytest.approx(flown.flight.maps["dem"].time, abs=1e-6)
    before, after = (len(rows) for rows in triangles)
    west, east, south, north = flown.flight.maps["dem"].hazard_map.grid.extent
    area = flown.world.terrain.bounds
    share = (east - west) * (north - south) / ((area[1] - area[0]) * (area[3] - area[2]))
    assert 1.0 - after / before == pytest.approx(share, abs=0.03)


def test_returns_lie_on_the_true_surface(flown, recorded):
    columns, _ = recorded
    times, rows = columns["/world/lidar", "Points3D:positions"]
    assert times == pytest.approx(np.unique(flown.flight.scans[:, 3]), abs=1e-5)
    assert sum(map(len, rows)) == len(flown.flight.scans)
    low = np.array(rows[-1])
    height = low[:, 2] - flown.world.terrain.elevation(low[:, :2])
    assert np.nanmedian(np.abs(height)) < 0.06
    # The local frame itself is off by more than that.
    error = flown.flight.maps["dem"].error
    shifted = low + error
    off = shifted[:, 2] - flown.world.terrain.elevation(shifted[:, :2])
    assert np.nanmedian(np.abs(off)) > 0.06 or np.abs(error).max() < 0.1


def test_sites_and_candidates_are_in_the_true_frame(flown, recorded):
    columns, _ = recorded
    t = flown.flight.trajectory
    _, sites = vectors(columns, "/world/site", "Transform3D:translation")
    local = np.column_stack([t[f"estimated_{a}"] for a in "xyz"]) - table(t, "position")
    assert sites == pytest.approx(table(t, "site") - local, abs=1e-3)
    candidate_times, rows = columns["/world/candidates", "Points3D:positions"]
    found = flown.flight.candidates
    assert len(rows[0]) == len(found)
    time = flown.flight.decisions[-1]["time"]
    assert candidate_times == pytest.approx([time], abs=1e-6) and time > 1.0
    error = local[np.argmin(np.abs(t["time"] - time))]
    assert np.abs(error).max() > 0.05
    assert np.array(rows[0]) == pytest.approx(found[:, :3] - error, abs=1e-3)


def test_camera_image_pose_and_pinhole(flown, recorded):
    columns, _ = recorded
    images = flown.flight.images["camera"]
    c = images.columns
    times, places = vectors(columns, "/world/cameras/camera", "Transform3D:translation")
    assert times == pytest.approx(c["time"], abs=1e-6)
    assert places == pytest.approx(table(c, "position"), abs=1e-3)
    _, turn = vectors(columns, "/world/cameras/camera", "Transform3D:quaternion")
    boresight = Rotation.from_quat(turn).apply([0.0, 0.0, 1.0])
    assert boresight == pytest.approx(
        Rotation.from_quat(table(c, "attitude", "xyzw")).apply([0, 0, 1]), abs=1e-5
    )
    assert (boresight[:, 2] < -0.3).all()  # down
    _, pinhole = vectors(columns, "/world/cameras/camera", "Pinhole:image_from_camera")
    u, v, w = pinhole[0].reshape(3, 3).T @ [0.1, 0.2, 1.0]  # columns first
    assert (u, v, w) == pytest.approx(
        (0.1 * c["fx"][0] + c["cx"][0] + 0.5, 0.2 * c["fy"][0] + c["cy"][0] + 0.5, 1.0)
    )
    _, blobs = columns["/world/cameras/camera/image", "EncodedImage:blob"]
    shown = cv2.imdecode(np.array(blobs[2][0], np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown.dtype == np.uint8 and images[2].dtype == np.uint16
    ratio = images[2].astype(float)[shown > 20] / shown[shown > 20]
    assert ratio.std() < 0.05 * ratio.mean()


def test_the_flame_points_down_in_proportion_to_thrust(flown, recorded):
    columns, _ = recorded
    _, arrows = vectors(columns, "/world/lander/flame", "Arrows3D:vectors")
    assert arrows[:, :2] == pytest.approx(0.0)
    thrust = flown.flight.trajectory["thrust"]
    assert arrows[:, 2] / arrows[:, 2].min() == pytest.approx(thrust / thrust.max(), abs=1e-5)
    assert arrows[:, 2].min() < -0.5


def test_the_lander_stands_on_its_legs(flown, recorded):
    """Body above the pads, legs from the body down to the pads, flame from below the body."""
    columns, static = recorded
    body = np.array(static["/world/lander/body", "Mesh3D:vertex_positions"])
    legs = np.array(static["/world/lander/legs", "LineStrips3D:strips"])
    assert legs[:, 1] == pytest.approx(flown.lander.pads, abs=1e-6)
    assert (legs[:, 0, 2] > body[:, 2].min()).all() and (legs[:, 0, 2] < body[:, 2].max()).all()
    assert body[:, 2].min() > legs[:, 1, 2].max()
    _, origins = vectors(columns, "/world/lander/flame", "Arrows3D:origins")
    assert origins[:, 2] == pytest.approx(body[:, 2].min())


def test_the_largest_rocks_are_drawn_as_half_ellipsoids_at_their_places():
    rng = np.random.default_rng(4)
    x, y, base, a, b, height, yaw = rng.uniform(0.1, 1.0, (7, 4010))
    rocks = RockField(x, y, base, a, b, height, yaw, np.zeros(4010, np.int64))
    mesh = rock_mesh(rocks)
    order = np.argsort(-a * b)[:4000]
    for k, points in zip(order, mesh.vertices.reshape(-1, 25, 3), strict=True):
        own = Rotation.from_euler("z", -yaw[k]).apply(points - [x[k], y[k], base[k]])
        assert ((own / [a[k], b[k], height[k]]) ** 2).sum(axis=1) == pytest.approx(1.0, abs=1e-4)
        assert own[:, 2].max() == pytest.approx(height[k], abs=1e-5) and own[:, 2].min() > -1e-5
    corners = mesh.vertices[mesh.triangles]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = (faces * mesh.normals[mesh.triangles].mean(axis=1)).sum(axis=1)
    assert (outward > 0.0).all()


def test_terrain_has_the_brightness_of_its_albedo(flown, tmp_path):
    grid = flown.world.terrain.relief.grid
    values = np.where(grid.centres()[..., 0] > 0.0, 1.4, 0.6).astype(np.float32)
    relief = flown.world.terrain.relief
    terrain = Terrain(relief, flown.world.terrain.rocks, albedo=AlbedoMap(grid, values))
    world = replace(flown.world, terrain=terrain)
    columns, _ = read(save_recording(flown.flight, tmp_path / "flight.rrd", world))
    vertices = np.array(columns["/world/terrain", "Mesh3D:vertex_positions"][1][0])
    colours = np.array(columns["/world/terrain", "Mesh3D:vertex_colors"][1][0])
    red = colours >> 24  # packed as RGBA
    assert np.median(red[vertices[:, 0] > 1.0]) == pytest.approx(210, abs=1)
    assert np.median(red[vertices[:, 0] < -1.0]) == pytest.approx(90, abs=1)


def test_plots_show_the_quantities_of_the_flight(flown, recorded):
    columns, static = recorded
    f, t, n = flown.flight, flown.flight.trajectory, flown.flight.navigation
    error = table(n, "position") - f.positions
    expected = {
        "altitude/true": t["position_z"] - f.target[2],
        "altitude/estimated": n["position_z"] - f.target[2],
        "speed/down": -t["velocity_z"],
        "speed/horizontal": np.hypot(t["velocity_x"], t["velocity_y"]),
        "thrust/true": t["thrust"] / 1e3,
        "propellant/true": t["mass"] - flown.lander.dry_mass,
        "propellant/estimated": t["estimated_mass"] - flown.lander.dry_mass,
        "navigation_error_north/error": error[:, 1],
        "navigation_error_up/upper": 3.0 * np.sqrt(n["covariance_22"]),
        "navigation_error_up/lower": -3.0 * np.sqrt(n["covariance_22"]),
    }
    for name, values in expected.items():
        times, found = vectors(columns, f"/plots/{name}", "Scalars:scalars")
        assert times == pytest.approx(t["time"], abs=1e-6)
        assert found == pytest.approx(values, abs=1e-9)
        assert static[f"/plots/{name}", "SeriesLines:names"]
    _, tilt = vectors(columns, "/plots/tilt/true", "Scalars:scalars")
    up = Rotation.from_quat(table(t, "attitude", "xyzw")).apply([0, 0, 1])[:, 2]
    assert tilt == pytest.approx(np.degrees(np.arccos(np.clip(up, -1, 1))), abs=1e-4)
    times, command = vectors(columns, "/plots/thrust/command", "Scalars:scalars")
    assert times == pytest.approx(f.commands["time"], abs=1e-6)
    assert command == pytest.approx(f.commands["thrust"] / 1e3)


def test_log_has_decisions_events_and_the_outcome(flown, recorded):
    columns, _ = recorded
    times, rows = columns["/log", "TextLog:text"]
    lines = dict(zip([row[0] for row in rows], times, strict=True))
    divert = next(line for line in lines if "divert to" in line)
    assert lines[divert] == pytest.approx(flown.flight.decisions[0]["time"], abs=1e-6)
    assert any("touchdown" in line for line in lines)
    assert str(flown.flight).splitlines()[0] in list(lines)[-1]
    assert len(lines) == len(flown.flight.events) + len(flown.flight.decisions) + 1


def test_a_live_flight_shows_the_same_and_each_map(flown, recorded, live):
    saved, _ = recorded
    shown, _ = live
    several = ("/world/hazard_map", "/world/candidates", "/world/terrain")
    assert {key for key in saved if key[0] not in several} <= set(shown)
    for key, (times, rows) in saved.items():
        if key[0] not in several:
            assert shown[key][0] == pytest.approx(times, abs=1e-6), key
            assert str(shown[key][1][-1]) == str(rows[-1]), key
    maps, last = shown["/world/hazard_map", "Mesh3D:albedo_texture_buffer"]
    assert len(maps) > 1 and maps[-1] == pytest.approx(flown.flight.maps["dem"].time, abs=1e-6)
    assert last[-1] == saved["/world/hazard_map", "Mesh3D:albedo_texture_buffer"][1][0]


def test_parts_of_a_record_make_up_the_record(flown):
    f = flown.flight
    for name in ("trajectory", "navigation", "commands"):
        for column, values in getattr(f, name).items():
            found = np.concatenate([getattr(p, name)[column] for p in flown.parts])
            assert np.array_equal(found, values, equal_nan=True), column
    assert np.array_equal(np.vstack([p.scans for p in flown.parts]), f.scans)
    assert [d for p in flown.parts for d in p.decisions] == f.decisions
    assert [e for p in flown.parts for e in p.events] == f.events
    images = [data for p in flown.parts if p.images for data in p.images["camera"].encoded]
    assert images == list(f.images["camera"].encoded)


def test_a_saved_flight_keeps_the_time_of_its_map(flown, tmp_path):
    loaded = Flight.load(flown.flight.save(tmp_path / "flight"))
    assert loaded.maps["dem"].time == flown.flight.maps["dem"].time > 1.0


@pytest.mark.parametrize(("arguments", "extra"), [(["--save", "x.rrd"], False), ([], False),
                                                  ([], True)])  # fmt: skip
def test_missing_viewer_or_display_is_named(arguments, extra, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if not extra:
        monkeypatch.setitem(sys.modules, "rerun", None)
    result = CliRunner().invoke(main, ["view", "flight", *arguments])
    expected = "needs a display" if extra else "Install the extra `view`"
    assert result.exit_code == 2 and expected in result.stderr
    assert not list(tmp_path.iterdir())


def test_view_starts_the_program_of_the_installed_package(flown, monkeypatch, tmp_path):
    spawn = create_autospec(rerun.spawn)
    monkeypatch.setattr(rerun, "spawn", spawn)
    monkeypatch.setenv("DISPLAY", ":77")
    result = CliRunner().invoke(main, ["view", str(flown.flight.save(tmp_path / "flight"))])
    assert result.exit_code == 0, result.output
    assert Path(spawn.call_args.kwargs["executable_path"]).is_file()


def test_an_error_leaves_no_file(flown, tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"path: must be a file name that ends in \.rrd"):
        save_recording(flown.flight, tmp_path / "flight.txt", flown.world)

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Recording, "add", fail)
    with pytest.raises(OSError, match="No space"):
        save_recording(flown.flight, tmp_path / "flight.rrd", flown.world)
    assert not list(tmp_path.iterdir())


def test_a_viewer_that_does_not_answer_does_not_block_the_command(flown, monkeypatch):
    """The stream is connected to a port on which nothing listens."""
    monkeypatch.setattr(
        rerun, "spawn",
        lambda recording, **_: recording.connect_grpc("rerun+http://127.0.0.1:9/proxy"),
    )  # fmt: skip
    monkeypatch.setattr(viewer, "_FLUSH_TIMEOUT_S", 0.5)
    with pytest.raises(InputError, match="was closed or does not answer"):
        view_flight(flown.flight, flown.world)
