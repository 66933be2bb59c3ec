"""Test p_safe of the Gaussian DEM on worlds drawn at random.

Worlds are drawn from the space that `worst_case_maps.py` searches, with uniform positions in each
range. The LiDAR scans each once; the onboard inputs are correct. A site is claimed as safe if its
p_safe exceeds 0.95 (or 0.99) inside the domain. Neighbouring sites are not independent: intervals
come from resampled worlds and squares of 5 m.

python scenarios/random_worlds.py --worlds 40 --jobs 2
python scenarios/random_worlds.py --worlds 160 --seed 77 --file scenarios/hostile_worlds.json

The worlds in the file were chosen by a tester who knew the documentation, but not the code, and who
tried to find worlds with unsafe claims. Each is drawn eight times.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table
from worst_case_maps import ANGLE, RANGE, SPACE, map_world, scenario_of

from lunarsim import InputError, site_safety
from lunarsim.studies import Case, Report, Study, holm_correction, run_script

CLAIMS = (0.95, 0.99)
# Precision that no world may contradict, and the significance of the test.
REQUIRED_PRECISION, SIGNIFICANCE = 0.95, 0.01
BLOCK_CELLS = 25  # 5 m
RESAMPLES = 100_000
ROW_STRIDE = 2  # every second row of the map is evaluated
BINS = np.linspace(0.0, 1.0, 21)


def drawn_values(case: Case) -> dict[str, Any]:
    """Return the values of a world: drawn at random, or from the file of the command line.

    The worlds of the file are used again and again, each time with other terrain and noise.
    """
    if case["file"] is None:
        rng = np.random.default_rng([case.seed, case.number])
        return SPACE.values(rng.uniform(size=len(SPACE.ranges)))
    worlds = json.loads(Path(case["file"]).read_text())
    return SPACE.nominal() | worlds[case.number % len(worlds)]


def measure(case: Case) -> dict[str, Any]:
    """Map one world; return the counts of sites and claims, by squares and by p_safe."""
    values = drawn_values(case)
    scenario = scenario_of(values)
    try:
        terrain, drawn = map_world(scenario, values[RANGE], values[ANGLE], case.seed, case.number)
    except InputError as error:
        return {"rejected": str(error)}
    where = drawn.observed & (np.arange(drawn.grid.rows) % ROW_STRIDE == 0)[:, None]
    safe = site_safety(terrain, drawn.grid, scenario.vehicle.make(), where=where)[0]
    domain = where & drawn.in_domain
    row, col = np.nonzero(domain)
    block = row // BLOCK_CELLS * drawn.grid.cols + col // BLOCK_CELLS
    p, right = drawn.p_safe[domain].astype(np.float64), safe[domain]
    out: dict[str, Any] = {
        "range_m": values[RANGE], "sites": int(where.sum()), "safe": int(safe[where].sum()),
        "in_bin": np.histogram(p, BINS)[0].tolist(),
        "safe_in_bin": np.histogram(p[right], BINS)[0].tolist(),
        "sum_in_bin": np.histogram(p, BINS, weights=p)[0].tolist(),
    }  # fmt: skip
    for limit in CLAIMS:
        claimed = p > limit
        _, index = np.unique(block[claimed], return_inverse=True)
        out[f"claimed_{limit}"] = np.bincount(index).tolist()
        out[f"right_{limit}"] = np.bincount(index, weights=right[claimed]).astype(int).tolist()
    return out


def resampled_precision(
    claimed: np.ndarray, right: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the precision of resampled squares (`RESAMPLES`,).

    `claimed` and `right` (n,) are the numbers of claims in each square, and of safe ones.
    """
    weights = rng.multinomial(len(claimed), np.full(len(claimed), 1.0 / len(claimed)), RESAMPLES)
    return np.asarray(weights @ right / np.maximum(weights @ claimed, 1))


