"""From slope, roughness and exceptions to a probability: measured on simulated hazard fields.

Flies the LiDAR sweep over fields of few and of many boulders, looks at every site that the quadtree
holds afterwards, and fits the probability that the lander would be exactly safe there. Every fourth
field is kept out of the fit and draws the reliability diagram.

python scenarios/quadtree/calibration.py --fields 24 --jobs 2 --out out/calibration
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from lunarsim.campaign.pool import gathered
from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.evaluation.reliability import EDGES, calibration_error, frequencies, reliability
from lunarsim.evaluation.statistics import Proportion
from lunarsim.onboard.hazards.quadtree.site_probability import features
from lunarsim.rng import flight_seed
from lunarsim.safety.logistic import Logistic
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.viz.reliability import plot_ideal
from lunarsim.viz.style import COLOURS, new_figure, save

SCENARIOS = Path(__file__).parents[1]
# Fields differ in what lies on them, so that neither kind of site is rare.
BOULDERS = (60, 150, 300, 500)


@dataclass(frozen=True)
class Task:
    """One sweep."""

    field: int
    seed: int


def sweep(task: Task) -> dict[str, Any]:
    """Fly one sweep and return features and truth of the sites (n,) that it saw whole."""
    scenario = Scenario.load(SCENARIOS / "morpheus.toml").changed(
        terrain={"boulders": BOULDERS[task.field % len(BOULDERS)]}
    )
    simulation = Simulation(scenario, flight_seed(task.seed, task.field))
    duration = scenario.tasking["flash"].duration_s
    while simulation.time < duration + 0.2 and not simulation.done:
        simulation.step()
    mapper = simulation.computer.mappers["sites"]
    selection, limits = mapper.select(), mapper.selector.settings
    seen = np.isfinite(selection.roughness)
    true = selection.position[seen] - simulation.navigation_error
    return {
        "slope": selection.slope[seen] / limits.slope_limit,
        "roughness": selection.roughness[seen] / limits.roughness_limit,
        "ratio": selection.ratio[seen],
        "near": selection.near[seen],
        "safe": simulation.truth.safe_at(true[:, :2]),
    }


def features_of(sites: dict[str, np.ndarray]) -> np.ndarray:
    """Return the features of sites (n, k)."""
    return features(*(sites[key] for key in ("slope", "roughness", "ratio", "near")))


def draw(table: np.ndarray, fields: int, path: Path) -> None:
    """Draw the reliability diagram with 95 % Wilson intervals."""
    figure = new_figure(5.4, 5.6)
    top, bottom = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (3, 1)})
    full = table[:, 0] > 0
    p, share = frequencies(table[full])
    interval = np.array([Proportion(int(s), int(n)).interval for n, _, s in table[full]])
    beside = np.abs(interval - share[:, None]).T
    plot_ideal(top, label="perfect")
    top.errorbar(p, share, beside, fmt="o", color=COLOURS[0], capsize=2, label="fields not fitted")
    top.set_ylabel("share of sites that are safe")
    top.set_title(
        f"Quadtree probability of safety, {fields} fields kept out "
        f"(ECE {calibration_error(table):.3f})"
    )
    top.legend()
    top.grid(alpha=0.3)
    bottom.bar(EDGES[:-1], table[:, 0], np.diff(EDGES), align="edge", color=COLOURS[0])
    bottom.set_yscale("log")
    bottom.set_xlabel("probability of landing safely")
    bottom.set_ylabel("sites")
    save(figure, path)


@click.command()
@click.option("--fields", type=click.IntRange(min=4), default=24, show_default=True,
              help="Fields; every fourth is kept out of the fit.")  # fmt: skip
@click.option("--seed", type=int, default=7, show_default=True, help="Root seed.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Processes; results do not depend on it.")  # fmt: skip
@click.option("--save", "target", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Write the model to this file; the package's own is "
                   "lunarsim/onboard/hazards/quadtree/calibration.json.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the diagram.")  # fmt: skip
def main(fields: int, seed: int, jobs: int, target: Path | None, out: Path | None) -> None:
    """Fit the quadtree's probability of safety and judge it on fields kept out."""
    console = Console(width=110)
    tasks = [Task(field, seed) for field in range(fields)]
    swept = gathered(sweep, tasks, jobs, console, "sweeps")
    fields = len(swept)
    # Every fourth in turn of the kinds: 0, 5, 10, 15, ...
    out_of_fit = [i for i in range(fields) if i % 4 == (i // 4) % 4]
    fitted = [i for i in range(fields) if i not in out_of_fit]

    def joined(which: list[int]) -> dict[str, np.ndarray]:
        return {key: np.concatenate([swept[i][key] for i in which]) for key in swept[0]}

    train, test = joined(fitted), joined(out_of_fit)
    note = (
        f"scenarios/quadtree/calibration.py --fields {fields} --seed {seed}: "
        f"{train['safe'].size} sites of {len(fitted)} fields"
    )
    model = Logistic.fit(features_of(train), train["safe"], note)
    p = model.probability(features_of(test))
    table = reliability(p, test["safe"])
    shown = Table(title=f"Reliability on {len(out_of_fit)} fields kept out")
    for heading in ("probability", "mean", "share safe", "sites"):
        shown.add_column(heading, justify="right")
    for (low, high), mean, share, n in zip(
        pairwise(EDGES), *frequencies(table), table[:, 0], strict=True
    ):
        shown.add_row(f"{low:.2f}-{high:.2f}", f"{mean:.3f}", f"{share:.3f}", f"{n:.0f}")
    console.print(shown)
    quality = MapQuality.of(p > 0.5, test["safe"])
    console.print(
        f"expected calibration error {calibration_error(table):.4f}; at 0.5: precision "
        f"{quality.precision:.4f}, recall {quality.recall:.4f}; "
        f"{quality.safe_share:.3f} of {quality.judged} sites are safe"
    )
    console.print("weights " + ", ".join(f"{w:.4f}" for w in model.weights))
    if target is not None:
        model.save(target)
    if out is not None:
        draw(table, len(out_of_fit), out / "reliability.png")


if __name__ == "__main__":
    main()
