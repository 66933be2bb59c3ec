"""One hazard field, one LiDAR sweep, two maps and the truth.

The Gaussian DEM and the quadtree are given the same scans at the same estimated poses, and say
where the lander would be safe; the exact safety of the true ground judges both. The paper of each
compares with a simpler map of its own kind, never with the other.

python scenarios/quadtree/compare_mappers.py --fields 4 --out out/mappers
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lunarsim.evaluation.map_quality import MapQuality, local_ground, precision_at_recall
from lunarsim.evaluation.reliability import reliability
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.mapper import evidence_of
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper, SiteSelector
from lunarsim.onboard.hazards.quadtree.mapper import QuadtreeMapping, rasterised
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.rng import flight_seed
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import SafetyMap, exact_safety, plane_stochastic_safety, stochastic_safety
from lunarsim.safety.calibration import calibrated_safety
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.recorder import Tap
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import hillshade, map_axes, new_figure, save, show

SCENARIOS = Path(__file__).parents[1]
# Of the common grid, m.
POSTING = 0.2
# At which precisions are compared too: mappers see less ground, or call it with more care.
RECALL = 0.7
Scans = list[tuple[LidarScan, Estimate]]
NAMES = {
    "calibrated": "Gaussian DEM, calibrated",
    "level": "Gaussian DEM, Eqs. 15-17",
    "planes": "Gaussian DEM, support planes",
    "quadtree": "quadtree",
    "eligible": "quadtree, eligible sites (Table 1)",
}
CLASSES = {
    "safe, called safe": "#a6cee3",
    "safe, called unsafe": "#fdbf6f",
    "unsafe, called safe": "#e31a1c",
    "unsafe, called unsafe": "#8c8c8c",
}


@dataclass
class Answer:
    """What one mapper made of the scans.

    Attributes
    ----------
    p_safe, observed
        On the common grid (rows, cols).
    build_s, judge_s
        Time to take in all scans, and to judge the whole map once, s.
    megabytes
        Of what is kept between scans.
    error
        Root mean square of the mapped elevation against the true one, m.
    """

    p_safe: np.ndarray
    observed: np.ndarray
    build_s: float
    judge_s: float
    megabytes: float
    error: float


def sweep(field: int, seed: int, boulders: int) -> tuple[Simulation, Scans]:
    """Fly the sweep over a field; return the simulation and its scans after the lock."""
    scenario = Scenario.load(SCENARIOS / "morpheus.toml").changed(terrain={"boulders": boulders})
    tap = Tap()
    simulation = Simulation(scenario, flight_seed(seed, field), tap=tap)
    duration = scenario.tasking["flash"].duration_s
    scans: Scans = []
    while simulation.time < duration and not simulation.done:
        estimate, locked = simulation.estimate, simulation.computer.navigation.locked
        simulation.step()
        # What that estimate had just been made of.
        taken, *_ = tap.exchanges[-1]
        if locked:
            scans += [(m, estimate) for _, m in taken.items if isinstance(m, LidarScan)]
    return simulation, scans


def by_gaussian_dem(
    lander: Lander, scans: Scans, grid: Grid, ground: np.ndarray
) -> dict[str, Answer]:
    """Return what the Gaussian DEM says: calibrated, by the level test, by support planes."""
    began = time.perf_counter()
    pool = SamplePool(grid)
    for scan, estimate in scans:
        points = scan.points(estimate.position, estimate.attitude)
        attitude = estimate.attitude
        pool.add(points, scan.height_sigma(attitude), scan.spacing(attitude))
    dem = pooled_dem(pool)
    build = time.perf_counter() - began
    seen = np.where(dem.observed, dem.mean, np.float32(np.nan))
    error = root_mean_square(seen - ground)
    megabytes = pool.nbytes / 1e6

    def by_planes() -> tuple[np.ndarray, np.ndarray]:
        safety = plane_stochastic_safety(seen, dem.variance, grid, lander)
        return safety.p_safe, safety.observed

    def by_level() -> tuple[np.ndarray, np.ndarray]:
        safety = stochastic_safety(seen, dem.variance, grid, lander)
        return safety.p_safe, safety.observed

    def calibrated() -> tuple[np.ndarray, np.ndarray]:
        evidence = evidence_of(dem, lander, RockExpectation())
        return calibrated_safety(evidence)[0], evidence.observed

    answers = {}
    for name, judge in (("calibrated", calibrated), ("level", by_level), ("planes", by_planes)):
        judge()
        began = time.perf_counter()
        p, observed = judge()
        judged = time.perf_counter() - began
        answers[name] = Answer(p, observed, build, judged, megabytes, error)
    return answers


def by_quadtree(
    part: QuadtreeMapping, scans: Scans, grid: Grid, ground: np.ndarray
) -> dict[str, Answer]:
    """Return what the quadtree says, as a probability and by the limits of the paper."""
    mapper = QuadtreeMapper(
        grid, part.sites, elevation=float(np.median(ground)), least=part.least,
        split_count=part.split_count, hold_sigma=np.inf,
    )  # fmt: skip
    began = time.perf_counter()
    for scan, estimate in scans:
        mapper.map.insert(scan.points(estimate.position, estimate.attitude))
    build = time.perf_counter() - began
    SiteSelector(mapper.map, mapper.selector.settings, thorough=True).update()  # loads kernels
    began = time.perf_counter()
    hazard_map = mapper.hazard_map()
    judged = time.perf_counter() - began
    selection = mapper.select()
    size = mapper.map.sizes(selection.nodes)
    good = rasterised(grid, selection.position[:, :2], size, selection.status == 0, 0.0)
    fine = mapper.map.band(grid.posting, 2.0 * grid.posting)
    r, c = grid.cell(mapper.map.centres(fine))
    inside = (r >= 0) & (c >= 0) & (r < grid.rows) & (c < grid.cols)
    gap = mapper.map.elevation(fine)[inside] - ground[r[inside], c[inside]]
    megabytes, error = mapper.map.nbytes / 1e6, root_mean_square(gap)
    return {
        "quadtree": Answer(hazard_map.p_safe, hazard_map.observed, build, judged, megabytes, error),
        "eligible": Answer(good, hazard_map.observed, build, judged, megabytes, error),
    }


def root_mean_square(x: np.ndarray) -> float:
    """Return the root mean square of the finite numbers."""
    return float(np.sqrt(np.nanmean(np.square(x))))


def compare(field: int, seed: int, boulders: int) -> dict[str, Any]:
    """Return figures by mapper, and the maps."""
    simulation, scans = sweep(field, seed, boulders)
    if not scans:
        return {"field": field, "scans": 0, "rows": {}}
    own = simulation.computer.mappers["sites"].grid
    grid = Grid.centred(own.centre, own.cols * own.posting, POSTING)
    # Maps are in the local frame: so is the ground that judges them.
    ground = local_ground(simulation.world.terrain, grid, simulation.navigation_error)
    lander, part = simulation.lander, simulation.scenario.mappers["sites"].make()
    answers = by_gaussian_dem(lander, scans, grid, ground) | by_quadtree(part, scans, grid, ground)
    began = time.perf_counter()
    truth = exact_safety(ground, grid, lander)
    took = time.perf_counter() - began
    # All ground that any of them has seen; what a mapper has not seen it does not call safe.
    common = np.logical_or.reduce([a.observed for a in answers.values()]) & truth.observed
    safe = truth.safe[common]
    area = grid.posting**2
    rows = {}
    for name, a in answers.items():
        p = np.where(a.observed, a.p_safe, 0.0)[common]
        quality = MapQuality.of(p > 0.5, safe)
        rows[name] = {
            "precision": quality.precision,
            "recall": quality.recall,
            "precision_at_recall": precision_at_recall(p, safe, RECALL),
            "false_safe_m2": quality.false_safe * area,
            "observed_m2": float(a.observed.sum() * area),
            "build_ms_a_scan": 1e3 * a.build_s / len(scans),
            "judge_ms": 1e3 * a.judge_s,
            "megabytes": a.megabytes,
            "elevation_rms": a.error,
        }
    return {
        "field": field, "scans": len(scans),
        "points": int(sum(np.isfinite(s.range).sum() for s, _ in scans)),
        "common_m2": float(common.sum() * area),
        "safe_share": float(safe.mean()), "truth_ms": 1e3 * took, "rows": rows,
        "maps": (grid, ground, truth, answers, common),
    }  # fmt: skip


def show_table(results: list[dict[str, Any]], console: Console) -> None:
    """Print means over fields."""
    good = [r for r in results if r["rows"]]
    table = Table(
        title=f"{len(good)} fields, {np.mean([r['scans'] for r in good]):.0f} scans and "
        f"{np.mean([r['points'] for r in good]) / 1e6:.1f} million points each; judged on "
        f"{np.mean([r['common_m2'] for r in good]):.0f} m2 that any of them has seen, "
        f"{100 * np.mean([r['safe_share'] for r in good]):.1f} % of it exactly safe"
    )
    headings = (
        "", "precision", "recall", f"precision at\nrecall {RECALL}", "false safe (m2)",
        "observed (m2)", "a scan (ms)", "whole map (ms)", "memory (MB)", "elevation rms (m)",
    )  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left")
    for name, label in NAMES.items():
        mean = {k: np.mean([r["rows"][name][k] for r in good]) for k in good[0]["rows"][name]}
        table.add_row(
            label, f"{mean['precision']:.4f}", f"{mean['recall']:.4f}",
            f"{mean['precision_at_recall']:.4f}",
            f"{mean['false_safe_m2']:.1f}", f"{mean['observed_m2']:.0f}",
            f"{mean['build_ms_a_scan']:.1f}", f"{mean['judge_ms']:.1f}",
            f"{mean['megabytes']:.1f}", f"{mean['elevation_rms']:.3f}",
        )  # fmt: skip
    truth = f"{np.mean([r['truth_ms'] for r in good]):.1f}"
    table.add_row("exact, on the true ground", "1", "1", "1", "0", "", "", truth, "", "0")
    console.print(table)
    console.print(
        "A cell is called safe when its probability exceeds 0.5; ground not seen is not called "
        "safe. The quadtree keeps every point, the Gaussian DEM sums of each cell."
    )


def classes_of(answer: Answer, truth: SafetyMap) -> np.ndarray:
    """Return the number of each cell's class in `CLASSES`, NaN where not observed."""
    called = answer.p_safe > 0.5
    classes = np.where(truth.safe, np.where(called, 0.0, 1.0), np.where(called, 2.0, 3.0))
    return np.where(truth.observed & answer.observed, classes, np.nan)


