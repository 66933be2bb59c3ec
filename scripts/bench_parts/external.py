"""Measure the time of a call of external flight software."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench_parts.common import ROOT

_CALLS = 3000
_EXAMPLES = ROOT / "scenarios" / "external"


def _compiled(folder: Path, source: Path) -> Path:
    """Compile a library into a folder."""
    target = folder / f"{source.stem}.so"
    include = f"-I{ROOT / 'lunarsim' / 'interface'}"
    subprocess.run(
        ["gcc", "-O2", "-shared", "-fPIC", include, str(source), "-o", str(target), "-lm"],
        check=True,
    )
    return target


def _median_us(call: Callable[[], object], calls: int = _CALLS) -> float:
    """Return the median time of a call, us."""
    times = []
    for _ in range(calls):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times))


def _round_trip() -> float:
    """Return the time of 1.5 kB to another process and back over a socket, us."""
    near, far = socket.socketpair()
    child = os.fork()
    if child == 0:
        near.close()
        while data := far.recv(65536):
            far.sendall(data)
        os._exit(0)
    far.close()
    data = bytes(1500)

    def call() -> None:
        near.sendall(data)
        near.recv(65536)

    spent = _median_us(call)
    near.close()
    os.waitpid(child, 0)
    return spent


def _image() -> Any:
    """Return an image of 640 x 480 pixels."""
    from lunarsim.messages.measurements import CameraImage
    from lunarsim.models.camera import CameraModel

    return CameraImage(0.0, np.zeros((480, 640), np.uint8), CameraModel())


def external() -> None:
    """Time calls of guidance, computer and mapper in a library and in a process."""
    from lunarsim.interface import allow_programs
    from lunarsim.onboard.external.computer import LibraryComputer
    from lunarsim.onboard.external.guidance import LibraryGuidance, ProcessGuidance
    from lunarsim.onboard.guidance.contract import PhaseEnd
    from lunarsim.onboard.guidance.polynomial_laws import EGuidanceLaw
    from lunarsim.rng import flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation
    from lunarsim.simulation.recorder import MessageRecorder

    if shutil.which("gcc") is None:
        print("external: needs the compiler gcc")
        return
    with tempfile.TemporaryDirectory() as folder:
        law = _compiled(Path(folder), _EXAMPLES / "e_guidance.c")
        computer = _compiled(Path(folder), _EXAMPLES / "computer.c")
        program = _EXAMPLES / "e_guidance.py"
        allow_programs(law, computer, program)
        tap = MessageRecorder()
        scenario = Scenario.load(_EXAMPLES / "golombek_fixes.toml")
        simulation = Simulation(scenario, flight_seed(1, 0), "no-divert", tap=tap)
        for _ in range(3):
            simulation.step()
        briefing, seen = simulation.briefing, simulation.estimate
        end, inputs = PhaseEnd(briefing.target), tap.exchanges[-1][0]
        print(f"socket, 1.5 kB to another process and back: {_round_trip():.1f} us")
        parts = {
            "lunarsim's own law": EGuidanceLaw(),
            "library": LibraryGuidance(path=law, isolated=False),
            "isolated library": LibraryGuidance(path=law),
            "program in Python": ProcessGuidance(path=program),
            "program in Python, TCP": ProcessGuidance(path=program, transport="tcp"),
        }
        own = 0.0
        for name, part in parts.items():
            built = part.build(briefing, 0.5)
            spent = _median_us(lambda law=built: law.command(seen, end, 1.0, 20.0))
            own = own or spent
            print(f"guidance, {name}: {spent:.1f} us a call, {spent / own:.2f} of that of lunarsim")
            if hasattr(built, "close"):
                built.close()
        for isolated in (False, True):
            built = LibraryComputer(path=computer, isolated=isolated).build(briefing)
            spent = _median_us(lambda c=built: c.update(inputs))
            where = "isolated library" if isolated else "library"
            print(
                f"computer, {where}: {spent:.1f} us a cycle, {spent / own:.2f} of a law of lunarsim"
            )
            built.close()
        _time_image(computer, briefing)


def _time_image(computer: Path, briefing: Any) -> None:
    """Print the time of a cycle of the computer with an image of 640 x 480 pixels."""
    from lunarsim.messages.measurements import Measurements
    from lunarsim.onboard.external.computer import LibraryComputer

    built = LibraryComputer(path=computer).build(briefing)
    sensor = next(iter(briefing.instruments))
    image = Measurements(0.0, ((sensor, _image()),))
    spent = _median_us(lambda: built.update(image), 500)
    built.close()
    print(f"computer, isolated library with an image: {spent:.1f} us a cycle")
