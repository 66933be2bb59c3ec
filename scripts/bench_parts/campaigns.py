"""Measure the overhead of campaigns beyond the flights."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench_parts.campaign_costs import million, worlds
from bench_parts.common import ROOT

# Empty flights of the overhead test, of the memory test; hirise flights of the memory test; rows of
# the report test.
_OVERHEAD_FLIGHTS, _MEMORY_COUNTS, _MEMORY_FLIGHTS, _ROWS = (
    3000, (1000, 5000, 15_000), 16, 1_000_000
)  # fmt: skip
# Number of tasks for two processes, and loop iterations of each: some tenths of a second.
_TASKS, _TURNS = 24, 4_000_000


def campaign() -> None:
    """Measure overhead, speed-up of two jobs, memory, report time, cost of campaigns."""
    with tempfile.TemporaryDirectory() as folder:
        _memory(Path(folder))
        _jobs(Path(folder))
        _overhead(Path(folder))
        row_bytes = _report(Path(folder))
        worlds(Path(folder))
        million(Path(folder), row_bytes)


def fixed_result(study: Any, group: Any, arm: int, memory: Any) -> dict[str, Any]:
    """Replace a campaign's flight function: return a fixed result and memory, MiB."""
    return {"safe": group.flight % 3 > 0, "mib": _memory_mib(), **dict.fromkeys("abcdefgh", 1.5)}


def flight_with_memory(study: Any, group: Any, arm: int, memory: Any) -> dict[str, Any]:
    """Fly one flight of a campaign; return its outcome and this process's memory, MiB."""
    from lunarsim.campaign.flight_execution import fly

    return {"safe": fly(study, group, arm, memory)["safe"], "mib": _memory_mib()}


def busy_loop(study: Any, group: Any, arm: int, memory: Any) -> dict[str, Any]:
    """Replace a campaign's flight function: keep a core busy for `study` iterations."""
    spin(int(study))
    return {"safe": True}


def spin(count: int) -> None:
    """Run an empty loop of `count` iterations, to keep a core busy."""
    for _ in range(count):
        pass


def _plan(flights: int, function: str, study: Any = None) -> Any:
    """Return a campaign plan that calls `function` of this module for each flight."""
    from lunarsim.campaign.plan import Plan, Work

    kinds = {"safe": "bool", "mib": "float"} | dict.fromkeys("abcdefgh", "float")
    return Plan(
        name="bench", seed=1, flights=flights, arms=[("all", {})], groups=[(0,)],
        draws=lambda flight: {}, columns=kinds, inputs={},
        work=Work(f"bench_parts.campaigns:{function}", study), identity={"flights": flights},
    )  # fmt: skip


def _overhead(folder: Path) -> None:
    """Print the campaign's overhead per flight, and its fraction of a flight's time."""
    from lunarsim.campaign.cache import open_cache
    from lunarsim.campaign.engines.local import LocalEngine
    from lunarsim.campaign.flight_execution import build_plan
    from lunarsim.campaign.outcomes import import_function
    from lunarsim.campaign.plan import Group
    from lunarsim.campaign.run import run
    from lunarsim.campaign.spec import CampaignSpec

    took = []
    for flights in (100, 100, 100 + _OVERHEAD_FLIGHTS):  # the first run includes late imports
        began, wall = _processor_time(), time.perf_counter()
        run(_plan(flights, "fixed_result"), LocalEngine(1), folder / f"empty-{len(took)}")
        took.append((_processor_time() - began, time.perf_counter() - wall))
    _, (few, few_wall), (many, many_wall) = took
    machinery, waited = (many - few) / _OVERHEAD_FLIGHTS, (many_wall - few_wall) / _OVERHEAD_FLIGHTS
    name = ROOT / "scenarios" / "hirise.toml"
    spec = CampaignSpec.from_dict({"scenario": str(name), "flights": 8, "seed": 1})
    bare = {}
    cache = open_cache(folder / "cache")
    for label, kept in (("cold", None), ("filled", cache), ("warm", cache)):
        work = build_plan(spec, cache=kept).work
        import_function(work)(work.study, Group(0, (0,)), 0, {})
        times = []
        for i in range(1, 6):
            began = time.process_time()
            import_function(work)(work.study, Group(i, (0,)), 0, {})
            times.append(time.process_time() - began)
        bare[label] = float(np.median(times))
    print(
        f"  overhead: {1e3 * machinery:.2f} ms of processor time per flight ({1e3 * waited:.2f} ms "
        f"of "
        f"wall-clock time); a flight of hirise alone on one thread {1e3 * bare['cold']:.0f} ms, "
        f"{1e3 * bare['warm']:.0f} ms with truth from the cache: fraction "
        f"{100.0 * machinery / bare['cold']:.2f} and {100.0 * machinery / bare['warm']:.2f} %"
    )


