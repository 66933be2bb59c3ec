"""Log a flight to Rerun: a saved flight, or a live one cycle by cycle.

Everything is in the true ENU frame. Data of the local frame (LiDAR returns, sites, hazard map) are
shifted by the error of the local frame at their time; estimates are in the site frame, so that
their distance from the truth is the navigation error.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from lunarsim.models.lander import Lander
from lunarsim.simulation.columns import vector_columns
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.image_record import ImageRecord
from lunarsim.simulation.map_record import MapRecord
from lunarsim.typing import Array
from lunarsim.view import colours
from lunarsim.view.blueprint import PATHS, TIMELINE
from lunarsim.view.lander_shape import flame_vector, leg_lines
from lunarsim.view.meshes import (
    Mesh,
    lander_mesh,
    map_mesh,
    rock_mesh,
    terrain_mesh,
    triangles_outside,
)
from lunarsim.view.series import plotted_series
from lunarsim.world import World

# Grey level of terrain with the mean albedo.
_TERRAIN_GREY = 150
# Maximum number of cells along a side of the image of a hazard map.
_MAX_CELLS = 1024
_RING_POINTS = 49
_CONVERTER_BITS = (10, 12, 14, 16)
# Width of paths, and size of LiDAR returns, on the screen, points (Rerun: negative radii).
_PATH_RADIUS, _RETURN_RADIUS = -1.5, -1.2
_UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


class Recording:
    """Log of one flight to a stream of Rerun.

    Parameters
    ----------
    stream
        A `rerun.RecordingStream`.
    world, lander
        True world and lander of the flight.
    """

    def __init__(self, stream: Any, world: World, lander: Lander) -> None:
        import rerun  # noqa: PLC0415  (an extra)

        self._rr, self._stream = rerun, stream
        self._world, self._lander = world, lander
        # The only time line is that of the flight.
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        self._terrain = terrain_mesh(world.terrain.relief)
        self._map_grid: Any = None
        self._candidates = np.zeros((0, 5), np.float32)
        self._series: set[str] = set()
        self._image_bits: dict[str, int] = {}
        # Time, true and estimated position, and local minus true coordinates, of the last row.
        self._last: tuple[float, Array, Array, Array] | None = None
        self._log_scene()

    def add(self, part: Flight) -> None:
        """Log a record, or the part of a record that follows the part logged before."""
        if len(part.trajectory["time"]):
            self._log_states(part)
            self._log_estimates(part)
            self._last = (
                float(part.trajectory["time"][-1]), part.positions[-1],
                vector_columns(part.navigation, "position")[-1] if part.navigation else np.zeros(3),
                self._local_errors(part)[-1],
            )  # fmt: skip
            for series in plotted_series(part, self._world, self._lander):
                self._log_series(series)
        if self._last is None:
            return
        self._log_scans(part)
        self._log_candidates(part)
        record = part.maps.get(part.decision_mapper, next(iter(part.maps.values()), None))
        if record is not None:
            self._log_map(record)
        for name, images in part.images.items():
            self._log_images(name, images)
        self._log_text(part)

    # --- scene ----------------------------------------------------------------------------

    def _log_scene(self) -> None:
        """Log what does not change: terrain, rocks, and the shapes of lander and site."""
        rr, lander = self._rr, self._lander
        self._log_now("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        mesh = self._terrain
        grey = self._terrain_greys(mesh)
        # Not static: a hazard map cuts its area out of the triangles.
        self._stream.set_time(TIMELINE, duration=0.0)
        self._stream.log("world/terrain", self._mesh(mesh, vertex_colors=grey))
        rocks = self._world.terrain.rocks
        if len(rocks):
            self._log_now(
                "world/rocks", self._mesh(rock_mesh(rocks), albedo_factor=(176, 168, 156))
            )
        body = self._mesh(lander_mesh(lander), albedo_factor=(214, 200, 168))
        self._log_now("world/lander/body", body)
        width = 0.04 * lander.leg_radius
        legs = rr.LineStrips3D(leg_lines(lander), radii=width, colors=(190, 190, 196))
        self._log_now("world/lander/legs", legs)
        turn = np.linspace(0.0, 2.0 * np.pi, _RING_POINTS)
        ring = np.column_stack((np.cos(turn), np.sin(turn), np.zeros_like(turn)))
        site = rr.LineStrips3D([lander.leg_radius * ring], radii=width, colors=colours.SITE)
        self._log_now("world/site/ring", site)

    def _terrain_greys(self, mesh: Mesh) -> Array:
        """Return RGB colours (n, 3) of the terrain: grey, times its relative albedo."""
        albedo = self._world.terrain.albedo
        relative = 1.0 if albedo is None else albedo.at(mesh.vertices[:, :2])[:, None]
        grey = np.full((len(mesh.vertices), 3), _TERRAIN_GREY) * relative
        return np.clip(grey, 0.0, 255.0).astype(np.uint8)

    def _mesh(self, mesh: Mesh, **more: Any) -> Any:
        """Return a mesh of Rerun; `more` are its other components."""
        return self._rr.Mesh3D(
            vertex_positions=mesh.vertices, vertex_normals=mesh.normals,
            triangle_indices=mesh.triangles, **more,
        )  # fmt: skip

    def _log_now(self, path: str, data: Any) -> None:
        """Log data that holds for the complete recording."""
        self._stream.log(path, data, static=True)

    # --- rows -----------------------------------------------------------------------------

    def _send(self, path: str, time: ArrayLike, *columns: Any) -> None:
        """Log columns of components with one row per time (n,), s."""
        column = self._rr.TimeColumn(TIMELINE, duration=np.asarray(time, dtype=np.float64))
        rows = [part for data in columns for part in data]
        self._stream.send_columns(path, [column], rows)

    @staticmethod
    def _local_errors(part: Flight) -> Array:
        """Return local minus true coordinates (n, 3) of the lander in each row, m."""
        return np.asarray(vector_columns(part.trajectory, "estimated") - part.positions)

    def _log_states(self, part: Flight) -> None:
        """Log true pose, thrust and path of the lander, and its site."""
        rr, t = self._rr, part.trajectory
        time, positions = t["time"], part.positions
        quaternions = vector_columns(t, "attitude", "xyzw")
        pose = rr.Transform3D.columns(translation=positions, quaternion=quaternions)
        self._send("world/lander", time, pose)
        flames = [flame_vector(self._lander, thrust) for thrust in t["thrust"]]
        origins, vectors = (np.array(ends) for ends in zip(*flames, strict=True))
        self._send("world/lander/flame", time, rr.Arrows3D.columns(
            origins=origins, vectors=vectors, colors=[colours.FUEL] * len(time),
            radii=np.full(len(time), 0.08 * self._lander.leg_radius)))  # fmt: skip
        site = part.sites - self._local_errors(part)
        self._send("world/site", time, rr.Transform3D.columns(translation=site))
        before = positions[0] if self._last is None else self._last[1]
        self._log_path(PATHS[0], time, positions, before, colours.TRUTH)

    def _log_path(
        self, path: str, time: Array, positions: Array, before: Array, colour: tuple[int, ...]
    ) -> None:
        """Log the segment to each position (n, 3), m, from the position `before` (3,) on."""
        points = np.vstack((before[None], positions))
        strips = np.stack((points[:-1], points[1:]), axis=1)
        data = self._rr.LineStrips3D.columns(
            strips=strips.astype(np.float32),
            colors=[colour] * len(time),
            radii=np.full(len(time), _PATH_RADIUS),
        )
        self._send(path, time, data)

    def _log_estimates(self, part: Flight) -> None:
        """Log estimated path, and the ellipsoid of 3 sigma of the estimated position."""
        n = part.navigation
        if not n:
            return
        positions, rr = vector_columns(n, "position"), self._rr
        before = positions[0] if self._last is None else self._last[2]
        self._log_path(PATHS[1], n["time"], positions, before, colours.ESTIMATE)
        upper = np.column_stack(
            [n[f"covariance_{i}"] for i in ("00", "01", "02", "11", "12", "22")]
        )
        known = np.isfinite(upper).all(axis=1) & np.isfinite(positions).all(axis=1)
        if not known.any():
            return
        variance, axes = np.linalg.eigh(upper[known][:, _UPPER])
        axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]  # a right-handed set
        self._send("world/covariance", n["time"][known], rr.Ellipsoids3D.columns(
            centers=positions[known], half_sizes=3.0 * np.sqrt(np.maximum(variance, 0.0)),
            quaternions=Rotation.from_matrix(axes).as_quat(),
            colors=[colours.ESTIMATE] * int(known.sum())))  # fmt: skip

    def _log_series(self, series: Any) -> None:
        """Log one series of the plots; its colour and name the first time."""
        if series.path not in self._series:
            self._series.add(series.path)
            style = self._rr.SeriesLines(colors=series.colour, names=series.name)
            self._log_now(series.path, style)
        if len(series.time):
            self._send(series.path, series.time, self._rr.Scalars.columns(scalars=series.values))

    # --- measurements, maps and decisions -------------------------------------------------

    def _log_scans(self, part: Flight) -> None:
        """Log the LiDAR returns of each scan."""
        scans = part.scans
        if not len(scans):
            return
        times, counts = np.unique(scans[:, 3], return_counts=True)
        error = self._error_at(part, scans[:, 3].astype(np.float64))
        order = np.argsort(scans[:, 3], kind="stable")
        points = (scans[:, :3] - error)[order]
        data = self._rr.Points3D.columns(positions=points).partition(counts)
        style = self._rr.Points3D.columns(
            colors=[colours.LIDAR] * len(times), radii=np.full(len(times), _RETURN_RADIUS)
        )
        self._send("world/lidar", times, data, style)

    def _error_at(self, part: Flight, times: Array) -> Array:
        """Return local minus true coordinates (k, 3), m, at times (k,), s."""
        assert self._last is not None
        rows = part.trajectory["time"]
        if not len(rows):
            return np.tile(self._last[3], (len(times), 1))
        errors = self._local_errors(part)
        nearest = np.abs(rows[None] - np.unique(times)[:, None]).argmin(axis=1)
        return np.asarray(errors[nearest][np.unique(times, return_inverse=True)[1]])

    def _log_candidates(self, part: Flight) -> None:
        """Log candidate sites if they changed, coloured by `p_safe`."""
        found = part.candidates
        if np.array_equal(found, self._candidates):
            return
        self._candidates = found
        assert self._last is not None
        record = part.maps.get(part.decision_mapper)
        # A record has the times of diverts and of the last map, but not of the last decision.
        time = self._last[0]
        if part.decisions:
            time = float(part.decisions[-1]["time"])
        elif record is not None and record.time is not None:
            time = record.time
        offset = self._error_at(part, np.array([time]))[0]
        self._stream.set_time(TIMELINE, duration=time)
        self._stream.log("world/candidates", self._rr.Points3D(
            found[:, :3] - offset, colors=colours.p_safe_colours(found[:, 3]),
            radii=0.25 * self._lander.leg_radius))  # fmt: skip

    def _log_map(self, record: MapRecord) -> None:
        """Log a hazard map: terrain with the colours of `p_safe`; unknown cells are grey."""
        found = record.hazard_map
        relief = self._world.terrain.relief
        mesh, place = map_mesh(relief, found.grid, record.error)
        image = colours.hazard_map_image(found)
        step = -(-max(image.shape[:2]) // _MAX_CELLS)
        assert self._last is not None
        time = self._last[0] if record.time is None else record.time
        self._stream.set_time(TIMELINE, duration=time)
        self._stream.log("world/hazard_map", self._mesh(
            mesh, vertex_texcoords=place, albedo_texture=np.ascontiguousarray(image[::step, ::step])
        ))  # fmt: skip
        if found.grid != self._map_grid:
            self._map_grid = found.grid
            around = triangles_outside(self._terrain, mesh)
            self._stream.log("world/terrain", self._rr.Mesh3D.from_fields(triangle_indices=around))

    def _log_images(self, name: str, images: ImageRecord) -> None:
        """Log images of a camera at its true poses; a pinhole without lens distortion."""
        rr, c = self._rr, images.columns
        zeros, ones = np.zeros_like(c["fx"]), np.ones_like(c["fx"])
        # Rerun measures from the corner of the first pixel.
        rows = (c["fx"], zeros, c["cx"] + 0.5, zeros, c["fy"], c["cy"] + 0.5, zeros, zeros, ones)
        pinhole = rr.Pinhole.columns(
            image_from_camera=np.column_stack(rows).reshape(-1, 3, 3),
            resolution=np.column_stack((c["width"], c["height"])),
            image_plane_distance=np.full(len(zeros), 4.0 * self._lander.leg_radius),
        )
        pose = rr.Transform3D.columns(
            translation=vector_columns(dict(c), "position"),
            quaternion=vector_columns(dict(c), "attitude", "xyzw"),
        )
        if name not in self._image_bits:
            used = int(images[0].max()).bit_length()
            # The next depth of a converter: later images may be brighter.
            self._image_bits[name] = next((n for n in _CONVERTER_BITS if n > used), 16)
        bits = self._image_bits[name]
        files = [_eight_bit_png(images, i, bits) for i in range(len(images))]
        data = rr.EncodedImage.columns(blob=files, media_type=["image/png"] * len(files))
        path = f"world/cameras/{name}"
        self._send(path, c["time"], pose, pinhole)
        self._send(f"{path}/image", c["time"], data)

    def _log_text(self, part: Flight) -> None:
        """Log decisions and events as text."""
        lines = [
            (d["time"], f"divert to ({d['to'][0]:.1f}, {d['to'][1]:.1f}) m: {d['reason']}", "INFO")
            for d in part.decisions
        ] + [_event_line(event) for event in part.events]
        if any(event["name"] in ("touchdown", "end") for event in part.events):
            lines.append((lines[-1][0], str(part).splitlines()[0], "INFO"))
        lines.sort(key=lambda line: float(line[0]))
        if lines:
            times, texts, levels = zip(*lines, strict=True)
            texts = tuple(f"{time:.1f} s  {text}" for time, text in zip(times, texts, strict=True))
            self._send("log", times, self._rr.TextLog.columns(text=texts, level=levels))


def _event_line(event: dict[str, Any]) -> tuple[float, str, str]:
    """Return time, s, text and level of an event."""
    details = {key: value for key, value in event.items() if key not in ("time", "name")}
    shown = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in
                      details.items() if v not in (None, [], ()))  # fmt: skip
    failed = bool(event.get("failure_causes")) or event["name"].endswith("failed")
    text = event["name"] + (f": {shown}" if shown else "")
    return float(event["time"]), text, "ERROR" if failed else "INFO"


def _eight_bit_png(images: ImageRecord, index: int, bits: int) -> bytes:
    """Return one image of a camera as PNG data with 8 bits.

    Counts with more bits are divided, because a viewer would show them almost black. `bits` is the
    number of bits of the converter.
    """
    data = images.encoded[index]
    if data[24] == 8:  # bits of a sample, in the header
        return data
    counts = np.minimum(images[index] >> (bits - 8), 255).astype(np.uint8)
    return cv2.imencode(".png", counts, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
