"""What flights of a campaign cost, and from that a million of them on a cluster."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from bench_parts.common import ROOT

# Scenario, what maps its hazards, flights that are timed.
_FLOWN = (
    ("hirise", "Gaussian DEM", 5),
    ("hard", "Gaussian DEM, one scan", 5),
    ("morpheus", "quadtree", 1),
    ("shadow_nominal", "shadows", 1),
)
_MANY, _CORES, _PRICE = 1_000_000, 640, 0.04
# Rows that the writer is timed over.
_WRITTEN = 2000


def worlds(folder: Path) -> None:
    """Print what a world and the truth about it cost, and a flight without and with them kept."""
    from lunarsim.campaign.cache import opened
    from lunarsim.campaign.grounds import Grounds
    from lunarsim.rng import flight_seed

    spec = _spec("hard", 4)
    took: dict[str, list[float]] = {"relief and rocks": [], "truth": [], "shares": []}
    for index in range(4):
        grounds = Grounds(flight_seed(1, index), {})
        scenario = spec.scenario_of(index, 0)
        steps = [time.process_time()]
        world = _world(grounds, scenario)
        steps.append(time.process_time())
        _, truth = grounds.world_and_truth(scenario)
        steps.append(time.process_time())
        grounds.shares(scenario, truth)
        steps.append(time.process_time())
        for name, cost in zip(took, np.diff(steps), strict=True):
            took[name].append(float(cost))
        del world
    cache = opened(folder / "worlds")
    told = ", ".join(f"{name} {np.median(costs[1:]):.2f} s" for name, costs in took.items())
    cold, filled, warm = (_seconds("hard", 4, kept) for kept in (None, cache, cache))
    size = np.mean([p.stat().st_size for p in (folder / "worlds").glob("??/*.npz")])
    print(
        f"  hard, processor time: {told}; a flight {cold:.2f} s without a cache, {filled:.2f} s "
        f"filling one, {warm:.2f} s from it; {2.0 * size / 1e6:.1f} MB kept of a world"
    )


def _world(grounds: Any, scenario: Any) -> Any:
    from lunarsim.rng import Streams
    from lunarsim.simulation import build_world

    return build_world(scenario, Streams(grounds.seed))


def million(folder: Path, row_bytes: float) -> None:
    """Print what a million flights cost, by what maps hazards."""
    write = _writing(folder)
    print(
        f"  the writer takes {1e3 * write:.2f} ms of a core a row, {1.0 / write:.0f} a second; "
        f"a row is {row_bytes:.0f} bytes of Parquet, {_MANY:,} are {_MANY * row_bytes / 1e9:.2f} GB"
    )
    print(f"  {_MANY:,} flights, {_CORES} cores, {_PRICE} USD a core-hour:")
    print("  | mapper | s of a core | core-hours | hours | USD | cores the writer keeps up with |")
    for name, mapper, flights in _FLOWN:
        each = _seconds(name, flights, None)
        hours = _MANY * each / 3600.0
        print(
            f"  | {mapper} (`{name}.toml`) | {each:.2f} | {hours:,.0f} | {hours / _CORES:.1f} | "
            f"{_PRICE * hours:,.0f} | {each / write:,.0f} |"
        )


def _writing(folder: Path) -> float:
    """Return the processor time of the writer for a row of a real campaign's columns, s."""
    from dataclasses import replace

    from lunarsim.campaign.flying import plan_of
    from lunarsim.campaign.outcomes import FLOWN, Finished
    from lunarsim.campaign.store import Store

    plan = replace(plan_of(_spec("hirise", _WRITTEN)), identity={})
    kinds = {"bool": True, "int": 3, "float": 1.25, "text": "rate"}
    row = {name: kinds[kind] for name, kind in plan.columns.items()}
    store = Store.open(folder / "written", plan)
    began = time.process_time()
    for index in range(_WRITTEN):
        store.add(Finished(index, 0, FLOWN, row))
    store.close("complete")
    return (time.process_time() - began) / _WRITTEN


def _spec(name: str, flights: int) -> Any:
    from lunarsim.campaign.spec import CampaignSpec

    path = ROOT / "scenarios" / f"{name}.toml"
    return CampaignSpec.from_dict({"scenario": str(path), "flights": flights, "seed": 1})


def _seconds(name: str, flights: int, cache: Any) -> float:
    """Return the processor time of a flight, median; the first, which compiles, is left out."""
    from lunarsim.campaign.flying import fly, plan_of
    from lunarsim.campaign.plan import Group

    study = plan_of(_spec(name, flights + 1), cache=cache).work.study
    took = []
    for index in range(flights + 1):
        began = time.process_time()
        fly(study, Group(index, (0,)), 0, {})
        took.append(time.process_time() - began)
    return float(np.median(took[1:]))