def _jobs(folder: Path) -> None:
    """Print the speed-up of a campaign by two jobs, and of two plain processes."""
    from lunarsim.campaign.engines.local import LocalEngine
    from lunarsim.campaign.results import load_results
    from lunarsim.campaign.run import run

    engine, bare, busy = [], [], []
    for turn in range(3):
        walls = []
        for jobs in (1, 2):
            at: list[float] = []
            plan = _plan(_TASKS, "busy_loop", _TURNS)
            # Timed from the end of the first flight, because workers take seconds to start.
            run(
                plan, LocalEngine(jobs), folder / f"jobs-{turn}-{jobs}",
                progress=lambda n, at=at: at.append(time.perf_counter()),
            )  # fmt: skip
            walls.append((at[-1] - at[jobs - 1]) / (_TASKS - jobs))
        busy.append(_busy_fraction(load_results(folder / f"jobs-{turn}-2").timing.to_pandas()))
        engine.append(walls[0] / walls[1])
        bare.append(_time_without_campaign(1) / _time_without_campaign(2))
    ours, theirs = float(np.median(engine)), float(np.median(bare))
    print(
        f"  speed-up of two jobs: {ours:.2f}; of two bare processes at the same "
        f"time: {theirs:.2f} ({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}): "
        f"{100.0 * ours / theirs:.0f} % of the possible; workers were flying "
        f"{100.0 * float(np.median(busy)):.1f} % of the time"
    )


def _busy_fraction(timing: Any) -> float:
    """Return the mean fraction of time that workers spent in flights.

    `timing` is the timing table of a campaign.
    """
    shares = []
    for _, one in timing.groupby("worker"):
        ended = one["finished_unix_s"].to_numpy()
        flying = one["seconds"].to_numpy()[1:].sum()
        shares.append(flying / (ended.max() - ended.min()))
    return float(np.mean(shares))


def _time_without_campaign(processes: int) -> float:
    """Return the time per task if processes without a campaign share the tasks, s.

    A task is a call of `spin`.
    """
    each = _TASKS // processes
    code = (
        "import time; from bench_parts.campaigns import spin; began = time.perf_counter()\n"
        f"for _ in range({each}): spin({_TURNS})\n"
        "print(time.perf_counter() - began)"
    )
    running = [
        subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=ROOT / "scripts"
        )
        for _ in range(processes)
    ]
    return max(float(p.communicate()[0]) for p in running) / _TASKS


def _memory(folder: Path) -> None:
    """Print the memory of main process and worker during campaigns of many flights."""
    from lunarsim.campaign.engines.local import LocalEngine
    from lunarsim.campaign.flight_execution import build_plan
    from lunarsim.campaign.results import load_results
    from lunarsim.campaign.run import run
    from lunarsim.campaign.spec import CampaignSpec

    ours: list[float] = []
    run(
        _plan(_MEMORY_COUNTS[-1], "fixed_result"), LocalEngine(1), folder / "memory",
        progress=lambda n: ours.append(_memory_mib()),
    )  # fmt: skip
    theirs = load_results(folder / "memory", ["mib"]).table["mib"].to_numpy()
    memory_text = [
        f"{label} {', '.join(f'{at[n - 1]:.0f}' for n in _MEMORY_COUNTS)} MiB"
        for label, at in (("driver", ours), ("worker", theirs))
    ]
    counts = ", ".join(map(str, _MEMORY_COUNTS))
    print(f"  memory after {counts} empty flights (part size 5000): " + "; ".join(memory_text))
    name = ROOT / "scenarios" / "hirise.toml"
    spec = CampaignSpec.from_dict({"scenario": str(name), "flights": _MEMORY_FLIGHTS, "seed": 1})
    plan = _plan(_MEMORY_FLIGHTS, "flight_with_memory", build_plan(spec).work.study)
    run(plan, LocalEngine(1), folder / "real")
    real = load_results(folder / "real", ["mib"]).table["mib"].to_numpy()
    print(
        f"  memory of a worker after 2, {_MEMORY_FLIGHTS // 2} and {_MEMORY_FLIGHTS} flights of "
        f"hirise: "
        f"{real[1]:.0f}, {real[_MEMORY_FLIGHTS // 2 - 1]:.0f} and {real[-1]:.0f} MiB"
    )


