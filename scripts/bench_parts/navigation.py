"""Measure the computing time of navigation on one core."""

from __future__ import annotations

import time
from contextlib import contextmanager
from pathlib import Path

SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios"


def navigation() -> None:
    """Time navigation on one core, relative to real time, by sensor set."""
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation

    cases = {
        "altimeter, velocimeter, star tracker at 10 Hz": {"tasking": {"flash": None},
                                                          "mappers": {"dem": None},
                                                          "sensors": {"flash": None}},
        "and flashes of 128 x 128 at 10 Hz": {
            "sensors": {"flash": {"rows": 128, "cols": 128, "half_fov_tangent": 0.025}},
            "tasking": {"flash": {"kind": "periodic", "rate_hz": 10.0}},
            "mappers": {"dem": None},
        },
    }  # fmt: skip
    plain = Scenario.load(SCENARIOS / "instruments.toml")
    for name, changes in cases.items():
        print(f"  {name}: {_time_fraction(Simulation, plain.changed(**changes)):.3f} of real time")
    share = _time_fraction(Simulation, camera_and_lidar())
    print(f"  camera and flashes at 10 Hz, rocks, prior map: {share:.3f} of real time, "
          "without rock detection")  # fmt: skip
    near = {"position_m": [-100.0, -100.0, 180.0], "velocity_m_s": [7.8, 7.8, -9.0]}
    rocks = Scenario.load(SCENARIOS / "shadow_nominal.toml").changed(start=near)
    print(f"  camera, rocks from shadows: {_time_fraction(Simulation, rocks):.3f} of real time, "
          "without rock detection")  # fmt: skip


def camera_and_lidar():
    """Return a scenario with camera and LiDAR flashes at 10 Hz and a prior map."""
    from lunarsim.scenario import Scenario

    return Scenario.load(SCENARIOS / "camera_and_lidar.toml").changed(
        terrain={"rms_slope_deg": 1.5},
        sensors={"flash": {"rows": 128, "cols": 128, "half_fov_tangent": 0.1}},
        start={"position_m": [-140.0, 0.0, 180.0], "velocity_m_s": [11.0, 0.0, -9.0]},
        tasking={"flash": {"kind": "periodic", "rate_hz": 10.0}, "camera": {"rate_hz": 10.0}},
        prior_map={"posting_m": 0.5, "size_m": 100.0},
        mappers={"dem": None, "fused": None, "rocks": {"size_m": 60.0}},
        decisions={"map": "rocks"},
    )  # fmt: skip


def _time_fraction(simulate, scenario, seconds: float = 15.0) -> float:
    """Return the ratio of navigation's computing time to simulated time, on one core.

    `simulate` is the class `Simulation`; the flight is simulated for `seconds`.
    """
    with _one_core():
        return _time_fraction_here(simulate, scenario, seconds)


@contextmanager
def _one_core():
    """Use one thread in this context, because waiting threads would be counted too."""
    import numba
    from threadpoolctl import threadpool_limits

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    with threadpool_limits(1):
        yield
    numba.set_num_threads(before)


def _time_fraction_here(simulate, scenario, seconds: float) -> float:
    """Return the ratio of `_time_fraction` with the current number of threads."""
    simulate(scenario, 1, "no-divert").step()
    simulation = simulate(scenario, 1, "no-divert")
    navigation = simulation.computer.navigation
    clock = _MethodTimer(navigation, getattr(navigation, "rocks", None))
    most = 0
    while not simulation.done and simulation.time < seconds:
        simulation.step()
        most = max(most, getattr(getattr(navigation, "rocks", None), "count", 0))
    if most:
        print(f"  at most {most} rocks")
    return clock.seconds / simulation.time


class _MethodTimer:
    """Measure the total time of the methods of navigation objects, s.

    Nested calls count once. `parts` are the objects whose methods are wrapped.
    """

    def __init__(self, *parts) -> None:
        self.seconds, self._depth = 0.0, 0
        # The overhead of the clock is subtracted.
        asked = [time.process_time() for _ in range(1001)]
        self._asking = (asked[-1] - asked[0]) / 1000
        for part in parts:
            for name in ("take", "estimate", "update_rocks", "add", "project_rocks", "remove",
            "add_process_noise",
                         "innovation_covariance", "relative_covariance", "add_view_noise",
                         "terrain_points"):  # fmt: skip
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
