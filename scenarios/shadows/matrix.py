"""Evaluate the shadow map over rock cover, shape, Sun and terrain.

Every cell (test case) is flown over a few rock fields on the modified path. The map at 50 m is
evaluated per map cell, and by whether a hazard lies under a vehicle that lands at the safest site
of the map. The flights themselves land at the end of the path, which arrives with an acceleration,
5 to 20 m from any given site. Flights are saved one by one, so an interrupted study resumes from
the file.

python scenarios/shadows/matrix.py --jobs 2 --json out/matrix.json
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from functools import reduce
from pathlib import Path
from typing import Any

import click
import numpy as np
from cells import CELLS, ShadowCell
from nominal_vs_modified import METHODS
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from lunarsim import InputError, Simulation, flight_seed
from lunarsim.campaign.flight_store import FlightStore
from lunarsim.campaign.pool import iterate_results
from lunarsim.console import plain_console, plain_progress
from lunarsim.evaluation.classification import RELIABILITY_EDGES, Classification, classify
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.simulation.loop import make_policy

ALTITUDE = 50.0
CLEAR_BELOW = 0.0025
# Goals of every cell: false clear area, completely missed hazards; recall within
# `ShadowCell.within_goal`.
MAX_FALSE_CLEAR, MAX_MISSED_HAZARDS, MIN_RECALL = 0.0025, 0.02, 0.6


@dataclass(frozen=True)
class ShadowMatrixTask:
    """Settings of one simulated flight of the shadow map study.

    `cell` is the test case, `field` the number of the rock field and `seed` the root seed; `path`
    is "nominal" or "modified", `method` a name in `METHODS`.
    """

    cell: ShadowCell
    field: int
    seed: int
    path: str = "modified"
    method: str = "inferred"

    @property
    def key(self) -> str:
        """Key of the flight in the result file."""
        return f"{self.cell.name} / {self.field}"


def fly(task: ShadowMatrixTask) -> dict[str, Any]:
    """Simulate one flight; return map quality at 50 m and touchdown hazard for JSON."""
    scenario = task.cell.scenario(task.path).changed(mappers={"rocks": METHODS[task.method]})
    simulation = Simulation(scenario, flight_seed(task.seed, task.field))
    while not simulation.done and simulation.altitude > ALTITUDE:
        simulation.step()
    out = {
        "cell": asdict(task.cell),
        **evaluate_map(simulation),
        **evaluate_safest_site(simulation),
    }
    simulation.computer.stop_sensors()
    while not simulation.done:
        simulation.step()
    outcome = simulation.outcome
    out["landed"] = outcome is not None and outcome.touchdown is not None
    out["on_hazard"] = False
    if outcome is not None and outcome.touchdown is not None:
        out["on_hazard"] = bool(
            has_hazard_in_footprint(simulation, outcome.touchdown.position[None, :2]).any()
        )
    return out


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
    threshold. Returns, for JSON, counts of the cells by class and of the calibration.
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


# --- the file --------------------------------------------------------------------------------


def has_flight(results: FlightStore, task: ShadowMatrixTask) -> bool:
    """Return whether the results contain this flight with the same test case."""
    done = results.flights.get(task.key)
    return done is not None and done.get("cell") == asdict(task.cell)


# --- the table -------------------------------------------------------------------------------


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


def show(tasks: list[ShadowMatrixTask], results: FlightStore, console: Console) -> None:
    """Print the map quality of each test case, and totals over all cases."""
    first = tasks[0]
    table = Table(
        title=f"Shadow maps at {ALTITUDE:.0f} m: {first.path} path, {first.method} method, seed"
        f" {first.seed}"
    )
    headings = ("cell", "recall", "false clear area", "no-map rate", "hazards", "missed hazards",
    "occupied correct",
                "unknown", "calibration error", "hazard at safest", "goals missed")  # fmt: skip
    for heading in headings:
        table.add_column(
            heading, justify="left" if heading in {"cell", "goals missed"} else "right"
        )
    total = dict.fromkeys(("landed", "on_hazard", "chosen", "site_on_hazard"), 0.0)
    missing = shown = 0
    blind = []
    for cell in dict.fromkeys(t.cell for t in tasks):
        mine = [t for t in tasks if t.cell == cell]
        flights = [results.flights[t.key] for t in mine if has_flight(results, t)]
        if not flights:
            continue
        f = pooled_metrics(flights)
        lacks = missed_requirements(cell, f)
        shown, missing = shown + 1, missing + bool(lacks)
        total = {key: value + f[key] for key, value in total.items()}
        blind += [f["blind_landing"]] * len(flights)
        table.add_row(
            cell.name, f"{f['clear_recall']:.3f}", f"{f['clear_false']:.5f}", f"{f['blind']:.4f}",
            f"{f['objects']:.0f}", f"{f['objects_clear']:.3f}", f"{f['occupied_correct']:.2f}",
            f"{f['unknown']:.3f}", f"{f['reliability_error']:.4f}",
            f"{f['site_on_hazard']:.0f}/{f['chosen']:.0f}", lacks,
        )  # fmt: skip
    console.print(table)
    console.print(
        "False clear area: fraction of the area classified as clear that is under a hazard; no-map "
        "rate: the same if"
        " all cells are classified as clear; missed hazards: fraction of hazards completely "
        "classified as clear; calibration error: mean"
        " difference between predicted and observed probability."
    )
    if blind:
        console.print(
            f"{total['site_on_hazard']:.0f} of {total['chosen']:.0f} safest reachable sites of"
            " the maps have a hazard under the lander"
            f"; random sites have one in {100.0 * float(np.mean(blind)):.1f} %. At the end of"
            f" the path, {total['on_hazard']:.0f} of {total['landed']:.0f} touchdowns have one."
        )
    console.print(f"{missing} of {shown} cells miss a goal.")


@click.command()
@click.option("--cells", "cell_patterns", default="*", show_default=True,
              help="Names of the test cases to fly, separated by commas; * and ? match any text "
              "and any character.")  # fmt: skip
@click.option("--fields", type=click.IntRange(min=1), default=4, show_default=True,
              help="Number of rock fields for each test case.")  # fmt: skip
@click.option(
    "--seed",
    type=int,
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--path", type=click.Choice(("nominal", "modified")), default="modified",
              show_default=True,
              help="Descent path of the shadow EKF paper: nominal or modified.")  # fmt: skip
@click.option("--method", type=click.Choice(tuple(METHODS)), default="inferred", show_default=True,
              help="Rock shapes of the mapper; inferred: from the shadows; expected: those "
              "that the mission expects; paper: hemispheres.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for the flights; if it exists, its flights are not repeated. "
              "Default: none.")  # fmt: skip
def main(
    cell_patterns: str,
    fields: int,
    seed: int,
    path: str,
    method: str,
    jobs: int,
    json_file: Path | None,
) -> None:
    """Fly the test cases and print the quality of their shadow maps."""
    console = plain_console(150)
    wanted = [p.strip() for p in cell_patterns.split(",")]
    cells = [c for c in CELLS if any(fnmatch(c.name, p) for p in wanted)]
    if not cells:
        raise click.BadParameter(
            f"must match one of {', '.join(c.name for c in CELLS)}, got {cell_patterns!r}",
            param_hint="--cells",
        )
    try:
        results = FlightStore(
            json_file, {"seed": seed, "path": path, "method": method, "of": "map and site"}
        )
    except InputError as error:
        raise click.BadParameter(str(error), param_hint="--json") from None
    if results.outdated_count:
        console.print(
            f"{results.outdated_count} flights of {json_file} were computed with different code"
        )
    # Field by field: after an interruption every cell has some flights.
    everything = [
        ShadowMatrixTask(cell, k, seed, path, method) for k in range(fields) for cell in cells
    ]
    tasks = [t for t in everything if not has_flight(results, t)]
    with plain_progress(console) as progress:
        bar = progress.add_task("flights", total=len(tasks))
        try:
            for index, result in iterate_results(fly, tasks, jobs):
                results.keep(tasks[index].key, result)
                progress.advance(bar)
        except KeyboardInterrupt:
            console.print("Interrupted. The finished flights are saved.")
    show(everything, results, console)


if __name__ == "__main__":
    main()
