"""Compare the nominal and the modified descent of the shadow EKF paper.

In the experiment (IV.B and V), a vehicle detects rocks by their shadows while it flies to a site
with the Sun behind its camera. The modified path overflies the site by 60 m and sees the shadows
that the rocks hide from the nominal path.

python scenarios/shadows/nominal_vs_modified.py --fields 20 --jobs 2 --out out/shadows
"""

from __future__ import annotations

import json
import operator
from dataclasses import asdict, dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.classification import RELIABILITY_EDGES, classify
from lunarsim.evaluation.reliability import reliability
from lunarsim.evaluation.statistics import MeanInterval, mean_interval

SCENARIOS = Path(__file__).parents[1]
PATHS = ("nominal", "modified")
SHAPES = ("hemisphere", "ellipsoid", "cube", "irregular", "mixed")
# Settings of the shadow mapper.
METHODS: dict[str, dict[str, str]] = {
    "own": {},
    "told": {"shapes": "expected"},
    "paper": {"shapes": "hemisphere", "cover_model": "gaussian"},
}
ALTITUDES = (300.0, 200.0, 100.0, 50.0)
# Tables 1 and 2 and section V of the paper; rates at 50 m.
PAPER = {
    "clear_recall": (0.11, 0.29),
    "occupied_called_clear": (0.0, 0.0),
    "clear_false": (0.0, 0.0),
    "occupied_correct": (0.85, 0.85),
}
LABELS = {
    "clear_recall": "clear area classified as clear",
    "occupied_called_clear": "hazard area classified as clear",
    "clear_false": "hazard fraction of the area classified as clear",
    "occupied_correct": "hazard fraction of the area classified as occupied",
    "unknown": "unclassified area",
}


@dataclass(frozen=True)
class ShadowPathTask:
    """Settings of one simulated flight of the nominal or the modified descent.

    `path` is "nominal" or "modified" (which overflies the site), `field` the number of the rock
    field, `seed` the root seed; `shapes` is the expected rock shape (None: that of the scenario),
    `method` a name in `METHODS`.
    """

    path: str
    field: int
    seed: int
    shapes: str | None
    method: str = "own"


def fly(task: ShadowPathTask) -> dict[str, Any]:
    """Simulate one flight; return map quality by altitude, propellant and duration."""
    scenario = Scenario.load(SCENARIOS / f"shadow_{task.path}.toml")
    if task.shapes is not None:
        scenario = scenario.changed(expected_rocks={"shape": task.shapes})
    scenario = scenario.changed(mappers={"rocks": METHODS[task.method]})
    simulation = Simulation(scenario, flight_seed(task.seed, task.field))
    pending = list(ALTITUDES)
    levels: dict[float, dict[str, Any]] = {}
    track = []
    while not simulation.done:
        simulation.step()
        track.append(simulation.state.position - simulation.computer.briefing.target)
        if pending and simulation.altitude <= pending[0]:
            levels[pending.pop(0)] = evaluate_map(simulation)
            if not pending:
                # The maps are complete: the rest of the flight only gives propellant and duration.
                simulation.computer.stop_sensors()
    return {
        "path": task.path,
        "field": task.field,
        "levels": levels,
        "propellant": simulation.lander.wet_mass - simulation.state.mass,
        "duration": simulation.time,
        "landed": simulation.outcome is not None and simulation.outcome.touchdown is not None,
        "track": np.array(track)[::5],
    }


def evaluate_map(simulation: Simulation) -> dict[str, Any]:
    """Compare the current shadow map with the true rocks, in the onboard frame.

    Returns counts of the cells by class, calibration counts, the map and the true hazard cells.
    """
    mapper = simulation.computer.mappers["rocks"]
    probability = mapper.probability.probability(mapper.tracker)
    terrain = simulation.world.terrain
    rock = terrain.rock_raster(mapper.grid.moved(-simulation.navigation_error))
    hazard = simulation.scenario.mappers["rocks"].min_hazard_diameter_m
    large = 2.0 * terrain.rocks.a >= hazard
    occupied = (rock >= 0) & large[np.maximum(rock, 0)]
    return {
        "classes": classify(probability, occupied, observed=mapper.probability.observed),
        "reliability": reliability(probability, occupied, RELIABILITY_EDGES),
        "rocks": mapper.tracker.filter.count,
        "map": probability,
        "occupied": occupied,
        "extent": mapper.grid.extent,
    }


def compare_means(nominal: list[float], modified: list[float]) -> dict[str, MeanInterval]:
    """Return means with intervals of a metric: nominal, modified, and difference."""
    return {
        "nominal": mean_interval(nominal),
        "modified": mean_interval(modified),
        "difference": mean_interval(np.subtract(modified, nominal)),
    }


