"""Plain reader of binary glTF: triangles of each node, from the standard alone."""

from __future__ import annotations

import json
import struct

import numpy as np

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def read_glb(data):
    """Return vertices (n, 3) and triangles (m, 3) by the name of the node."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    document = json.loads(data[20 : 20 + size])
    binary = data[20 + size + 8 :]

    def array(index):
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        width = SIZES[accessor["type"]]
        count = accessor["count"] * width
        numbers = np.frombuffer(binary, TYPES[accessor["componentType"]], count, start)
        return numbers.reshape(-1, width)

    found = {}
    for node in document["nodes"]:
        if "mesh" not in node:
            continue
        assert "rotation" not in node and "scale" not in node and "translation" not in node
        assert np.allclose(np.reshape(node.get("matrix", np.eye(4).ravel()), (4, 4)), np.eye(4))
        (primitive,) = document["meshes"][node["mesh"]]["primitives"]
        found[node["name"]] = (
            array(primitive["attributes"]["POSITION"]).astype(float),
            array(primitive["indices"]).reshape(-1, 3).astype(int),
        )
    return found
