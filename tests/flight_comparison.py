"""Comparison of flights to the last bit, and replay of one without a world."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np

from lunarsim.simulation.recorder import MessageRecorder
from tests.conftest import ROOT


def replayed(tap: MessageRecorder, policy: object, folder: Path) -> list:
    """Return commands and torques of a flight's measurements in a process without a world."""
    measurements = [inputs for inputs, _, _ in tap.exchanges]
    source, target = folder / "in", folder / "out"
    source.write_bytes(pickle.dumps((tap.briefing, policy, measurements)))
    subprocess.run(
        [sys.executable, str(ROOT / "tests" / "simulation" / "replay.py"), source, target],
        check=True, cwd=ROOT,
    )  # fmt: skip
    return pickle.loads(target.read_bytes())


def assert_the_same(exchanges, again) -> None:
    assert len(again) == len(exchanges) - 1 > 50
    for (_, command, torques), (other, torques_again) in zip(exchanges, again, strict=False):
        assert other.thrust == command.thrust
        assert other.attitude.tobytes() == command.attitude.tobytes()
        assert [t.sensor for t in other.tasks] == [t.sensor for t in command.tasks]
        for a, b in zip(other.tasks, command.tasks, strict=True):
            assert a.mount.tobytes() == b.mount.tobytes()
        assert torques_again.tobytes() == torques.tobytes()


def assert_same(a, b, path="flight"):
    """Compare nested records to the last bit."""
    if isinstance(a, dict):
        assert list(a) == list(b), path
        for key in a:
            assert_same(a[key], b[key], f"{path}.{key}")
    elif isinstance(a, list | tuple):
        assert len(a) == len(b), path
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{path}[{i}]")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, path
        assert a.tobytes() == b.tobytes(), path
    else:
        assert a == b or (a != a and b != b), path
