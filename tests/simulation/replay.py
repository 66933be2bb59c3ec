"""Replays recorded measurements through an onboard computer where there is no world.

Run as a script: reads a pickled briefing, policy and measurements, writes the commands.
"""

from __future__ import annotations

import importlib.abc
import pickle
import sys
from itertools import pairwise
from pathlib import Path

FORBIDDEN = (
    "lunarsim.world", "lunarsim.vehicle", "lunarsim.sensors", "lunarsim.simulation",
    "lunarsim.scenario", "lunarsim.evaluation", "lunarsim.viz", "moderngl", "rasterio",
)  # fmt: skip


class Wall(importlib.abc.MetaPathFinder):
    """Refuses to import anything that is true."""

    def find_spec(self, name, path=None, target=None):
        """Raise for forbidden modules."""
        if any(name == f or name.startswith(f + ".") for f in FORBIDDEN):
            raise ImportError(f"{name} cannot be imported onboard")


def replay(briefing, policy, measurements):
    """Return command and torques of every cycle."""
    from lunarsim.messages.measurements import InertialSamples
    from lunarsim.onboard.computer import OnboardComputer

    computer = OnboardComputer(briefing, policy)
    out = []
    for now, then in pairwise(measurements):
        command = computer.step(now)
        samples = [m for _, m in then.items if isinstance(m, InertialSamples)]
        torques = computer.attitude_loop.replay(samples[0].angle)
        out.append((command, torques))
    return out


def main(source: Path, target: Path) -> None:
    """Replay one flight."""
    sys.meta_path.insert(0, Wall())
    with source.open("rb") as file:
        briefing, policy, measurements = pickle.load(file)
    commands = replay(briefing, policy, measurements)
    with target.open("wb") as file:
        pickle.dump(commands, file)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
