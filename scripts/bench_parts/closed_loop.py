"""Measure the speed of the complete closed loop."""

from __future__ import annotations

import time

import numba

from bench_parts.common import ROOT


def frames() -> None:
    """Time the rendered frames of Retarget-v1, compared with the environment's steps."""
    import gymnasium

    env = gymnasium.make(
        "lunarsim_envs:lunarsim/Retarget-v1", perception="onboard", render_mode="rgb_array"
    )
    env.reset(seed=0)
    env.render()
    drawn, stepped = [], []
    for seed in range(1, 4):
        env.reset(seed=seed)
        over = False
        while not over:
            began = time.perf_counter()
            _, _, ended, late, _ = env.step(0)
            over = ended or late
            stepped.append(time.perf_counter() - began)
            began = time.perf_counter()
            env.render()
            drawn.append(time.perf_counter() - began)
    ordered = sorted(drawn)
    print(
        f"  {len(drawn)} frames of 800 x 360: median {1e3 * ordered[len(drawn) // 2]:.1f} ms, "
        f"maximum {1e3 * ordered[-1]:.1f} ms; an environment step takes "
        f"{1e3 * sorted(stepped)[len(stepped) // 2]:.1f} ms"
    )


def flight() -> None:
    """Time closed-loop flights on one thread, relative to real time."""
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
                f"{record.duration / took:5.1f} times real time ({scans} scans, map posting "
                f"{posting} m, including world generation)"
            )
    numba.set_num_threads(threads)