def draw_reliability(panel: Any, truth: SafetyMap, answers: Any, common: np.ndarray) -> None:
    """Draw the share of exactly safe cells against the stated probability."""
    for name, colour in (("calibrated", "#0072B2"), ("planes", "#009E73"), ("quadtree", "#D55E00")):
        seen = common & answers[name].observed
        p, safe = answers[name].p_safe[seen], truth.safe[seen]
        table = reliability(p, safe, np.linspace(0.0, 1.0, 21))
        plot_reliability(panel, table, 30, color=colour, label=NAMES[name])
    plot_ideal(panel)
    panel.set_box_aspect(1)
    panel.set_xlabel("probability of safety")
    panel.set_ylabel("share exactly safe")
    panel.set_title("reliability")
    panel.legend()


def draw(result: dict[str, Any], path: Path) -> None:
    """Draw the truth and what each mapper gets right."""
    grid, ground, truth, answers, common = result["maps"]
    figure = new_figure(13.0, 8.2)
    axes = figure.subplots(2, 3, sharex=True, sharey=True).ravel()
    shade = hillshade(ground, grid.posting)
    show(axes[0], shade, grid, cmap="gray", vmin=0.2, vmax=1.0)
    low, high = np.nanpercentile(ground, [0.5, 99.5])
    image = show(axes[0], ground, grid, cmap="cividis", alpha=0.5, vmin=low, vmax=high)
    figure.colorbar(image, ax=axes[0], label="elevation (m)", shrink=0.8)
    map_axes(axes[0], "true ground")
    palette = ListedColormap(list(CLASSES.values()))
    shown = [(name, label) for name, label in NAMES.items() if name != "level"]
    for panel, (name, label) in zip(axes[1:5], shown, strict=True):
        panel.set_facecolor("white")
        show(panel, classes_of(answers[name], truth), grid, cmap=palette, vmin=-0.5, vmax=3.5)
        row = result["rows"][name]
        map_axes(panel, f"{label}\nprecision {row['precision']:.3f}, recall {row['recall']:.3f}")
    axes[5].remove()
    draw_reliability(figure.add_subplot(2, 3, 6), truth, answers, common)
    figure.legend(
        handles=[Patch(color=colour, label=label) for label, colour in CLASSES.items()]
        + [Patch(fc="white", ec="black", label="not observed")],
        loc="outside lower center",
        ncols=5,
    )
    save(figure, path)


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=2, show_default=True,
              help="Hazard fields.")  # fmt: skip
@click.option("--boulders", type=click.IntRange(min=0), default=300, show_default=True,
              help="On each field.")  # fmt: skip
@click.option("--seed", type=int, default=1, show_default=True, help="Root seed.")
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Write all figures to this file.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the picture of the first field.")  # fmt: skip
def main(fields: int, boulders: int, seed: int, json_file: Path | None, out: Path | None) -> None:
    """Give both mappers the same scans and judge them by the exact safety."""
    console = Console(width=150)
    results = [
        compare(field, seed, boulders)
        for field in track(range(fields), console=console, description="fields")
    ]
    if not any(r["rows"] for r in results):
        raise click.ClickException("no flight found its place on the map: try other seeds")
    show_table(results, console)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        plain = [{k: v for k, v in r.items() if k != "maps"} for r in results]
        json_file.write_text(json.dumps(plain, indent=1), encoding="utf-8")
    if out is not None:
        draw(next(r for r in results if r["rows"]), out / "mappers.png")


if __name__ == "__main__":
    main()
