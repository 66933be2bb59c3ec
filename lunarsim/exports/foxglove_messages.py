"""Messages of the Foxglove schemas (Protobuf) for a flight."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.timestamp_pb2 import Timestamp

from lunarsim.models.lander import Lander
from lunarsim.simulation.map_record import MapRecord
from lunarsim.typing import Array

SITE, LANDER = "site", "lander"
_NS = 1_000_000_000
_POINT_TYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
_CELL_TYPE = np.dtype([("p_safe", "<f4"), ("elevation", "<f4"), ("observed", "u1")])
_NUMBER_TYPES = {
    "<f4": PackedElementField.FLOAT32,
    "|u1": PackedElementField.UINT8,
}


def descriptor_set(message: type) -> bytes:
    """Return the serialised schema of a message class with all files that it imports."""
    found: dict[str, FileDescriptor] = {}

    def add(file: FileDescriptor) -> None:
        if file.name not in found:
            for one in file.dependencies:
                add(one)
            found[file.name] = file

    add(message.DESCRIPTOR.file)  # type: ignore[attr-defined]
    files = FileDescriptorSet()
    for file in found.values():
        file.CopyToProto(files.file.add())
    return bytes(files.SerializeToString())


def stamp(when: int) -> Timestamp:
    """Return a date, ns since 1970, as a Protobuf time stamp."""
    return Timestamp(seconds=when // _NS, nanos=when % _NS)


def pose(position: Iterable[float], attitude: Iterable[float] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    """Return a pose from a position (3,), m, and a quaternion (4,), scalar last."""
    found = Pose()
    found.position.x, found.position.y, found.position.z = position
    turn = found.orientation
    turn.x, turn.y, turn.z, turn.w = attitude
    return found


def transform(when: int, child: str, position: Array, attitude: Array) -> FrameTransform:
    """Return the pose of a frame in the site frame."""
    where = pose(position, attitude)
    found = FrameTransform(
        timestamp=stamp(when),
        parent_frame_id=SITE,
        child_frame_id=child,
        rotation=where.orientation,
    )
    found.translation.x, found.translation.y, found.translation.z = position
    return found


def path(when: int, positions: Array, attitudes: Array) -> PosesInFrame:
    """Return poses (n,) in the site frame."""
    poses = [pose(p, q) for p, q in zip(positions, attitudes, strict=True)]
    return PosesInFrame(timestamp=stamp(when), frame_id=SITE, poses=poses)


def point_cloud(when: int, points: Array) -> PointCloud:
    """Return points (n, 3), m, in the site frame."""
    data = np.empty(len(points), _POINT_TYPE)
    for axis, values in zip("xyz", points.T, strict=True):
        data[axis] = values
    return PointCloud(
        timestamp=stamp(when), frame_id=SITE, pose=pose(np.zeros(3)),
        point_stride=_POINT_TYPE.itemsize, fields=_fields(_POINT_TYPE), data=data.tobytes(),
    )  # fmt: skip


def hazard_grid(when: int, record: MapRecord) -> Grid:
    """Return a hazard map in the site frame, row 0 in the south, at height 0."""
    grid, layers = record.hazard_map.grid, record.hazard_map
    data = np.zeros(grid.shape, _CELL_TYPE)
    data["p_safe"], data["observed"] = layers.p_safe, layers.observed
    data["elevation"] = np.nan if layers.elevation is None else layers.elevation - record.error[2]
    west, _, south, _ = grid.extent
    found = Grid(
        timestamp=stamp(when), frame_id=SITE,
        pose=pose((west - record.error[0], south - record.error[1], 0.0)),
        column_count=grid.cols, row_stride=grid.cols * _CELL_TYPE.itemsize,
        cell_stride=_CELL_TYPE.itemsize, fields=_fields(_CELL_TYPE), data=data.tobytes(),
    )  # fmt: skip
    found.cell_size.x = found.cell_size.y = grid.posting
    return found


def _fields(types: np.dtype[Any]) -> list[PackedElementField]:
    """Return the description of the fields of a structured array."""
    assert types.fields is not None
    return [
        PackedElementField(name=name, offset=one[1], type=_NUMBER_TYPES[one[0].str])
        for name, one in types.fields.items()
    ]


def image(when: int, frame: str, png: bytes) -> CompressedImage:
    """Return an image in PNG."""
    return CompressedImage(timestamp=stamp(when), frame_id=frame, data=png, format="png")


def calibration(when: int, frame: str, row: dict[str, float]) -> CameraCalibration:
    """Return the calibration of a camera from a row of the table of its images."""
    fx, fy, cx, cy = (row[name] for name in ("fx", "fy", "cx", "cy"))
    return CameraCalibration(
        timestamp=stamp(when), frame_id=frame, width=int(row["width"]), height=int(row["height"]),
        distortion_model="plumb_bob", D=[row[name] for name in ("k1", "k2", "p1", "p2", "k3")],
        K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], R=np.eye(3).ravel().tolist(),
        P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )  # fmt: skip


def log(when: int, name: str, text: str) -> Log:
    """Return an entry of the log: an event and its details."""
    return Log(timestamp=stamp(when), level=Log.INFO, name=name, message=text)


def lander_scene(when: int, lander: Lander, target: Array) -> SceneUpdate:
    """Return the lander as a cylinder in its own frame, and the target as a sphere."""
    found = SceneUpdate()
    body = found.entities.add(
        timestamp=stamp(when), frame_id=LANDER, id="lander", frame_locked=True
    )
    cylinder = body.cylinders.add(pose=pose(np.zeros(3)), bottom_scale=1.0, top_scale=1.0)
    cylinder.size.x = cylinder.size.y = 2.0 * lander.leg_radius
    cylinder.size.z = 2.0 * lander.com_height
    _paint(cylinder.color, (0.8, 0.7, 0.3, 1.0))
    found.entities.append(_spheres(when, "target", [target], 2.0, [(0.2, 0.4, 1.0, 1.0)]))
    return found


def site_scene(when: int, site: Array) -> SceneUpdate:
    """Return the landing site (3,) after a divert as a sphere."""
    return SceneUpdate(entities=[_spheres(when, "site", [site], 2.0, [(1.0, 1.0, 1.0, 1.0)])])


def candidate_scene(when: int, positions: Array, p_safe: Array) -> SceneUpdate:
    """Return candidate sites (n, 3) as spheres from red (unsafe) to green (safe)."""
    colours = [(1.0 - p, p, 0.0, 0.8) for p in np.clip(p_safe, 0.0, 1.0)]
    return SceneUpdate(entities=[_spheres(when, "candidates", positions, 0.6, colours)])


def _spheres(
    when: int,
    name: str,
    centres: Iterable[Array],
    size: float,
    colours: Sequence[tuple[float, ...]],
) -> Any:
    entity = SceneUpdate().entities.add(timestamp=stamp(when), frame_id=SITE, id=name)
    for centre, colour in zip(centres, colours, strict=True):
        sphere = entity.spheres.add(pose=pose(centre))
        sphere.size.x = sphere.size.y = sphere.size.z = size
        _paint(sphere.color, colour)
    return entity


def _paint(color: Any, rgba: Iterable[float]) -> None:
    color.r, color.g, color.b, color.a = rgba
