"""Measure how often the best site of a map is safe, and bound the risk over worlds.

Scenes of the calibration matrix (`worlds.py`), other than those of the fit. In each, a map of the
Gaussian DEM of one scan; its site with the highest p_safe is chosen. The threshold of p_safe that
bounds the risk of chosen sites is found on all scenes except those with one relief, rock law,
lander or range, and tested on these.

python scenarios/lidar_maps/chosen_sites.py --scenes 480
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from calibration import AXES
from rich.table import Table
from worlds import LANDERS, UPRIGHT, sample_matrix

from lunarsim import site_safety
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import DemSnapshot
from lunarsim.rocks.population import RockExpectation
from lunarsim.studies import Case, Report, Study, risk_threshold, run_script

SEED = 105  # the calibration was fitted to scenes of seed 5
MAX_RISK, CONFIDENCE = 0.05, 0.95
SITES = 400  # random sites per scene, for comparison with the chosen one
BINS = (0.0, 0.5, 0.8, 0.95, 0.98, np.nextafter(1.0, 2.0))


def measure(case: Case) -> dict[str, Any]:
    """Choose the best site of the map of one scene; report its p_safe and true safety."""
    scene = list(sample_matrix(case.number + 1, case.seed))[-1]
    terrain, lander = scene.terrain(), LANDERS[scene.lander]
    pool = SamplePool(scene.grid())
    scan, position = scene.simulate_scan(terrain)
    pool.add(scan.points(position, UPRIGHT), scan.height_sigma(UPRIGHT), scan.spacing(UPRIGHT))
    found = DemSnapshot(pooled_dem(pool), lander, RockExpectation()).hazard_map
    p = np.where(found.observed, found.p_safe, -1.0).ravel()
    some = np.flatnonzero(p >= 0.0)
    row: dict[str, Any] = {f"held_out_{axis}": of(scene) for axis, _, of in AXES}
    if not some.size:
        return row | {"p": None, "safe": None, "others": []}
    some = scene.rng(6).choice(some, min(SITES, some.size), replace=False)
    best = int(np.argmax(p))
    where = np.zeros(p.size, np.bool_)
    where[some] = where[best] = True
    safe = site_safety(terrain, found.grid, lander, where=where.reshape(found.grid.shape))[0]
    row |= {"p": float(p[best]), "safe": bool(safe.ravel()[best])}
    return row | {"others": np.column_stack((p[some], safe.ravel()[some])).round(5).tolist()}


def print_chosen(report: Report) -> None:
    """Print the reliability of chosen and of all sites, and thresholds with their risk."""
    rows = report.rows
    p = np.array([np.nan if r["p"] is None else r["p"] for r in rows])
    failed = np.array([r["safe"] is False for r in rows])
    others = np.array([pair for r in rows for pair in r["others"]])
    table = Table(title="Best site of each map, and random sites, by p_safe")
    for heading in (
        "p_safe", "Chosen sites", "Mean p_safe", "Safe", "Random sites", "Mean p_safe", "Safe",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for low, high in pairwise(BINS):
        mine = (p >= low) & (p < high)
        theirs = others[(others[:, 0] >= low) & (others[:, 0] < high)]
        table.add_row(
            f"{low:g} to {high:g}", str(mine.sum()), _mean(p[mine]), _mean(~failed[mine]),
            str(len(theirs)), _mean(theirs[:, 0]), _mean(theirs[:, 1]),
        )  # fmt: skip
    report.print(table)
    table = Table(
        title=f"Thresholds with a risk of at most {MAX_RISK:g}, confidence {CONFIDENCE:g}"
    )
    for heading in (
        "Held out", "Scenes", "Threshold", "Used", "Failed", "Held-out scenes", "Used", "Failed",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for name, inside in _rows_held_out(rows):
        found = risk_threshold(
            p[~inside], failed[~inside], max_risk=MAX_RISK, confidence=CONFIDENCE
        )
        used = inside & (p >= found.threshold)
        table.add_row(
            name, str(found.worlds), f"{found.threshold:.4f}", str(found.used), str(found.failed),
            str(inside.sum()), str(used.sum()), str((failed & used).sum()),
        )  # fmt: skip
    report.print(table)


def _rows_held_out(rows: list[dict[str, Any]]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each held-out kind of scene: its name, and the mask of its rows (n,)."""
    yield "none", np.zeros(len(rows), np.bool_)
    for axis, names, _ in AXES:
        for name in names:
            inside = np.array([r[f"held_out_{axis}"] == name for r in rows])
            if inside.any():
                yield f"{axis} {name}", inside


def _mean(values: np.ndarray) -> str:
    """Return the mean of values (n,) as text; "-" without values."""
    return f"{values.mean():.4f}" if values.size else "-"


study = Study(measure, repeats="scenes", count=480, seed=SEED, report=print_chosen)

if __name__ == "__main__":
    run_script(study)
