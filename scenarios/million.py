"""Simulate a million descents in compiled kernels and report failure rates.

    python scenarios/million.py                    # 1,000,000 flights of about 60 s each
    python scenarios/million.py --flights 10000

The simulation has six degrees of freedom, guidance, a fast statistical substitute (surrogate) of
the Gaussian DEM's perception, a site decision after every scan, and the touchdown evaluation.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numba

from lunarsim import InputError, Scenario
from lunarsim.console import plain_console, plain_progress
from lunarsim.scenario.shipped import found
from lunarsim.studies import Proportion
from lunarsim_envs.retarget import default_scenario
from lunarsim_envs.sites.sparse_batch import FlightSummary, batches

# From this start, the minimum-propellant flight takes one minute.
_START = {"position_m": [-1500.0, 0.0, 1150.0], "velocity_m_s": [45.0, 0.0, -30.0]}


def scenario_of(name: str | None, step: float) -> Scenario:
    """Load a scenario by name or path and set its integration step (s).

    None gives the default scenario with 12 % rock cover and a start 1150 m above the site.
    """
    given = default_scenario() if name is None else Scenario.load(found(Path(name)))
    clock = {"step_s": step}
    if name is None:
        return given.changed(rocks={"cover": 0.12}, start=_START, simulation=clock)
    return given.changed(simulation=clock)


def results_text(summary: FlightSummary, seconds: float) -> str:
    """Format failure rates and calibration of p_safe over all flights as text.

    `seconds` is the wall time of the simulation.
    """
    n = summary.flights
    lines = [
        f"{n:,} descents of {summary.seconds / n:.1f} s in {seconds:.1f} s on "
        f"{numba.get_num_threads()} threads: {n / seconds:,.0f} per second, "
        f"{summary.seconds / seconds:,.0f} simulated s/s",
        f"mean propellant of safe landings: {summary.propellant / max(summary.safe, 1):.2f} kg",
        "", f"{'':<18} {'flights':>9} {'rate':>9}  95 % interval",
    ]  # fmt: skip
    for name, count in (("not safe", n - summary.safe), *summary.failed.items()):
        low, high = Proportion(count, n).interval
        lines.append(f"{name:<18} {count:>9,} {count / n:>9.5f}  [{low:.5f}, {high:.5f}]")
    lines += ["", "reported p_safe   flights   safe fraction  95 % interval"]
    for k in range(10):
        count, safe = int(summary.by_p_safe[k]), int(summary.safe_by_p_safe[k])
        if count:
            low, high = Proportion(safe, count).interval
            lines.append(
                f"{k / 10:.1f} to {(k + 1) / 10:.1f} {count:>14,} {safe / count:>14.4f}  "
                f"[{low:.4f}, {high:.4f}]"
            )
    return "\n".join(lines)


def main() -> int:
    """Fly a million descents (or --flights) and print failure rates and calibration."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=1_000_000, help="number of flights")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed from which all random numbers derive"
    )
    parser.add_argument(
        "--worlds",
        type=int,
        default=32,
        help="number of random terrains over which the flights are distributed",
    )
    parser.add_argument(
        "--scenario",
        help="scenario: TOML file, or a name from `lunarsim scenario list` (default: rolling "
        "terrain with 12 %% rock cover)",
    )
    parser.add_argument("--step", type=float, default=0.02, help="time step of the integration (s)")
    args = parser.parse_args()
    console = plain_console(stderr=True)
    tally, cut, start_s = None, False, 0.0
    try:
        for name, least in (("flights", 1), ("seed", 0), ("worlds", 1)):
            if getattr(args, name) < least:
                raise InputError(f"--{name}", getattr(args, name), f"must be {least} or more")
        scenario = scenario_of(args.scenario, args.step)
        # The first flights include compilation and world generation; they are not counted.
        console.print("preparing worlds and kernels")
        next(batches(scenario, min(args.flights, 64), args.seed, args.worlds))
        start_s = time.perf_counter()
        with plain_progress(console, transient=True) as progress:
            task = progress.add_task("flights", total=args.flights)
            for one in batches(scenario, args.flights, args.seed, args.worlds):
                tally = one if tally is None else tally + one
                progress.advance(task, one.flights)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        cut = True
    if tally is not None:
        print(results_text(tally, time.perf_counter() - start_s))
    if cut:
        console.print(
            "interrupted"
            if tally is None
            else "interrupted: the results cover the flights until then"
        )
    return 130 if cut else 0


if __name__ == "__main__":
    sys.exit(main())
