"""Measure what the Gaussian DEM claims if noise or tilt exceed what is stated.

Two scans of one terrain are taken from different places. The range noise is a multiple of the
stated one, or the attitude of the first scan or of both has a tilt error that is not part of the
stated uncertainty. "Scans checked: yes" is the mapper; "no" is a map of the same samples that
trusts the stated errors. Truth is evaluated at a posting of 0.1 m.

python scenarios/lidar_maps/stated_errors.py --worlds 24
python scenarios/lidar_maps/stated_errors.py --worlds 400 --nominal
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click
import numpy as np
from rich.table import Table
from worlds import LANDERS, LidarScene

from lunarsim import Grid, site_safety
from lunarsim.api import Estimate, HazardMap, LidarScan
from lunarsim.frames import quat_from_rotation_vector
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper, SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import DemSnapshot
from lunarsim.rocks.population import RockExpectation
from lunarsim.studies import Case, Report, Study, run_script

RELIEFS = (
    "flat", "fractal-3", "tilt-9", "fractal-6", "rough-5", "craters", "fractal-10", "pits",
)  # fmt: skip
ROCKS = ("golombek-5", "golombek-2", "one-metre", "golombek-20", "irregular-5", "small-0.6", "none")
RANGES, ANGLES = (120.0, 200.0, 300.0, 500.0), (0.0, 30.0)
SIDE, POSTING = 20.0, 0.2  # side and posting of the map, m
# Factor on the noise, tilt error of the first and of the second scan, deg.
FAULTS = (
    (1, 0.0, 0.0), (2, 0.0, 0.0), (4, 0.0, 0.0), (8, 0.0, 0.0), (1, 0.1, 0.0), (1, 0.25, 0.0),
    (1, 0.5, 0.0), (1, 0.1, 0.1), (1, 0.25, 0.25), (1, 0.5, 0.5),
)  # fmt: skip
GRID = Grid.centred((0.0, 0.0), SIDE, POSTING)
Shot = tuple[LidarScan, np.ndarray]


def scenes(number: int, seed: int) -> list[LidarScene]:
    """Return two scenes of one terrain; the second scan is taken from 0.8 of the range."""
    first = LidarScene(
        RELIEFS[number % 8], ROCKS[number % 7], "paper", RANGES[number // 2 % 4],
        ANGLES[number % 3 % 2], 1.0, 10_000 * seed + number,
    )  # fmt: skip
    return [first, replace(first, distance=0.8 * first.distance)]


def maps_of(
    shots: list[Shot], noise: float, tilts: list[float], azimuth: float
) -> dict[str, HazardMap]:
    """Return the maps of two scans with unstated errors, with and without checks.

    The stated noise is the true one divided by `noise`. `tilts` are the attitude errors of the
    scans about a horizontal axis with the given `azimuth`, deg.
    """
    mapper, pool = GaussianDemMapper(GRID, LANDERS["paper"]), SamplePool(GRID)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    for (true, place), tilt in zip(shots, tilts, strict=True):
        scan = replace(true, sigma=true.sigma / noise)
        turn = quat_from_rotation_vector(np.deg2rad(tilt) * axis)
        pose = Estimate(0.0, place, np.zeros(3), turn, np.zeros(3), 1.0, np.zeros((9, 9)))
        mapper.update(scan, pose)
        pool.add(scan.points(place, turn), scan.height_sigma(turn), scan.spacing(turn))
    found = mapper.hazard_map()
    if noise == 1 and found.in_domain.any():
        return {"yes": found, "no": found}
    # Scans that only have another noise are in place; the others are aligned.
    dem = pooled_dem(pool) if noise > 1 else mapper.dem()
    return {"yes": found, "no": DemSnapshot(dem, LANDERS["paper"], RockExpectation()).hazard_map}


def measure(case: Case) -> list[dict[str, Any]]:
    """Return the numbers of cells claimed safe and unsafe for each fault in one world."""
    pair = scenes(case.number, case.seed)
    terrain, lander = pair[0].terrain(), LANDERS["paper"]
    azimuth = np.random.default_rng([case.seed, case.number]).uniform(0.0, 2.0 * np.pi)
    rows = []
    for noise, *tilts in FAULTS[:1] if case["nominal"] else FAULTS:
        shots = [replace(scene, noise=float(noise)).simulate_scan(terrain) for scene in pair]
        for checked, found in maps_of(shots, noise, tilts, azimuth).items():
            row = {
                "noise": noise, "first_deg": tilts[0], "second_deg": tilts[1], "checked": checked,
                "in_domain": bool(found.in_domain.any()),
            }  # fmt: skip
            if not case["nominal"]:
                safe, known = site_safety(terrain, found.grid, lander)
                yes = known & found.in_domain & (found.p_safe > 0.95)
                no = known & found.in_domain & (found.p_safe < 0.05)
                row |= {
                    "known": int(known.sum()), "safe": int((known & safe).sum()),
                    "claimed": int(yes.sum()), "claimed_safe": int((yes & safe).sum()),
                    "refused": int(no.sum()), "refused_unsafe": int((no & ~safe).sum()),
                }  # fmt: skip
            rows.append(row)
    return rows


def print_claims(report: Report) -> None:
    """Print domain, claims and precision for each fault, summed over all worlds."""
    table = Table(title=f"Cells claimed safe, {len(report.groups('number'))} worlds of two scans")
    for heading in (
        "noise over\nstated", "tilt of first\nscan (deg)", "tilt of second\nscan (deg)",
        "scans\nchecked", "maps in\ndomain", "claimed\n(fraction)", "precision",
        "precision,\nworst world", "recall", "precision,\nclaimed unsafe",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    groups = report.groups("noise", "first_deg", "second_deg", "checked")
    for (*fault, checked), rows in groups.items():
        known, safe, claimed, right, refused, refused_unsafe = (
            report.column(name, rows)
            for name in ("known", "safe", "claimed", "claimed_safe", "refused", "refused_unsafe")
        )
        many = claimed >= 50
        worst = float((right[many] / claimed[many]).min()) if many.any() else np.nan
        inside = sum(row["in_domain"] for row in rows)
        with np.errstate(invalid="ignore"):
            values = (
                claimed.sum() / known.sum(), right.sum() / claimed.sum(), worst,
                right.sum() / safe.sum(), refused_unsafe.sum() / refused.sum(),
            )  # fmt: skip
        formats = (".3f", ".4f", ".3f", ".3f", ".4f")
        texts = ("-" if np.isnan(v) else format(v, f) for v, f in zip(values, formats, strict=True))
        table.add_row(*(f"{v:g}" for v in fault), checked, f"{inside} of {len(rows)}", *texts)
    report.print(table)


study = Study(
    measure,
    repeats="worlds",
    count=24,
    seed=31,
    report=print_claims,
    options=(click.Option(["--nominal"], is_flag=True, help="Map without errors or truth."),),
)

if __name__ == "__main__":
    run_script(study)
