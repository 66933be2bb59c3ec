"""An agent from a stranger runs no code without trust, and cannot fill the memory."""

from __future__ import annotations

import io
import json
import pickle
import struct
import tracemalloc
import zipfile

import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner

import lunarsim_envs  # noqa: F401  (registers the environments)
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.onboard.guidance.optimal_network import OptimalNetwork
from lunarsim.onboard.hazards.quadtree.settings import InterestMap
from lunarsim.untrusted_files import read_arrays
from lunarsim_envs.agents.registry import agent_of
from lunarsim_envs.agents.sb3_agents import Sb3Agent
from lunarsim_envs.sites.surrogate import Surrogate


class Bomb:
    """Writes a file as soon as it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def members(path, **given):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in given.items():
            file.writestr(name, data)
    return path


def npy(array, *, allow_pickle=False):
    file = io.BytesIO()
    np.save(file, array, allow_pickle=allow_pickle)
    return file.getvalue()


def huge_header():
    """Return an array file that claims 8 TB and holds 8 bytes."""
    file = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    np.lib.format.write_array_header_1_0(file, shape)
    return file.getvalue() + bytes(8)


def test_a_pickle_is_not_read_without_trust(tmp_path):
    mark = tmp_path / "ran"
    data = json.dumps({"policy_class": {"__module__": "stable_baselines3.common.policies"}})
    path = members(tmp_path / "a.zip", data=data, bomb=pickle.dumps(Bomb(mark)))
    done = CliRunner().invoke(main, ["evaluate", "Guidance-v1", "--agent", str(path)])
    assert done.exit_code == 2 and "--trust-pickle" in done.stderr, done.output
    env = gymnasium.make("lunarsim/Guidance-v1")
    for fly in (agent_of, lambda given, env: Sb3Agent(env, given)):
        with pytest.raises(InputError, match="trust_pickle"):
            fly(str(path), env)
    (tmp_path / "normalize.pkl").write_bytes(pickle.dumps(Bomb(mark)))
    out = str(tmp_path / "agent.onnx")
    arguments = ["--out", out, "--vec-normalize", str(tmp_path / "normalize.pkl")]
    done = CliRunner().invoke(main, ["agent", "export", str(path), *arguments])
    assert done.exit_code == 2 and "--trust-pickle" in done.stderr, done.output
    assert not mark.exists()


@pytest.mark.parametrize(
    "load",
    [
        OptimalNetwork.load, InterestMap.load, Surrogate.load,
        lambda path: agent_of(str(path), gymnasium.make("lunarsim/Guidance-v1")),
    ],
)  # fmt: skip
def test_archives_hold_no_objects_and_no_bombs(tmp_path, load):
    mark = tmp_path / "ran"
    shared = {"format.npy": npy(np.array("x"))}
    pickled = npy(np.array([Bomb(mark)], dtype=object), allow_pickle=True)
    paths = [
        members(tmp_path / "a.npz", **{"value.npy": pickled}),
        members(tmp_path / "b.npz", **shared, **{"value.npy": bytes(200_000_000)}),
        members(tmp_path / "c.npz", **shared, **{"value.npy": huge_header()}),
        members(tmp_path / "d.npz", **shared, **{"value.npy": b"plain text"}),
        members(tmp_path / "e.npz"),
    ]
    (tmp_path / "f.npz").write_bytes(pickle.dumps(Bomb(mark)))
    (tmp_path / "g.npz").write_bytes(b"")
    for path in (*paths, tmp_path / "f.npz", tmp_path / "g.npz"):
        with pytest.raises(InputError, match=path.name):
            load(path)
    assert not mark.exists()


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_an_archive_that_understates_its_size_is_not_expanded(tmp_path, method):
    path, size = tmp_path / "a.npz", 100_000_000
    with zipfile.ZipFile(path, "w", method) as file:
        file.writestr("x.npy", bytes(size))
    data = bytearray(path.read_bytes())
    at = data.rindex(b"PK\x01\x02") + 24  # uncompressed size in the directory
    data[at : at + 4] = struct.pack("<I", 8)
    path.write_bytes(data)
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"damaged|CRC|compress"):
        read_arrays(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < size / 10


def test_arrays_are_read(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", x=np.arange(5), name="abc")
    found = read_arrays(tmp_path / "a.npz")
    assert list(found["x"]) == [0, 1, 2, 3, 4] and str(found["name"]) == "abc"
    with pytest.raises(ValueError, match="uncompressed size"):
        read_arrays(tmp_path / "a.npz", max_bytes=100)
