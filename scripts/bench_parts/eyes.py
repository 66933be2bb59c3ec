"""A lander with all its eyes open, against the clock."""

from __future__ import annotations

import time

from bench_parts.common import ROOT, yardstick_ms

# A map is drawn so often, and the clock looked at, s.
_EVERY = 1.0


def eyes() -> None:
    """Two cameras at 10 Hz, flashes at 2 Hz and a fused map each second: worst second and mean."""
    for words, both in (("one hands over to the other", False), ("both all the way", True)):
        scenario = all_eyes(both)
        # Kernels, and what of the Sun is worked out once.
        pace(scenario, 3.0)
        before = yardstick_ms()
        flown, wall, processor = pace(scenario)
        yardstick = 5e-4 * (before + yardstick_ms())
        print(
            f"  two cameras at 10 Hz, {words}, flashes at 2 Hz, a fused map a second: {flown:.0f} "
            f"s flown in {sum(wall):.0f} s, {flown / sum(wall):.2f} times real time; worst second "
            f"{max(wall):.2f} s of wall clock, {max(processor):.2f} s of processor (mean "
            f"{sum(processor) / flown:.2f} s)\n"
            f"    in yardsticks of {1e3 * yardstick:.0f} ms, taken before and after: a second flown"
            f" {sum(wall) / flown / yardstick:.1f}, worst second {max(wall) / yardstick:.1f}; real "
            f"time on two cores on which one takes {1e3 * flown / sum(wall) * yardstick:.0f} ms"
        )


def all_eyes(both: bool):
    """Return the flight; `both`: the cameras do not hand over, and each sees all of the descent."""
    from lunarsim.scenario import Scenario

    every = {"rate_hz": 10.0, "first_altitude_m": 1150.0, "last_altitude_m": 0.0}
    cameras = {"narrow": every, "wide": every} if both else {
        "narrow": {"rate_hz": 10.0}, "wide": {"rate_hz": 10.0}
    }  # fmt: skip
    flash = {"kind": "periodic", "rate_hz": 2.0, "first_altitude_m": 1150.0}
    return Scenario.load(ROOT / "scenarios" / "all_eyes.toml").changed(
        tasking=cameras | {"flash": flash}, sun={"photometry": "lambert"}
    )


def pace(scenario, until: float = float("inf")) -> tuple[float, list[float], list[float]]:
    """Return the time flown, s, and what each second took of wall clock and of processor, s."""
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
