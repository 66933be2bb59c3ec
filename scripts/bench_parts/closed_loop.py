"""The whole loop."""

from __future__ import annotations

import time

import numba

from bench_parts.common import ROOT


def flight() -> None:
    """One closed-loop flight on one thread, against real time."""
    from lunarsim.rng import flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation

    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    for name in ("hirise", "golombek"):
        scenario = Scenario.load(ROOT / "scenarios" / f"{name}.toml")
        Simulation(scenario, flight_seed(1, 0), "safest").run()
        for index in range(1, 4):
            began = time.perf_counter()
            record = Simulation(scenario, flight_seed(1, index), "safest").run()
            took = time.perf_counter() - began
            scans = sum(event["name"] == "scan" for event in record.events)
            posting = next(iter(scenario.mappers.values())).posting_m
            print(
                f"  {name:9s} flight {index}: {record.duration:5.1f} s flown in {took:5.2f} s, "
                f"{record.duration / took:5.1f} times real time ({scans} scans, map at "
                f"{posting} m, world built too)"
            )
    numba.set_num_threads(threads)
