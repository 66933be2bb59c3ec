"""Fit the surrogate of a hazard mapper and compare both on held-out flights.

    python scenarios/learning/fit_surrogate.py --out out/surrogate.npz
    python scenarios/learning/fit_surrogate.py --check

A surrogate is a fast statistical substitute: it samples hazard maps at random with the error
statistics of the mapper. The first command flies the scenario with several rock covers and writes
the file. `--check` without `--out` uses the file supplied with lunarsim. Both commands then fly
held-out covers and seeds, and print calibration, false-negative and false-positive rates, and
correlation length of the mapper and the surrogate, with the interval from resampling the flights of
the mapper.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from lunarsim import InputError, Scenario
from lunarsim.scenario.shipped import found
from lunarsim_envs.retarget import default_scenario
from lunarsim_envs.sites.map_samples import SampledFlight, sample_flights
from lunarsim_envs.sites.surrogate import SHIPPED, Surrogate
from lunarsim_envs.sites.surrogate_fit import fit_mapper_surrogate
from lunarsim_envs.sites.surrogate_report import compare_metrics

# Rock covers of the fit, and held-out ones; root seeds of both, plus one per cover.
FIT_COVERS = (0.02, 0.03, 0.04, 0.055, 0.07, 0.0775, 0.085, 0.0925, 0.10, 0.125, 0.15)
HELD_OUT = (0.0475, 0.0625, 0.081, 0.11)
SEED, HELD_OUT_SEED = 501, 901


def fly_covers(
    scenario: Scenario, covers: Iterable[float], seed: int, flights: int
) -> list[list[SampledFlight]]:
    """Simulate flights over terrain with each rock cover; return their hazard maps.

    `seed` is the root seed of the first cover, `flights` the number of flights per cover.
    """
    out = []
    for number, cover in enumerate(covers):
        here = scenario.changed(rocks={"cover": cover})
        out.append(list(sample_flights(here, seed + number, range(flights))))
        share = np.mean([flight.safe_share for flight in out[-1]])
        print(f"  cover {cover:g}: {flights} flights, {share:.2f} of the terrain safe", flush=True)
    return out


def check_surrogate(surrogate: Surrogate, scenario: Scenario, flights: int) -> None:
    """Compare the statistics of surrogate and mapper on held-out terrain; print them.

    `flights` is the number of flights per rock cover.
    """
    rng = np.random.default_rng(1)
    inside = total = 0
    flown = fly_covers(scenario, HELD_OUT, HELD_OUT_SEED, flights)
    for cover, episodes in zip(HELD_OUT, flown, strict=True):
        for scan in range(len(surrogate.altitudes)):
            print(f"cover {cover:g}, scan {scan + 1}: mapper, 95 % interval, surrogate")
            for row in compare_metrics(surrogate, episodes, scan, rng):
                if np.isnan(row.mapper):
                    continue
                total, inside = total + 1, inside + row.within
                print(
                    f"  {row.name:<48} {row.mapper:6.3f} [{row.low:6.3f}, {row.high:6.3f}] "
                    f"{row.surrogate:6.3f}{'' if row.within else '  outside'}"
                )
    print(f"{inside} of {total} values within the interval")


def main() -> int:
    """Fit the surrogate of a mapper, or check one against the mapper."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--scenario",
        help="scenario: TOML file, or a name from `lunarsim scenario list` (default: scenario of "
        "Retarget-v1)",
    )
    parser.add_argument(
        "--flights", type=int, default=10, help="number of flights for each value of the rock cover"
    )
    parser.add_argument("--out", type=Path, help="file for the surrogate (.npz)")
    parser.add_argument(
        "--check", action="store_true", help="do not fit a surrogate, but check the existing file"
    )
    args = parser.parse_args()
    try:
        if args.flights < 4:
            raise InputError("--flights", args.flights, "must be 4 or more")
        if not args.check and args.out is None:
            raise InputError("--out", None, "must be given without --check", show_value=False)
        scenario = (
            default_scenario()
            if args.scenario is None
            else Scenario.load(found(Path(args.scenario)))
        )
        if args.check:
            surrogate = Surrogate.load(args.out or SHIPPED)
            surrogate.check(scenario)
        else:
            surrogate = fit_mapper_surrogate(
                scenario, fly_covers(scenario, FIT_COVERS, SEED, args.flights)
            )
            surrogate.save(args.out)
            print(f"wrote {args.out}: {args.out.stat().st_size / 1e3:.0f} kB")
        check_surrogate(surrogate, scenario, args.flights)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
