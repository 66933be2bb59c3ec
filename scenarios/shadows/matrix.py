"""Evaluate the shadow map over rock cover, shape, Sun and terrain.

Every cell (test case) is flown over a few rock fields on the modified path. The map at 50 m is
evaluated per map cell, and by whether a hazard lies under a vehicle that lands at the safest site
of the map. The flights themselves land at the end of the path, which arrives with an acceleration,
5 to 20 m from any given site.

python scenarios/shadows/matrix.py --jobs 2 --out out/matrix
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import click
import numpy as np
from cells import CELLS, ShadowCell
from nominal_vs_modified import METHODS
from numpy.typing import NDArray
from rich.table import Table

from lunarsim import Simulation, flight_seed
from lunarsim.evaluation.classification import RELIABILITY_EDGES, Classification, classify
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.simulation.loop import make_policy
from lunarsim.studies import Case, Report, Study, run_script

ALTITUDE = 50.0
CLEAR_BELOW = 0.0025
# Goals of every cell: false clear area, completely missed hazards; recall within
# `ShadowCell.within_goal`.
MAX_FALSE_CLEAR, MAX_MISSED_HAZARDS, MIN_RECALL = 0.0025, 0.02, 0.6


CELL_OF = {cell.name: cell for cell in CELLS}


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight; return map quality at 50 m and touchdown hazard."""
    scenario = CELL_OF[case["cell"]].scenario(case["path"])
    scenario = scenario.changed(mappers={"rocks": METHODS[case["method"]]})
    simulation = Simulation(scenario, flight_seed(case.seed, case.number))
    while not simulation.done and simulation.altitude > ALTITUDE:
        simulation.step()
    found = {**evaluate_map(simulation), **evaluate_safest_site(simulation)}
    simulation.computer.stop_sensors()
    while not simulation.done:
        simulation.step()
    touchdown = simulation.outcome.touchdown
    on_hazard = touchdown is not None and bool(
        has_hazard_in_footprint(simulation, touchdown.position[None, :2]).any()
    )
    return {**found, "landed": touchdown is not None, "on_hazard": on_hazard}


def evaluate_safest_site(simulation: Simulation) -> dict[str, Any]:
    """Return whether the site that the policy `safest` selects is on a hazard.

    The decision is not executed. If the policy does not divert, the current site is its choice,
    unless the map shows no reachable site.
    """
    shown = simulation.observe()
    decision = simulation.ask(make_policy(simulation.scenario, "safest"), shown)
    site = simulation.site if decision.site is None else decision.site
    place = (np.asarray(site) - simulation.navigation_error)[None, :2]
    return {
        "chosen": bool(shown.candidates.reachable.any()),
        "diverts": decision.site is not None,
        "site_on_hazard": bool(has_hazard_in_footprint(simulation, place).any()),
    }


def is_hazard(simulation: Simulation) -> NDArray[np.bool_]:
    """Return whether each true rock is a hazard (n,): minimum hazard diameter or more."""
    least = simulation.scenario.mappers["rocks"].min_hazard_diameter_m
    return np.asarray(2.0 * simulation.world.terrain.rocks.a >= least)


