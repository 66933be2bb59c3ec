"""Measure the speed of a vehicle with all sensors relative to real time."""

from __future__ import annotations

import time

from bench_parts.common import ROOT, reference_ms

# Interval of maps and of timing, s.
_EVERY = 1.0


def eyes() -> None:
    """Time a flight with two cameras (10 Hz), LiDAR (2 Hz) and a fused map (1 Hz)."""
    for words, both in (("in sequence", False), ("both all the time", True)):
        scenario = all_sensors(both)
        # Compiles the kernels and computes the Sun tables.
        time_flight(scenario, 3.0)
        before = reference_ms()
        flown, wall, processor = time_flight(scenario)
        reference = 5e-4 * (before + reference_ms())
        print(
            f"  two cameras at 10 Hz, {words}, flashes at 2 Hz, a fused map per second: "
            f"{flown:.0f} "
            f"s simulated in {sum(wall):.0f} s, {flown / sum(wall):.2f} times real time; worst "
            f"second "
            f"{max(wall):.2f} s wall-clock time, {max(processor):.2f} s processor time (mean "
            f"{sum(processor) / flown:.2f} s)\n"
            f"    in units of the reference task ({1e3 * reference:.0f} ms, before and after): "
            f"simulated second"
            f" {sum(wall) / flown / reference:.1f}, worst second {max(wall) / reference:.1f}; "
            f"real-time limit: "
            f"reference task on two cores in {1e3 * flown / sum(wall) * reference:.0f} ms"
        )


def all_sensors(both: bool):
    """Return a scenario with two cameras and a flash LiDAR.

    If `both`, both cameras observe during the complete descent, otherwise one after the other.
    """
    from lunarsim.scenario import Scenario

    every = {"rate_hz": 10.0, "first_altitude_m": 1150.0, "last_altitude_m": 0.0}
    cameras = {"narrow": every, "wide": every} if both else {
        "narrow": {"rate_hz": 10.0}, "wide": {"rate_hz": 10.0}
    }  # fmt: skip
    flash = {"kind": "periodic", "rate_hz": 2.0, "first_altitude_m": 1150.0}
    return Scenario.load(ROOT / "scenarios" / "all_sensors.toml").changed(
        tasking=cameras | {"flash": flash}, sun={"photometry": "lambert"}
    )


def time_flight(scenario, until: float = float("inf")) -> tuple[float, list[float], list[float]]:
    """Fly a scenario up to time `until` (s) and measure its computing time.

    Returns the simulated time, and wall-clock and processor time of each simulated second, s.
    """
    from lunarsim.rng import flight_seed
    from lunarsim.simulation import Simulation

    simulation = Simulation(scenario, flight_seed(1, 0), "safest")
    wall, processor = [], []
    while not simulation.done and simulation.time < until:
        began, used, first = time.perf_counter(), time.process_time(), simulation.time
        while not simulation.done and simulation.time < first + _EVERY - 1e-9:
            simulation.step()
        simulation.computer.mappers["fused"].hazard_map()
        wall.append(time.perf_counter() - began)
        processor.append(time.process_time() - used)
    return simulation.time, wall, processor
