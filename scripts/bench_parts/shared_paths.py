"""What flights of one index that differ in policy alone fly twice: all up to where paths part."""

from __future__ import annotations

import time
from itertools import groupby
from typing import Any

from bench_parts.common import ROOT

# Scenario, policies, indices.
_CASES = (
    ("hard", ("no-divert", "nearest-safe", "fuel-aware", "safest"), 4),
    ("morpheus", ("no-divert", "safest"), 1),
    ("shadow_nominal", ("no-divert", "safest"), 1),
)


def paths() -> None:
    """Share of processor time before the first decision, and before decisions differ."""
    for name, policies, flights in _CASES:
        spent = first = twice = 0.0
        for index in range(flights):
            _flown(name, "no-divert", index)  # the first loads what is loaded late
            flown = [_flown(name, policy, index) for policy in policies]
            whole = sum(sum(cost for cost, _ in one) for one in flown)
            spent += whole
            least = min(sum(cost for cost, _ in one[: _first_decision(one)]) for one in flown)
            first += (len(policies) - 1) * least
            twice += whole - _apart(flown, 0)
        print(
            f"  {name}, {len(policies)} policies: {spent / flights / len(policies):.2f} s of a "
            f"processor a flight; one path up to the first decision would save "
            f"{100.0 * first / spent:.0f} %, up to where decisions differ "
            f"{100.0 * twice / spent:.0f} %"
        )


def _flown(name: str, policy: str, index: int) -> list[tuple[float, Any]]:
    """Return the processor time of each cycle of a flight, and what was decided then."""
    from lunarsim.rng import flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation

    scenario = Scenario.load(ROOT / "scenarios" / f"{name}.toml")
    told: list[Any] = [None]
    began = time.process_time()
    simulation = Simulation(scenario, flight_seed(21, index), policy)
    kept = simulation.computer.apply

    def noted(decision: Any) -> bool:
        site = None if decision.site is None else decision.site.tobytes()
        told[0] = (site, decision.abort)
        return kept(decision)

    simulation.computer.apply = noted  # type: ignore[method-assign]
    cycles = [(time.process_time() - began, None)]
    while not simulation.done:
        told[0], began = None, time.process_time()
        simulation.step()
        cycles.append((time.process_time() - began, told[0]))
    return cycles


def _first_decision(cycles: list[tuple[float, Any]]) -> int:
    return next((i for i, (_, said) in enumerate(cycles) if said is not None), len(cycles))


def _apart(flights: list[list[tuple[float, Any]]], cycle: int) -> float:
    """Return the time of flights from a cycle on, where those on one path are flown once."""
    total = 0.0
    while True:
        flights = [one for one in flights if len(one) > cycle]
        if not flights:
            return total
        total += min(one[cycle][0] for one in flights)
        key = [(repr(one[cycle][1]), one) for one in flights]
        groups = [
            [one for _, one in group]
            for _, group in groupby(sorted(key, key=lambda k: k[0]), key=lambda k: k[0])
        ]
        cycle += 1
        if len(groups) > 1:
            return total + sum(_apart(group, cycle) for group in groups)
