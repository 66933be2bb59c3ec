"""Two descents over the same rocks: the direct one, and one that lofts and looks back.

The experiment of the shadow EKF paper (IV.B and V): a lander sees rocks by their shadows while it
flies to a site, the Sun behind its camera. The modified path overflies the site by 60 m and sees
the shadows that the rocks hide from the nominal one.

python scenarios/shadows/nominal_vs_modified.py --fields 20 --jobs 2 --out out/shadows
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import t as student

from lunarsim.campaign.pool import gathered
from lunarsim.evaluation.classification import RELIABILITY_EDGES, classify
from lunarsim.evaluation.reliability import reliability
from lunarsim.grid import Grid
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

HERE = Path(__file__).parent
PATHS = ("nominal", "modified")
SHAPES = ("hemisphere", "ellipsoid", "cube", "irregular", "mixed")
ALTITUDES = (300.0, 200.0, 100.0, 50.0)
# Paper, Tables 1 and 2 and section V; rates at 50 m.
PAPER = {
    "clear_recall": (0.11, 0.29),
    "occupied_called_clear": (0.0, 0.0),
    "clear_false": (0.0, 0.0),
    "occupied_correct": (0.85, 0.85),
}
LABELS = {
    "clear_recall": "clear ground called clear",
    "occupied_called_clear": "hazards called clear",
    "clear_false": "of the ground called clear, hazard",
    "occupied_correct": "of the ground called occupied, hazard",
    "unknown": "ground called neither",
}


@dataclass(frozen=True)
class Task:
    """One flight."""

    path: str
    field: int
    seed: int
    shapes: str | None


def fly(task: Task) -> dict[str, Any]:
    """Fly once; return rates, reliability and maps by altitude, propellant and duration."""
    scenario = Scenario.load(HERE / f"shadow_{task.path}.toml")
    if task.shapes is not None:
        mapper = scenario.mapper.model_copy(update={"expected_shape": task.shapes})
        scenario = scenario.model_copy(update={"mapper": mapper})
    simulation = Simulation(scenario, flight_seed(task.seed, task.field))
    pending = list(ALTITUDES)
    levels: dict[float, dict[str, Any]] = {}
    track = []
    while not simulation.done:
        simulation.step()
        track.append(simulation.state.position - simulation.site + simulation.map_error)
        if pending and simulation.altitude <= pending[0]:
            levels[pending.pop(0)] = judge(simulation)
            if not pending:
                # The maps are done: the rest of the flight tells propellant and time.
                simulation.eyes.stop()
    wet = scenario.lander.dry_mass_kg + scenario.lander.propellant_kg
    return {
        "path": task.path,
        "field": task.field,
        "levels": levels,
        "propellant": wet - simulation.state.mass,
        "duration": simulation.time,
        "landed": simulation.verdict is not None and simulation.verdict.touchdown is not None,
        "track": np.array(track)[::5],
    }


def judge(simulation: Simulation) -> dict[str, Any]:
    """Compare the map as it stands with the truth, in the frame that the lander lands in."""
    mapper = simulation.eyes.mapper
    probability = mapper.probability.probability(mapper.tracker)
    g = mapper.grid
    east, north, _ = simulation.map_error
    shifted = Grid(g.x0 - east, g.y0 - north, g.posting, g.rows, g.cols)
    terrain = simulation.world.terrain
    rock = terrain.rock_raster(shifted)
    large = 2.0 * terrain.rocks.a >= simulation.scenario.mapper.hazard_diameter_m
    occupied = (rock >= 0) & large[np.maximum(rock, 0)]
    result = classify(probability, occupied)
    return {
        "rates": result.rates,
        "counts": result.counts(),
        "reliability": reliability(probability, occupied, RELIABILITY_EDGES),
        "rocks": mapper.tracker.filter.count,
        "map": probability,
        "occupied": occupied,
        "extent": g.extent,
    }


def mean_interval(values: list[float]) -> tuple[float, float]:
    """Return the mean and half its 95 % interval over fields (Student's t)."""
    x = np.array([v for v in values if np.isfinite(v)])
    if x.size < 2:
        return (float(x.mean()) if x.size else float("nan")), float("nan")
    half = float(student.ppf(0.975, x.size - 1) * x.std(ddof=1) / np.sqrt(x.size))
    return float(x.mean()), half


def summarise(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return means and intervals by altitude, path and rate, and the paired differences."""
    by = {p: [r for r in results if r["path"] == p] for p in PATHS}
    out: dict[str, Any] = {"altitudes": {}, "fields": len(by["nominal"])}
    for altitude in ALTITUDES:
        level = {}
        for rate in LABELS:
            values = {p: [r["levels"][altitude]["rates"][rate] for r in by[p]] for p in PATHS}
            level[rate] = {p: mean_interval(values[p]) for p in PATHS}
            level[rate]["difference"] = mean_interval(
                [b - a for a, b in zip(values["nominal"], values["modified"], strict=True)]
            )
        # Over all fields together: false clears are few.
        for p in PATHS:
            counts = [r["levels"][altitude]["counts"] for r in by[p]]
            wrong = sum(c["clear_wrong"] for c in counts)
            called = sum(c["called_clear"] for c in counts)
            level[f"pooled_clear_false_{p}"] = wrong / called if called else float("nan")
        out["altitudes"][altitude] = level
    for name in ("propellant", "duration"):
        pairs = zip(by["nominal"], by["modified"], strict=True)
        out[name] = {p: mean_interval([r[name] for r in by[p]]) for p in PATHS}
        out[name]["difference"] = mean_interval([b[name] - a[name] for a, b in pairs])
    return out


def show(summary: dict[str, Any], console: Console) -> None:
    """Print the tables."""

    def text(pair: tuple[float, float], digits: int = 4) -> str:
        return f"{pair[0]:.{digits}f} ± {pair[1]:.{digits}f}"

    for altitude, level in summary["altitudes"].items():
        table = Table(title=f"Map at {altitude:.0f} m, {summary['fields']} fields (95 % intervals)")
        for heading in ("", "nominal", "modified", "modified - nominal", "paper, at 50 m"):
            table.add_column(heading, justify="left" if not heading else "right")
        for rate, label in LABELS.items():
            paper = ""
            if altitude == 50.0:
                figures = PAPER.get(rate)
                paper = "{} / {}".format(*figures) if figures else "modified 0.09 less"
            row = level[rate]
            table.add_row(
                label, text(row["nominal"]), text(row["modified"]), text(row["difference"]), paper
            )
        console.print(table)
        console.print(
            "  all fields together, hazard in the ground called clear: "
            f"nominal {level['pooled_clear_false_nominal']:.5f}, "
            f"modified {level['pooled_clear_false_modified']:.5f} (threshold 0.00250)"
        )
    for name, unit, paper in (("propellant", "kg", "about 1"), ("duration", "s", "2")):
        row = summary[name]
        console.print(
            f"{name}: nominal {text(row['nominal'], 2)} {unit}, modified "
            f"{text(row['modified'], 2)} {unit}, difference {text(row['difference'], 2)} {unit} "
            f"(paper: {paper} {unit})"
        )


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=2, show_default=True,
              help="Rock fields; each is flown on both paths.")  # fmt: skip
@click.option("--seed", type=int, default=1, show_default=True, help="Root seed.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Processes; results do not depend on it.")  # fmt: skip
@click.option("--shapes", type=click.Choice(SHAPES), default=None,
              help="Shape by which shadows are read; left out: the scenario's.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Write all figures to this file.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for pictures; left out, none are drawn.")  # fmt: skip
def main(
    fields: int, seed: int, jobs: int, shapes: str | None, json_file: Path | None, out: Path | None
) -> None:
    """Fly both paths over random fields and compare their maps."""
    console = Console(width=140)
    tasks = [Task(path, field, seed, shapes) for field in range(fields) for path in PATHS]
    results = gathered(fly, tasks, jobs, console, "flights")
    # A field counts once both paths have flown it.
    results = results[: len(results) // len(PATHS) * len(PATHS)]
    if not results:
        raise click.Abort
    summary = summarise(results)
    show(summary, console)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(plain(summary, results), indent=1), encoding="utf-8")
    if out is not None:
        from figures import draw_all

        draw_all(results, out)


def plain(summary: dict[str, Any], results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return everything but the maps, as JSON takes it."""
    flights = [
        {
            **{k: r[k] for k in ("path", "field", "propellant", "duration", "landed")},
            "levels": {
                str(a): {
                    **{k: level[k] for k in ("rates", "counts", "rocks")},
                    "reliability": level["reliability"].tolist(),
                }
                for a, level in r["levels"].items()
            },
        }
        for r in results
    ]
    return {"summary": summary, "flights": flights}


if __name__ == "__main__":
    main()
