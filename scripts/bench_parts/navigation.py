"""What navigation costs of a flight."""

from __future__ import annotations

import time
from pathlib import Path

SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios"


def navigation() -> None:
    """Share of real time that navigation takes, by what the lander carries."""
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation

    cases = {
        "altimeter, velocimeter, star tracker at 10 Hz": {"tasking": {"flash": None},
                                                          "mappers": {"dem": None},
                                                          "sensors": {"flash": None}},
        "and flashes of 128 x 128 at 10 Hz": {
            "sensors": {"flash": {"rows": 128, "cols": 128, "half_width": 0.025}},
            "tasking": {"flash": {"kind": "periodic", "rate_hz": 10.0}},
            "mappers": {"dem": None},
        },
    }  # fmt: skip
    plain = Scenario.load(SCENARIOS / "instruments.toml")
    for name, changes in cases.items():
        print(f"  {name}: {_share(Simulation, plain.changed(**changes)):.3f} of real time")
    rocks = Scenario.load(SCENARIOS / "shadow_nominal.toml")
    print(f"  camera, rocks by their shadows: {_share(Simulation, rocks):.3f} of real time, "
          "without what finds them in pictures")  # fmt: skip


def _share(simulate, scenario, seconds: float = 15.0) -> float:
    """Return the time that navigation takes over the time flown."""
    simulate(scenario, 1, "no-divert").step()
    simulation = simulate(scenario, 1, "no-divert")
    clock = _Clock(simulation.computer.navigation)
    while not simulation.done and simulation.time < seconds:
        simulation.step()
    return clock.seconds / simulation.time


class _Clock:
    """Counts the time that a navigation's methods take, calls within each other once."""

    def __init__(self, part) -> None:
        self.seconds, self._depth = 0.0, 0
        for name in ("take", "estimate", "update_rocks", "add", "sight", "remove", "widen"):
            if hasattr(part, name):
                setattr(part, name, self._timed(getattr(part, name)))

    def _timed(self, method):
        def call(*args, **options):
            self._depth += 1
            began = time.perf_counter()
            try:
                return method(*args, **options)
            finally:
                self._depth -= 1
                if self._depth == 0:
                    self.seconds += time.perf_counter() - began

        return call
