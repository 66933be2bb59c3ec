"""Speed, as ratios to a reference in the same run.

    python scripts/bench.py              # everything
    python scripts/bench.py flight       # one part

Every part warms its kernels first and prints medians. Only ratios within one run mean anything
across machines.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import click
import numba

ROOT = Path(__file__).parent.parent
PARTS: dict[str, Callable[[], None]] = {}


def part(function: Callable[[], None]) -> Callable[[], None]:
    PARTS[function.__name__] = function
    return function


def median_ms(call: Callable[[], object], repeats: int = 9) -> float:
    """Return the median time of `call`, ms, after one call to warm up."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * statistics.median(times)


@part
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
            print(
                f"  {name:9s} flight {index}: {record.duration:5.1f} s flown in {took:5.2f} s, "
                f"{record.duration / took:5.1f} times real time ({scans} scans, map at "
                f"{scenario.mapper.posting_m} m, world built too)"
            )
    numba.set_num_threads(threads)


@click.command()
@click.argument("parts", nargs=-1)
def main(parts: tuple[str, ...]) -> None:
    """Run the named PARTS, or all of them."""
    unknown = [name for name in parts if name not in PARTS]
    if unknown:
        raise click.UsageError(f"no such part: {unknown[0]}; there are {', '.join(PARTS)}")
    print(f"{os.cpu_count()} cores, {numba.get_num_threads()} threads")
    for name in parts or PARTS:
        print(f"{name}: {(PARTS[name].__doc__ or '').strip().splitlines()[0]}")
        PARTS[name]()


if __name__ == "__main__":
    main()
