"""Compare the nominal and the modified descent of the shadow EKF paper.

In the experiment (IV.B and V), a vehicle detects rocks by their shadows while it flies to a site
with the Sun behind its camera. The modified path overflies the site by 60 m and sees the shadows
that the rocks hide from the nominal path.

python scenarios/shadows/nominal_vs_modified.py --fields 20 --jobs 2 --out out/shadows
"""

from __future__ import annotations

import operator
from functools import reduce
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.evaluation.classification import RELIABILITY_EDGES, Classification, classify
from lunarsim.evaluation.reliability import reliability
from lunarsim.evaluation.statistics import MeanInterval, mean_interval
from lunarsim.studies import Case, Report, Study, pack_array, run_script

SCENARIOS = Path(__file__).parents[1]
PATHS = ("nominal", "modified")
SHAPES = ("hemisphere", "ellipsoid", "cube", "irregular", "mixed")
# Settings of the shadow mapper.
METHODS: dict[str, dict[str, str]] = {
    "inferred": {},
    "expected": {"shapes": "expected"},
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


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight; return map quality by altitude, propellant and duration.

    The row of the first field also has the maps and the flown path, as packed arrays for figures.
    """
    scenario = Scenario.load(SCENARIOS / f"shadow_{case['path']}.toml")
    if case["shapes"] is not None:
        scenario = scenario.changed(expected_rocks={"shape": case["shapes"]})
    scenario = scenario.changed(mappers={"rocks": METHODS[case["method"]]})
    simulation = Simulation(scenario, flight_seed(case.seed, case.number))
    pending = list(ALTITUDES)
    levels: dict[str, dict[str, Any]] = {}
    track = []
    while not simulation.done:
        simulation.step()
        track.append(simulation.state.position - simulation.computer.briefing.target)
        if pending and simulation.altitude <= pending[0]:
            levels[str(pending.pop(0))] = evaluate_map(simulation, case.number == 0)
            if not pending:
                # The maps are complete: the rest of the flight only gives propellant and duration.
                simulation.computer.stop_sensors()
    row = {
        "levels": levels,
        "propellant": simulation.lander.wet_mass - simulation.state.mass,
        "duration": simulation.time,
        "landed": simulation.outcome is not None and simulation.outcome.touchdown is not None,
    }
    return row | ({"track": pack_array(np.array(track)[::5])} if case.number == 0 else {})


def evaluate_map(simulation: Simulation, with_map: bool) -> dict[str, Any]:
    """Compare the current shadow map with the true rocks, in the onboard frame.

    Returns rates and counts of the cells by class, and calibration counts; `with_map` adds the map
    and the true hazard cells.
    """
    mapper = simulation.computer.mappers["rocks"]
    probability = mapper.probability.probability(mapper.tracker)
    terrain = simulation.world.terrain
    rock = terrain.rock_raster(mapper.grid.moved(-simulation.navigation_error))
    hazard = simulation.scenario.mappers["rocks"].min_hazard_diameter_m
    large = 2.0 * terrain.rocks.a >= hazard
    occupied = (rock >= 0) & large[np.maximum(rock, 0)]
    classes = classify(probability, occupied, observed=mapper.probability.observed)
    level = {
        "rates": classes.rates,
        "counts": classes.counts(),
        "reliability": reliability(probability, occupied, RELIABILITY_EDGES),
        "rocks": mapper.tracker.filter.count,
    }
    arrays = {"map": probability, "occupied": occupied, "extent": np.array(mapper.grid.extent)}
    return level | ({k: pack_array(v) for k, v in arrays.items()} if with_map else {})


def compare_means(nominal: list[float], modified: list[float]) -> dict[str, MeanInterval]:
    """Return means with intervals of a metric: nominal, modified, and difference."""
    return {
        "nominal": mean_interval(nominal),
        "modified": mean_interval(modified),
        "difference": mean_interval(np.subtract(modified, nominal)),
    }


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return mean map metrics of nominal and modified descents, by altitude.

    The result also has the means of propellant and duration, and all paired differences. Fields
    that only one path has flown are ignored.
    """
    by = [[r for r in rows if r["path"] == path] for path in PATHS]
    fields = min(map(len, by))
    by = [flights[:fields] for flights in by]
    out: dict[str, Any] = {"altitudes": {}, "fields": fields}
    for altitude in by[0][0]["levels"] if fields else ():
        levels = [[r["levels"][altitude] for r in flights] for flights in by]
        level: dict[str, Any] = {
            rate: compare_means(*([one["rates"][rate] for one in of] for of in levels))
            for rate in LABELS
        }
        # All fields pooled, because false clear cells are rare.
        for path, of in zip(PATHS, levels, strict=True):
            pooled = reduce(operator.add, (Classification(**one["counts"]) for one in of))
            level[f"pooled_clear_false_{path}"] = pooled.rates["clear_false"]
        out["altitudes"][float(altitude)] = level
    for name in ("propellant", "duration"):
        out[name] = compare_means(*([r[name] for r in flights] for flights in by))
    return out


def report_paths(report: Report) -> None:
    """Print map quality, propellant and duration of nominal and modified descents.

    If there is an output folder, the figures are also plotted.
    """
    summary = summarise(report.rows)
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
        report.print(table)
        report.print(
            "  All fields pooled, hazard fraction of the area classified as clear: "
            f"nominal {level['pooled_clear_false_nominal']:.5f}, "
            f"modified {level['pooled_clear_false_modified']:.5f} (threshold 0.00250)"
        )
    for name, unit, paper in (("propellant", "kg", "about 1"), ("duration", "s", "2")):
        nominal, modified, difference = (v.text(2) for v in summary[name].values())
        report.print(
            f"{name}: nominal {nominal} {unit}, modified {modified} {unit}, difference "
            f"{difference} {unit} (paper: {paper} {unit})"
        )
    if report.out is not None and summary["fields"]:
        from figures import draw_all

        draw_all(report.rows, report.out)


study = Study(
    fly,
    repeats="fields",
    count=2,
    factors={"path": PATHS},
    options=(
        click.Option(
            ["--shapes"], type=click.Choice(SHAPES), default=None,
            help="Rock shape that the mission expects (default: shape in the scenario).",
        ),
        click.Option(
            ["--method"], type=click.Choice(tuple(METHODS)), default="inferred", show_default=True,
            help="Rock shapes of the mapper; inferred: from the shadows; expected: those "
            "that the mission expects; paper: hemispheres.",
        ),
    ),
    report=report_paths,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