def summarise(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return mean map metrics by altitude for both paths, and paired differences.

    `results` are the values of `fly`.
    """
    by = [[r for r in results if r["path"] == p] for p in PATHS]
    out: dict[str, Any] = {"altitudes": {}, "fields": len(by[0])}
    for altitude in ALTITUDES:
        classes = [[r["levels"][altitude]["classes"] for r in of] for of in by]
        level: dict[str, Any] = {
            rate: compare_means(*([c.rates[rate] for c in of] for of in classes)) for rate in LABELS
        }
        # All fields pooled, because false clear cells are rare.
        for path, of in zip(PATHS, classes, strict=True):
            pooled = reduce(operator.add, of)
            level[f"pooled_clear_false_{path}"] = pooled.rates["clear_false"]
        out["altitudes"][altitude] = level
    for name in ("propellant", "duration"):
        out[name] = compare_means(*([r[name] for r in of] for of in by))
    return out


def show(summary: dict[str, Any], console: Console) -> None:
    """Print map quality by altitude, propellant and duration of both paths.

    `summary` is the value of `summarise`.
    """
    for altitude, level in summary["altitudes"].items():
        table = Table(
            title=f"Map at {altitude:.0f} m, {summary['fields']} fields (mean, 95 % interval)"
        )
        for heading in ("", "nominal", "modified", "modified minus nominal", "paper, at 50 m"):
            table.add_column(heading, justify="left" if not heading else "right")
        for rate, label in LABELS.items():
            paper = ""
            if altitude == 50.0:
                figures = PAPER.get(rate)
                paper = "{} / {}".format(*figures) if figures else "modified: 0.09 lower"
            table.add_row(label, *(v.text() for v in level[rate].values()), paper)
        console.print(table)
        console.print(
            "  All fields pooled, hazard fraction of the area classified as clear: "
            f"nominal {level['pooled_clear_false_nominal']:.5f}, "
            f"modified {level['pooled_clear_false_modified']:.5f} (threshold 0.00250)"
        )
    for name, unit, paper in (("propellant", "kg", "about 1"), ("duration", "s", "2")):
        nominal, modified, difference = (v.text(2) for v in summary[name].values())
        console.print(
            f"{name}: nominal {nominal} {unit}, modified {modified} {unit}, difference "
            f"{difference} {unit} (paper: {paper} {unit})"
        )


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=2, show_default=True,
              help="Number of rock fields; each is flown on the nominal and on the modified "
              "path.")  # fmt: skip
@click.option(
    "--seed",
    type=int,
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option("--shapes", type=click.Choice(SHAPES), default=None,
              help="Rock shape that the mission expects (default: shape in the "
              "scenario).")  # fmt: skip
@click.option("--method", type=click.Choice(tuple(METHODS)), default="own", show_default=True,
              help="Rock shapes of the mapper; own: inferred from shadows; paper: hemispheres; "
              "otherwise those that the mission expects.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for all results. Default: none.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figures. Default: no figures.")  # fmt: skip
def main(
    fields: int,
    seed: int,
    jobs: int,
    shapes: str | None,
    method: str,
    json_file: Path | None,
    out: Path | None,
) -> None:
    """Fly nominal and modified descents over rock fields; compare their maps."""
    console = plain_console(140)
    tasks = [
        ShadowPathTask(path, field, seed, shapes, method)
        for field in range(fields)
        for path in PATHS
    ]
    results = collect_results(fly, tasks, jobs, console, "flights")
    # A field counts only if both paths have flown it.
    results = results[: len(results) // len(PATHS) * len(PATHS)]
    if not results:
        raise click.Abort
    summary = summarise(results)
    show(summary, console)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(
            json.dumps(to_json(summary, results), indent=1, default=asdict), encoding="utf-8"
        )
    if out is not None:
        from figures import draw_all

        draw_all(results, out)


def to_json(summary: dict[str, Any], results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the summary and all flights except their maps for JSON."""
    flights = [
        {
            **{k: r[k] for k in ("path", "field", "propellant", "duration", "landed")},
            "levels": {
                str(a): {
                    "rates": level["classes"].rates,
                    "counts": level["classes"].counts(),
                    "rocks": level["rocks"],
                    "reliability": level["reliability"].tolist(),
                }
                for a, level in r["levels"].items()
            },
        }
        for r in results
    ]
    return {"summary": json.loads(json.dumps(summary, default=asdict)), "flights": flights}


if __name__ == "__main__":
    main()
