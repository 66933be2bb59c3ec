"""What navigation costs of a flight, on one core."""

from __future__ import annotations

import time
from contextlib import contextmanager
from pathlib import Path

SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios"


def navigation() -> None:
    """Share of real time that navigation takes on one core, by what the lander carries."""
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
    share = _share(Simulation, two_eyes())
    print(f"  camera and flashes at 10 Hz, rocks, prior map: {share:.3f} of real time, "
          "without what finds rocks in pictures")  # fmt: skip
    near = {"position_m": [-100.0, -100.0, 180.0], "velocity_m_s": [7.8, 7.8, -9.0]}
    rocks = Scenario.load(SCENARIOS / "shadow_nominal.toml").changed(start=near)
    print(f"  camera, rocks by their shadows: {_share(Simulation, rocks):.3f} of real time, "
          "without what finds them in pictures")  # fmt: skip


def two_eyes():
    """Return the flight with camera and flashes at 10 Hz and a prior map."""
    from lunarsim.scenario import Scenario

    return Scenario.load(SCENARIOS / "two_eyes.toml").changed(
        terrain={"rms_slope_deg": 1.5},
        sensors={"flash": {"rows": 128, "cols": 128, "half_width": 0.1}},
        start={"position_m": [-140.0, 0.0, 180.0], "velocity_m_s": [11.0, 0.0, -9.0]},
        tasking={"flash": {"kind": "periodic", "rate_hz": 10.0}, "camera": {"rate_hz": 10.0}},
        prior_map={"posting_m": 0.5, "size_m": 100.0},
        mappers={"dem": None, "fused": None, "rocks": {"size_m": 60.0}},
        decisions={"map": "rocks"},
    )  # fmt: skip


def _share(simulate, scenario, seconds: float = 15.0) -> float:
    """Return the time that navigation takes over the time flown."""
    with _one_core():
        return _share_here(simulate, scenario, seconds)


@contextmanager
def _one_core():
    """Keep to one thread: those that wait for others would be counted too."""
    import numba
    from threadpoolctl import threadpool_limits

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    with threadpool_limits(1):
        yield
    numba.set_num_threads(before)


def _share_here(simulate, scenario, seconds: float) -> float:
    simulate(scenario, 1, "no-divert").step()
    simulation = simulate(scenario, 1, "no-divert")
    navigation = simulation.computer.navigation
    clock = _Clock(navigation, getattr(navigation, "rocks", None))
    most = 0
    while not simulation.done and simulation.time < seconds:
        simulation.step()
        most = max(most, getattr(getattr(navigation, "rocks", None), "count", 0))
    if most:
        print(f"  {most} rocks at most")
    return clock.seconds / simulation.time


class _Clock:
    """Counts the time that methods of navigation take, calls within each other once."""

    def __init__(self, *parts) -> None:
        self.seconds, self._depth = 0.0, 0
        # Asking for the time of the processor costs some itself.
        asked = [time.process_time() for _ in range(1001)]
        self._asking = (asked[-1] - asked[0]) / 1000
        for part in parts:
            for name in ("take", "estimate", "update_rocks", "add", "sight", "remove", "widen",
                         "innovation_covariance", "relative_covariance", "turn",
                         "ground_points"):  # fmt: skip
                if hasattr(part, name):
                    setattr(part, name, self._timed(getattr(part, name)))

    def _timed(self, method):
        def call(*args, **options):
            self._depth += 1
            began = time.process_time()
            try:
                return method(*args, **options)
            finally:
                self._depth -= 1
                if self._depth == 0:
                    self.seconds += time.process_time() - began - self._asking

        return call