def _report(folder: Path) -> float:
    """Print the time of a campaign report of a million flights.

    Returns the stored bytes per flight.
    """
    from lunarsim.campaign.engines.inline import InlineEngine
    from lunarsim.campaign.report import write_report
    from lunarsim.campaign.run import run

    out = folder / "rows"
    run(_plan(1, "fixed_result"), InlineEngine(), out)
    _fill_with_rows(out, _ROWS)
    began, wall = time.process_time(), time.perf_counter()
    write_report(out, out / "report.html")
    print(
        f"  report of {_ROWS:,} rows of four arms: {time.process_time() - began:.1f} s of "
        f"processor time, {time.perf_counter() - wall:.1f} s of wall-clock time, "
        f"{(out / 'report.html').stat().st_size / 1e6:.1f} MB"
    )
    parts = [p for kind in ("results", "timing") for p in (out / kind).glob("*.parquet")]
    return sum(p.stat().st_size for p in parts) / _ROWS


def _fill_with_rows(out: Path, rows: int) -> None:
    """Fill a campaign folder with random results of `rows` flights."""
    import json

    import pyarrow as pa
    import pyarrow.parquet as pq

    from lunarsim.campaign.flight_execution import SAFE_SHARE_COLUMNS
    from lunarsim.campaign.manifest import with_digest
    from lunarsim.campaign.rows import TIMING, schema_of
    from lunarsim.campaign.store import PART_ROWS
    from lunarsim.evaluation.flight_metrics import COLUMNS

    manifest = json.loads((out / "manifest.json").read_text())
    arms = [f"arm {i}" for i in range(4)]
    columns = COLUMNS | dict.fromkeys(SAFE_SHARE_COLUMNS, "float")
    manifest |= {
        "arms": [{"name": name, "values": {"level": i}} for i, name in enumerate(arms)],
        "flights": rows // 4, "columns": columns, "inputs": {"level": "int"}, "rows": rows,
    }  # fmt: skip
    (out / "manifest.json").write_text(json.dumps(with_digest(manifest)))
    rng = np.random.default_rng(1)
    schema = schema_of(manifest["inputs"], columns)
    for part in range(rows // PART_ROWS):
        index = np.arange(part * PART_ROWS, (part + 1) * PART_ROWS)
        fixed = {
            "id": [f"{i // 4}-{i % 4}" for i in index], "flight": index // 4,
            "arm": [arms[i % 4] for i in index], "outcome": ["flown"] * PART_ROWS,
            "level": index % 4,
        }  # fmt: skip
        arrays = []
        for field in schema:
            if field.name in fixed:
                arrays.append(pa.array(fixed[field.name], field.type))
            elif field.type == pa.bool_():
                arrays.append(pa.array(rng.random(PART_ROWS) < 0.5 + 0.1 * (index % 4)))
            elif field.type == pa.float64():
                arrays.append(pa.array(rng.random(PART_ROWS)))
            elif field.type == pa.int64():
                arrays.append(pa.array(rng.integers(100, size=PART_ROWS)))
            else:
                arrays.append(pa.array([""] * PART_ROWS, field.type))
        pq.write_table(
            pa.Table.from_arrays(arrays, schema=schema), _result_file(out, "results", part)
        )
        times = [fixed["id"], rng.random(PART_ROWS), rng.random(PART_ROWS), ["1"] * PART_ROWS,
                 [1] * PART_ROWS]  # fmt: skip
        table = pa.Table.from_arrays([pa.array(t) for t in times], schema=TIMING)
        pq.write_table(table, _result_file(out, "timing", part))


def _result_file(out: Path, kind: str, number: int) -> Path:
    """Return the path of a numbered Parquet file of a campaign folder.

    `kind` is "results" or "timing".
    """
    return out / kind / f"part-{number:05d}.parquet"


def _processor_time() -> float:
    """Return the processor time of this process and of its ended children, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def _memory_mib() -> float:
    """Return the current memory of this process, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20