def pooled_bound(rows: list[dict[str, Any]], limit: float, rng: np.random.Generator) -> float:
    """Return the one-sided 95 % lower bound of the precision of all claims.

    Worlds are resampled, and squares within each.
    """
    found = np.empty(RESAMPLES // 50)
    blocks = [np.array([r[f"claimed_{limit}"], r[f"right_{limit}"]]) for r in rows]
    for n in range(len(found)):
        drawn = [blocks[k] for k in rng.integers(len(blocks), size=len(blocks))]
        total = sum(
            b[:, rng.integers(b.shape[1], size=b.shape[1])].sum(axis=1) for b in drawn if b.size
        )
        found[n] = total[1] / total[0]
    return float(np.quantile(found, 0.05))


def print_test(report: Report) -> None:
    """Print claims and precision of all worlds, and the worlds that contradict the claim."""
    rng = np.random.default_rng(0)
    rows = [r for r in report.rows if "rejected" not in r]
    table = Table(title=f"Claims on {len(rows)} worlds")
    for heading in ("p_safe above", "Worlds with claims", "Claimed, fraction of sites", "Recall",
                    "Precision", "95 % lower bound"):  # fmt: skip
        table.add_column(heading, justify="right")
    sites, safe = (sum(r[name] for r in rows) for name in ("sites", "safe"))
    for limit in CLAIMS:
        claimed, right = (sum(sum(r[f"{k}_{limit}"]) for r in rows) for k in ("claimed", "right"))
        some = [r for r in rows if r[f"claimed_{limit}"]]
        table.add_row(
            f"{limit:g}", f"{len(some)}", f"{claimed / sites:.3f}", f"{right / safe:.3f}",
            f"{right / claimed:.4f}", f"{pooled_bound(some, limit, rng):.4f}",
        )  # fmt: skip
    report.print(table)
    print_worlds(report, [r for r in rows if r["claimed_0.95"]], rng)
    count, right, total = (
        np.array([r[name] for r in rows]).sum(axis=0)
        for name in ("in_bin", "safe_in_bin", "sum_in_bin")
    )
    error = float(np.abs(total - right).sum() / count.sum())
    report.print(f"Expected calibration error in the domain: {error:.4f}.")


def print_worlds(report: Report, rows: list[dict[str, Any]], rng: np.random.Generator) -> None:
    """Print the worlds with the lowest precision, and test each against the required one."""
    precision = np.array([sum(r["right_0.95"]) / sum(r["claimed_0.95"]) for r in rows])
    below = []
    for r in rows:
        found = resampled_precision(np.array(r["claimed_0.95"]), np.array(r["right_0.95"]), rng)
        below.append(((found >= REQUIRED_PRECISION).sum() + 1) / (RESAMPLES + 1))
    corrected = holm_correction(below)
    table = Table(title="Worlds with the lowest precision of claims with p_safe above 0.95")
    for heading in ("World", "Range (m)", "Claims", "Precision",
                    f"p (precision {REQUIRED_PRECISION:g})", "p, Holm"):  # fmt: skip
        table.add_column(heading, justify="right")
    for k in np.argsort(precision, kind="stable")[:8]:
        r = rows[k]
        table.add_row(
            str(r["number"]), f"{r['range_m']:.0f}", str(sum(r["claimed_0.95"])),
            f"{precision[k]:.4f}", f"{below[k]:.2g}", f"{corrected[k]:.2g}",
        )  # fmt: skip
    report.print(table)
    report.print(
        f"Worlds that contradict a precision of {REQUIRED_PRECISION:g} at a significance of "
        f"{SIGNIFICANCE:g}: {int((corrected < SIGNIFICANCE).sum())} of {len(rows)}."
    )


study = Study(
    measure,
    repeats="worlds",
    count=40,
    seed=2026,
    report=print_test,
    options=(
        click.Option(
            ["--file"], type=click.Path(exists=True, dir_okay=False),
            help="JSON file with a list of worlds, each with values of the searched keys; omitted "
            "keys are nominal. Default: random worlds.",
        ),
    ),
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
