"""Measure how the exact safety of sites depends on the distance between terrain samples.

Scenes of the calibration matrix (`worlds.py`) with their landers; random sites. The reference is
the terrain sampled 0.025 m apart. A site that is unsafe there exceeds a limit slightly if it is
safe with limits that allow 0.05 m more: roughness by this height, slope by this height over the
diameter of the pads' circle.

python scenarios/lidar_maps/posting.py --scenes 84
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from rich.table import Table
from worlds import LANDERS, sample_matrix

from lunarsim import site_safety
from lunarsim.studies import Case, Report, Study, run_script

POSTINGS = (0.2, 0.1, 0.05)
REFERENCE = 0.025
SITES = 300
SLIGHT = 0.05  # m


def measure(case: Case) -> list[dict[str, Any]]:
    """Count the sites of one scene that are safe at each posting and in the reference."""
    scene = list(sample_matrix(case.number + 1, case.seed))[-1]
    terrain, grid, lander = scene.terrain(), scene.grid(), LANDERS[scene.lander]
    where = np.zeros(grid.shape, bool)
    where.ravel()[scene.rng(5).choice(where.size, SITES, replace=False)] = True
    more = lander.slope_limit + np.arctan(0.5 * SLIGHT / lander.leg_radius)
    tolerant = replace(lander, slope_limit=more, roughness_limit=lander.roughness_limit + SLIGHT)
    true, known = site_safety(terrain, grid, lander, where=where, posting=REFERENCE)
    gross = known & ~site_safety(terrain, grid, tolerant, where=where, posting=REFERENCE)[0]
    rows = []
    for posting in POSTINGS:
        safe = site_safety(terrain, grid, lander, where=where, posting=posting)[0]
        rows.append({
            "posting": posting, "relief": scene.relief, "rocks": scene.rocks,
            "sites": int(known.sum()), "reference": int(true.sum()), "safe": int(safe.sum()),
            "wrong": int((safe & ~true).sum()), "gross": int((safe & gross).sum()),
            "missed": int((true & ~safe).sum()),
        })  # fmt: skip
    return rows


def print_postings(report: Report) -> None:
    """Print the fractions of safe sites, and of wrongly safe sites, for each posting."""
    table = Table(title=f"Safety of sites by posting of the terrain; reference {REFERENCE:g} m")
    for heading in (
        "Posting (m)", "Safe", "Safe in the reference", "Wrongly safe, of safe",
        "by more than 0.05 m, of safe", "Wrongly unsafe, of safe",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for (posting,), rows in report.groups("posting").items():
        names = ("sites", "safe", "reference", "wrong", "gross", "missed")
        sites, safe, true, wrong, gross, missed = (sum(row[n] for row in rows) for n in names)
        table.add_row(
            f"{posting:g}", f"{safe / sites:.4f}", f"{true / sites:.4f}", f"{wrong / safe:.4f}",
            f"{gross / safe:.4f}", f"{missed / true:.4f}",
        )  # fmt: skip
    report.print(table)


study = Study(measure, repeats="scenes", count=84, report=print_postings)

if __name__ == "__main__":
    run_script(study)
