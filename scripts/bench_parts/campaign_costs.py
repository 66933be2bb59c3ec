"""Measure the cost of campaign flights and extrapolate it to a million flights."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from bench_parts.common import ROOT

# Scenario, hazard mapper, number of timed flights.
_TIMED_FLIGHTS = (
    ("hirise", "Gaussian DEM", 5),
    ("hard", "Gaussian DEM, one scan", 5),
    ("morpheus", "quadtree", 1),
    ("shadow_nominal", "shadows", 1),
)
_FLIGHT_COUNT, _CORES, _USD_PER_CORE_HOUR = 1_000_000, 640, 0.04
# Number of rows for the timing of the writer.
_ROW_COUNT = 2000


def worlds(folder: Path) -> None:
    """Print the computing time of a world, and of a flight with and without the cache.

    A world is the random terrain of a flight; `folder` holds the cache.
    """
    from lunarsim.campaign.cache import open_cache
    from lunarsim.campaign.world_truth import WorldTruthProvider
    from lunarsim.rng import flight_seed

    spec = _spec("hard", 4)
    took: dict[str, list[float]] = {"relief and rocks": [], "truth": [], "shares": []}
    for index in range(4):
        provider = WorldTruthProvider(flight_seed(1, index), {})
        scenario = spec.scenario_of(index, 0)
        steps = [time.process_time()]
        world = _world(provider, scenario)
        steps.append(time.process_time())
        _, truth = provider.world_and_truth(scenario)
        steps.append(time.process_time())
        provider.shares(scenario, truth)
        steps.append(time.process_time())
        for name, cost in zip(took, np.diff(steps), strict=True):
            took[name].append(float(cost))
        del world
    cache = open_cache(folder / "worlds")
    costs_text = ", ".join(f"{name} {np.median(costs[1:]):.2f} s" for name, costs in took.items())
    cold, filled, warm = (_seconds("hard", 4, kept) for kept in (None, cache, cache))
    size = np.mean([p.stat().st_size for p in (folder / "worlds").glob("??/*.npz")])
    print(
        f"  hard, processor time: {costs_text}; flight {cold:.2f} s without cache, {filled:.2f} s "
        f"with filling it, {warm:.2f} s from it; {2.0 * size / 1e6:.1f} MB per cached world"
    )


def _world(provider: Any, scenario: Any) -> Any:
    """Generate the world of a scenario from the seed of a `WorldTruthProvider`."""
    from lunarsim.rng import RandomStreams
    from lunarsim.simulation import build_world

    return build_world(scenario, RandomStreams(provider.seed))


def million(folder: Path, row_bytes: float) -> None:
    """Print computing time and cost (USD) of a million flights by hazard mapper.

    `row_bytes` is the storage of the results of one flight, bytes.
    """
    write = _writer_time(folder)
    print(
        f"  writer: {1e3 * write:.2f} ms per row on one core, {1.0 / write:.0f} rows per second; "
        f"{row_bytes:.0f} bytes of Parquet per row, {_FLIGHT_COUNT * row_bytes / 1e9:.2f} GB for "
        f"{_FLIGHT_COUNT:,} rows"
    )
    print(f"  {_FLIGHT_COUNT:,} flights, {_CORES} cores, {_USD_PER_CORE_HOUR} USD a core-hour:")
    print(
        "  | mapper | core time per flight (s) | core-hours | hours | USD | max cores for one "
        "writer |"
    )
    for name, mapper, flights in _TIMED_FLIGHTS:
        each = _seconds(name, flights, None)
        hours = _FLIGHT_COUNT * each / 3600.0
        print(
            f"  | {mapper} (`{name}.toml`) | {each:.2f} | {hours:,.0f} | {hours / _CORES:.1f} | "
            f"{_USD_PER_CORE_HOUR * hours:,.0f} | {each / write:,.0f} |"
        )


def _writer_time(folder: Path) -> float:
    """Return the processor time to store the results of one flight, s."""
    from dataclasses import replace

    from lunarsim.campaign.flight_execution import build_plan
    from lunarsim.campaign.outcomes import FLOWN, Finished
    from lunarsim.campaign.store import Store

    plan = replace(build_plan(_spec("hirise", _ROW_COUNT)), identity={})
    kinds = {"bool": True, "int": 3, "float": 1.25, "text": "rate"}
    row = {name: kinds[kind] for name, kind in plan.columns.items()}
    store = Store.open(folder / "written", plan)
    began = time.process_time()
    for index in range(_ROW_COUNT):
        store.add(Finished(index, 0, FLOWN, row))
    store.close("complete")
    return (time.process_time() - began) / _ROW_COUNT


def _spec(name: str, flights: int) -> Any:
    """Return the specification of a campaign of a supplied scenario."""
    from lunarsim.campaign.spec import CampaignSpec

    path = ROOT / "scenarios" / f"{name}.toml"
    return CampaignSpec.from_dict({"scenario": str(path), "flights": flights, "seed": 1})


def _seconds(name: str, flights: int, cache: Any) -> float:
    """Return the median processor time of a flight of a scenario, s.

    The first flight, which compiles kernels, is excluded; `cache` is a cache of worlds or None.
    """
    from lunarsim.campaign.flight_execution import build_plan, fly
    from lunarsim.campaign.plan import Group

    study = build_plan(_spec(name, flights + 1), cache=cache).work.study
    took = []
    for index in range(flights + 1):
        began = time.process_time()
        fly(study, Group(index, (0,)), 0, {})
        took.append(time.process_time() - began)
    return float(np.median(took[1:]))