def has_hazard_in_footprint(simulation: Simulation, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether a hazard lies under the lander at true positions `xy` (n, 2), m.

    Each hazard counts as its circumscribed disc.
    """
    rocks = simulation.world.terrain.rocks
    large = is_hazard(simulation)
    centre = np.column_stack((rocks.x, rocks.y))[large]
    reach = rocks.reach()[large] + simulation.computer.mappers["rocks"].footprint
    out = np.zeros(len(xy), bool)
    for c, r in zip(centre, reach, strict=True):
        out |= np.hypot(xy[:, 0] - c[0], xy[:, 1] - c[1]) < r
    return out


def evaluate_map(simulation: Simulation) -> dict[str, Any]:
    """Compare the current shadow map with the true rocks, in the onboard frame.

    A map cell is classified as clear if it is observed and its hazard probability is below the
    threshold. Hazards are rocks of the minimum hazard diameter or more. Returns, for JSON, counts
    of cells by class and of the calibration, numbers of hazards and of those classified as clear in
    all cells, and landings at blind sites.
    """
    mapper = simulation.computer.mappers["rocks"]
    p = mapper.probability.probability(mapper.tracker)
    seen = mapper.probability.observed
    rock = simulation.world.terrain.rock_raster(mapper.grid.moved(-simulation.navigation_error))
    large = is_hazard(simulation)
    occupied = (rock >= 0) & large[np.maximum(rock, 0)]
    clear = (p < CLEAR_BELOW) & seen
    # Per hazard: its cells on the map, and those of them classified as clear.
    number = np.where(occupied, rock, -1).ravel() + 1
    cells = np.bincount(number, minlength=len(large) + 1)[1:]
    wrong = np.bincount(number, weights=clear.ravel(), minlength=len(large) + 1)[1:]
    middles = mapper.grid.centres().reshape(-1, 2)[::37]
    return {
        "classes": classify(p, occupied, observed=seen).counts(),
        "reliability": reliability(p, occupied, RELIABILITY_EDGES).tolist(),
        "objects": int((cells > 0).sum()),
        "objects_clear": int(((cells > 0) & (wrong == cells)).sum()),
        "observed": float(seen.mean()),
        "rocks": mapper.tracker.filter.count,
        "blind_landing": float(
            has_hazard_in_footprint(simulation, middles - simulation.navigation_error[:2]).mean()
        ),
        "lost": bool(simulation.estimate.lost),
    }


def pooled_metrics(flights: list[dict[str, Any]]) -> dict[str, float]:
    """Return the map quality metrics of one test case, pooled over its flights."""
    of = reduce(Classification.__add__, (Classification(**f["classes"]) for f in flights))
    table = np.sum([f["reliability"] for f in flights], axis=0)
    objects = sum(f["objects"] for f in flights)
    landed = sum(f["landed"] for f in flights)
    chosen = [f for f in flights if f["chosen"]]
    return {
        **of.rates,
        "objects": float(objects),
        "objects_clear": sum(f["objects_clear"] for f in flights) / max(objects, 1),
        "blind": of.occupied / of.cells,
        "reliability_error": calibration_error(table),
        "blind_landing": float(np.mean([f["blind_landing"] for f in flights])),
        "landed": float(landed),
        "chosen": float(len(chosen)),
        "site_on_hazard": float(sum(f["site_on_hazard"] for f in chosen)),
        "on_hazard": float(sum(f["on_hazard"] for f in flights)),
        "lost": float(sum(f["lost"] for f in flights)),
    }


def missed_requirements(cell: ShadowCell, metrics: dict[str, float]) -> str:
    """Return the names of the requirements that a test case misses; empty if none.

    `metrics` is the value of `pooled_metrics`.
    """
    misses = []
    if metrics["clear_false"] > MAX_FALSE_CLEAR:
        misses.append("area")
    if metrics["objects_clear"] > MAX_MISSED_HAZARDS:
        misses.append("objects")
    if cell.recall_goal_applies() and not metrics["clear_recall"] >= MIN_RECALL:
        misses.append("recall")
    return ", ".join(misses)


def print_cells(report: Report) -> None:
    """Print the map quality of each test case, and totals over all cases."""
    path, method = report.options["path"], report.options["method"]
    table = Table(
        title=f"Shadow maps at {ALTITUDE:.0f} m: {path} path, {method} method, seed {report.seed}"
    )
    for heading in (
        "cell", "recall", "false clear area", "no-map rate", "hazards", "missed hazards",
        "occupied correct", "unknown", "calibration error", "hazard at safest", "goals missed",
    ):  # fmt: skip
        table.add_column(
            heading, justify="left" if heading in {"cell", "goals missed"} else "right"
        )
    missing = 0
    for (cell,), flights in report.groups("cell").items():
        f = pooled_metrics(flights)
        lacks = missed_requirements(CELL_OF[cell], f)
        missing += bool(lacks)
        table.add_row(
            cell, f"{f['clear_recall']:.3f}", f"{f['clear_false']:.5f}", f"{f['blind']:.4f}",
            f"{f['objects']:.0f}", f"{f['objects_clear']:.3f}", f"{f['occupied_correct']:.2f}",
            f"{f['unknown']:.3f}", f"{f['reliability_error']:.4f}",
            f"{f['site_on_hazard']:.0f}/{f['chosen']:.0f}", lacks,
        )  # fmt: skip
    report.print(table)
    report.print(
        "False clear area: fraction of the area classified as clear that is under a hazard; no-map "
        "rate: the same if all cells are classified as clear; missed hazards: fraction of hazards "
        "completely classified as clear; calibration error: mean difference between predicted and "
        "observed probability."
    )
    total = pooled_metrics(report.rows)
    report.print(
        f"{total['site_on_hazard']:.0f} of {total['chosen']:.0f} safest reachable sites of the maps"
        f" have a hazard under the lander; random sites have one in "
        f"{100.0 * total['blind_landing']:.1f} %. At the end of the path, {total['on_hazard']:.0f} "
        f"of {total['landed']:.0f} touchdowns have one."
    )
    report.print(f"{missing} of {len(report.groups('cell'))} cells miss a goal.")


study = Study(
    fly,
    repeats="fields",
    count=4,
    factors={"cell": list(CELL_OF)},
    factor_help={"cell": "Name of a test case to fly."},
    options=(
        click.Option(
            ["--path"], type=click.Choice(("nominal", "modified")), default="modified",
            show_default=True, help="Descent path of the shadow EKF paper: nominal or modified.",
        ),
        click.Option(
            ["--method"], type=click.Choice(tuple(METHODS)), default="inferred", show_default=True,
            help="Rock shapes of the mapper; inferred: from the shadows; expected: those "
            "that the mission expects; paper: hemispheres.",
        ),
    ),
    report=print_cells,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
