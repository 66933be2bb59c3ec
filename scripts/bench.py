"""Measure the speed of lunarsim as ratios to a reference in the same run.

    python scripts/bench.py              # all benchmarks
    python scripts/bench.py flight       # one benchmark

Every benchmark (part) compiles its kernels first and prints medians. Only ratios within one run
are comparable between machines.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import click
import numba
from bench_parts.all_sensors import eyes
from bench_parts.campaigns import campaign
from bench_parts.closed_loop import flight, frames
from bench_parts.cold_start import cold_start
from bench_parts.common import reference_ms
from bench_parts.environments import envs
from bench_parts.external import external
from bench_parts.gaussian_dem import gaussian_dem
from bench_parts.guidance import guidance
from bench_parts.interrupts import interrupts
from bench_parts.navigation import navigation
from bench_parts.optimal import optimal
from bench_parts.quadtree import lidar_inertial, quadtree
from bench_parts.seeking import seeking
from bench_parts.sensing import lidar, render, terrain
from bench_parts.shadows import shadows
from bench_parts.shared_paths import paths

PARTS: dict[str, Callable[[], None]] = {
    part.__name__: part
    for part in (
        flight,
        frames,
        cold_start,
        gaussian_dem,
        render,
        lidar,
        shadows,
        terrain,
        quadtree,
        lidar_inertial,
        navigation,
        guidance,
        optimal,
        seeking,
        eyes,
        envs,
        campaign,
        interrupts,
        paths,
        external,
    )
}


@click.command()
@click.argument("parts", nargs=-1)
def main(parts: tuple[str, ...]) -> None:
    """Run the benchmarks named by PARTS (default: all) and print times and ratios."""
    unknown = [name for name in parts if name not in PARTS]
    if unknown:
        raise click.UsageError(f"PARTS: must be among {', '.join(PARTS)}, got {unknown[0]!r}.")
    print(
        f"{os.cpu_count()} cores, {numba.get_num_threads()} threads; reference: SciPy triangulates "
        f"the returns of one scan in {reference_ms():.0f} ms"
    )
    for name in parts or PARTS:
        print(f"{name}: {(PARTS[name].__doc__ or '').strip().splitlines()[0]}")
        PARTS[name]()


if __name__ == "__main__":
    main()
