"""Measure p_safe of maps from two LiDAR scans whose estimated positions do not agree.

Two scans of one terrain are taken from different places. The estimated position of the first is
wrong by a horizontal offset that is not part of the stated uncertainty. Truth is evaluated at a
posting of 0.1 m.

python scenarios/lidar_maps/scan_offsets.py --worlds 24
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from rich.table import Table
from worlds import LANDERS, UPRIGHT, LidarScene

from lunarsim import Grid, site_safety
from lunarsim.api import Estimate
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper, SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import DemSnapshot
from lunarsim.rocks.population import RockExpectation
from lunarsim.studies import Case, Report, Study, run_script

RELIEFS = ("flat", "fractal-3", "tilt-5", "fractal-6", "rough-5", "craters")
ROCKS = ("golombek-5", "golombek-2", "one-metre", "golombek-10", "irregular-5", "small-0.6")
RANGES, ANGLES = (120.0, 200.0, 300.0), (0.0, 30.0)
SIDE, POSTING = 24.0, 0.2  # side and posting of the map, m
OFFSETS = (0.0, 0.2, 0.4, 0.8)  # horizontal offsets, m


def scenes(number: int, seed: int) -> list[LidarScene]:
    """Return two scenes of one terrain; the second scan is taken from 0.8 of the range."""
    first = LidarScene(
        RELIEFS[number % 6], ROCKS[number // 2 % 6], "paper", RANGES[number % 3],
        ANGLES[number % 2], 1.0, 10_000 * seed + number,
    )  # fmt: skip
    return [first, replace(first, distance=0.8 * first.distance)]


def measure_offsets(case: Case) -> list[dict[str, Any]]:
    """Map one terrain with each offset, with and without alignment of the scans."""
    pair = scenes(case.number, case.seed)
    terrain, lander = pair[0].terrain(), LANDERS["paper"]
    grid = Grid.centred((0.0, 0.0), SIDE, POSTING)
    scans = [scene.simulate_scan(terrain) for scene in pair]
    azimuth = np.random.default_rng([case.seed, case.number]).uniform(0.0, 2.0 * np.pi)
    rows = []
    for offset in OFFSETS:
        error = offset * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        places = (scans[0][1] + error, scans[1][1])
        mapper, pool = GaussianDemMapper(grid, lander), SamplePool(grid)
        for (scan, _), place in zip(scans, places, strict=True):
            state = Estimate(
                0.0, place, np.zeros(3), UPRIGHT, np.zeros(3), 1000.0, np.zeros((9, 9))
            )
            mapper.update(scan, state)
            pool.add(scan.points(place, UPRIGHT), scan.height_sigma(UPRIGHT), scan.spacing(UPRIGHT))
        plain = DemSnapshot(pooled_dem(pool), lander, RockExpectation(), None).hazard_map
        for name, found in (("yes", mapper.hazard_map()), ("no", plain)):
            safe, known = site_safety(terrain, found.grid, lander)
            claimed = known & found.in_domain & (found.p_safe > 0.95)
            rows.append({
                "offset_m": offset, "aligned": name, "known": int(known.sum()),
                "safe": int((known & safe).sum()), "claimed": int(claimed.sum()),
                "claimed_safe": int((claimed & safe).sum()),
            })  # fmt: skip
    return rows


def print_offsets(report: Report) -> None:
    """Print claims and precision for each offset, summed over all worlds."""
    count = len(report.groups("number"))
    table = Table(title=f"Cells with p_safe > 0.95 in the domain, {count} worlds, two scans each")
    for heading in ("offset of the\nfirst scan (m)", "scans\naligned", "claimed\n(fraction)",
                    "precision", "precision,\nworst world", "recall"):  # fmt: skip
        table.add_column(heading, justify="right")
    for (offset, aligned), rows in sorted(report.groups("offset_m", "aligned").items()):
        known, safe, claimed, right = (
            report.column(name, rows) for name in ("known", "safe", "claimed", "claimed_safe")
        )
        many = claimed >= 50
        worst = float((right[many] / claimed[many]).min()) if many.any() else np.nan
        table.add_row(
            f"{offset:.1f}", str(aligned), f"{claimed.sum() / known.sum():.3f}",
            f"{right.sum() / claimed.sum():.4f}", f"{worst:.3f}", f"{right.sum() / safe.sum():.3f}",
        )  # fmt: skip
    report.print(table)


study = Study(measure_offsets, repeats="worlds", count=24, seed=9, report=print_offsets)

if __name__ == "__main__":
    run_script(study)
