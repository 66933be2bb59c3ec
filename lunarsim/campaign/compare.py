"""Fly several policies over the same worlds and write what came of it.

Flight i of every policy has the same world, start, sensor noise and navigation errors: they all
derive from the root seed and i alone, so any number of processes gives the same bits.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import lunarsim
from lunarsim.campaign.pool import outcomes
from lunarsim.errors import InputError
from lunarsim.evaluation.outcome import evaluate
from lunarsim.onboard.policies.contract import RetargetingPolicy
from lunarsim.parts import resolve
from lunarsim.rng import Streams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation, build_world
from lunarsim.world.truth import Truth

Progress = Callable[[int], None]


@dataclass(frozen=True)
class CompareResult:
    """What a comparison gave.

    Attributes
    ----------
    rows
        One dictionary a flight and policy, by flight, then policy.
    seconds
        Wall-clock seconds of each flight, by policy.
    safe_share, safe_share_at_heading
        Mean share of exactly safe ground where targets are drawn: at every heading, and at the
        heading that is flown.
    complete
        False when the run was interrupted.
    """

    rows: list[dict[str, Any]]
    seconds: dict[str, list[float]]
    safe_share: float
    safe_share_at_heading: float
    complete: bool


@dataclass(frozen=True)
class _Task:
    scenario: Scenario
    policies: tuple[str | RetargetingPolicy, ...]
    root: int
    flight: int
    out: Path | None
    figures: bool


@dataclass(frozen=True)
class _Outcome:
    flight: int
    rows: list[dict[str, Any]]
    seconds: dict[str, float]
    shares: tuple[float, float]


def _fly_all(task: _Task) -> _Outcome:
    """Fly one index under every policy."""
    scenario = task.scenario
    seed = flight_seed(task.root, task.flight)
    world = build_world(scenario, Streams(seed))
    truth = Truth.of(world, scenario.vehicle.make())
    # Scatter half sides of zero still mean a spot: look at a footprint's width around it.
    half = np.maximum(scenario.target.scatter_m, 2.0)
    centre = scenario.target.position_m
    shares = (
        truth.safe_share(centre, half),
        truth.safe_share(centre, half, np.deg2rad(scenario.start.heading_deg)),
    )
    rows, seconds = [], {}
    for policy in task.policies:
        name = policy_name(policy)
        began = time.perf_counter()
        simulation = Simulation(scenario, seed, policy, world=world, truth=truth)
        flight = simulation.run()
        seconds[name] = time.perf_counter() - began
        rows.append({"flight": task.flight, **evaluate(flight, truth), "policy": name})
        if task.out is not None:
            flight.save(task.out / "flights" / name / f"{task.flight:05d}")
            if task.figures:
                from lunarsim.viz import draw_flight  # noqa: PLC0415  (matplotlib is slow to load)

                draw_flight(flight, world, truth, task.out / "figures" / name)
    return _Outcome(task.flight, rows, seconds, shares)


def policy_name(policy: str | RetargetingPolicy) -> str:
    """Return the name of a policy in tables and folders."""
    name = policy if isinstance(policy, str) else policy.name
    return name.rpartition(":")[2] if ":" in name else name


def check_request(policies: Sequence[str | RetargetingPolicy], flights: int, jobs: int) -> None:
    """Raise `InputError` for a request that cannot be met."""
    for policy in policies:
        if isinstance(policy, str):
            resolve("policy", policy, "--policies")
        elif not (hasattr(policy, "decide") and isinstance(getattr(policy, "name", None), str)):
            raise InputError("policies", policy, "an object with `name` and `decide(observation)`")
    if not policies:
        raise InputError("--policies", "", "at least one; `lunarsim parts policy` lists them")
    names = [policy_name(policy) for policy in policies]
    if len(set(names)) < len(names):
        raise InputError("--policies", ",".join(names), "each policy once")
    if flights < 1:
        raise InputError("--flights", flights, "at least 1")
    if jobs < 1:
        raise InputError("--jobs", jobs, "at least 1")


def check_folder(out: Path) -> None:
    """Raise `InputError` if `out` cannot take results."""
    if out.exists() and not out.is_dir():
        raise InputError("--out", str(out), "a folder, not a file")
    if out.exists() and any(out.iterdir()):
        raise InputError("--out", str(out), "an empty or new folder: this one holds other files")


def compare(
    scenario: Scenario,
    policies: Sequence[str | RetargetingPolicy],
    *,
    flights: int,
    seed: int,
    jobs: int = 1,
    out: Path | None = None,
    progress: Progress | None = None,
    figures: bool = True,
) -> CompareResult:
    """Fly `flights` flights under each policy.

    Parameters
    ----------
    scenario
        The study.
    policies
        Policies: names, "module:Class", or objects that can be pickled where `jobs` is above 1.
    flights, seed, jobs
        Flights a policy, root seed, processes.
    out
        New folder for all results; left out: nothing is written. The results table is written
        last and whole; an interrupt writes the flights that are finished.
    progress, figures
        Called with the number of flights finished since the last call; whether to draw the first
        flight of each policy and the comparison.

    Raises
    ------
    InputError
        If the scenario, the request or the folder will not do; nothing has been written then.
    """
    check_request(policies, flights, jobs)
    if out is not None:
        check_folder(out)
    Simulation(scenario, flight_seed(seed, 0), "no-divert")  # fail before anything is written
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        scenario.save(out / "scenario.toml")
    tasks = [
        _Task(scenario, tuple(policies), seed, i, out, figures and i == 0) for i in range(flights)
    ]
    done, complete = _gather(tasks, min(jobs, flights), len(policies), progress)
    result = CompareResult(
        rows=[row for outcome in done for row in outcome.rows],
        seconds={
            name: [outcome.seconds[name] for outcome in done] for name in map(policy_name, policies)
        },
        safe_share=_mean([outcome.shares[0] for outcome in done]),
        safe_share_at_heading=_mean([outcome.shares[1] for outcome in done]),
        complete=complete,
    )
    if out is not None and result.rows:
        _write(result, out, scenario, seed)
        if figures:
            from lunarsim.viz import draw_comparison  # noqa: PLC0415

            draw_comparison(result.rows, scenario, out / "figures" / "comparison.png")
    return result


def _gather(
    tasks: list[_Task], jobs: int, policies: int, progress: Progress | None
) -> tuple[list[_Outcome], bool]:
    """Return what came of the tasks by flight, and whether all are done."""
    done: list[_Outcome] = []
    complete = False
    try:
        for _, outcome in outcomes(_fly_all, tasks, jobs):
            done.append(outcome)
            if progress is not None:
                progress(policies)
        complete = True
    except KeyboardInterrupt:
        pass
    return sorted(done, key=lambda outcome: outcome.flight), complete


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _write(result: CompareResult, out: Path, scenario: Scenario, seed: int) -> None:
    """Write the results so that no reader ever sees half a file."""
    temporary = out / ".results.parquet.part"
    pq.write_table(pa.Table.from_pylist(result.rows), temporary)
    temporary.replace(out / "results.parquet")
    summary = {
        "scenario": scenario.name,
        "seed": seed,
        "version": lunarsim.__version__,
        "complete": result.complete,
        "exactly_safe_share": result.safe_share,
        "exactly_safe_share_at_heading": result.safe_share_at_heading,
        "seconds_per_flight": {p: _mean(s) for p, s in result.seconds.items()},
    }
    (out / "summary.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
