"""Whether p_safe of Eqs. 15 to 17 comes true, and what makes it do so.

Scans testbeds (500 hemispheres of 1 m on 200 x 200 m) in the paper's nine configurations, fits the
calibrated probability to the even ones and judges both on the odd ones.

python scenarios/gaussian_dem/calibration.py --fields 20 --jobs 2 --out out/gaussian_dem
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import fields as dataclass_fields
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from testbed import (
    CONFIGURATIONS,
    LANDER,
    MARGIN,
    crop,
    scan,
    testbed,
    view_grid,
)

from lunarsim.campaign.pool import gathered
from lunarsim.evaluation.map_quality import MapQuality, precision_at_recall
from lunarsim.evaluation.reliability import brier_score, calibration_error, reliability
from lunarsim.onboard.hazards.gaussian_dem import gaussian_dem
from lunarsim.safety import bounded_safety, stochastic_safety
from lunarsim.safety.calibration import COUNT, features
from lunarsim.safety.logistic import Logistic
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, new_figure, save

# Cells this far apart are judged: neighbours say the same.
STRIDE = 10


@dataclass(frozen=True)
class Judged:
    """Sites of one field and configuration (n,); slope and roughness as shares of the limits."""

    p_slope: np.ndarray
    p_roughness: np.ndarray
    p_safe: np.ndarray
    slope: np.ndarray
    roughness: np.ndarray
    safe: np.ndarray


def judge(seed: int) -> list[Judged]:
    """Scan one testbed in all configurations."""
    field = testbed(seed)
    out = []
    for n, (distance, angle) in enumerate(CONFIGURATIONS):
        rng = np.random.default_rng([seed, n])
        points, sigma, shape = scan(field, distance, angle, rng)
        grid = view_grid(distance)
        window = crop(field, grid)
        dem = gaussian_dem(points, grid, sigma_eps=sigma, image_shape=shape, **MARGIN)
        own = stochastic_safety(dem.mean, dem.variance, grid, LANDER)
        nominal = bounded_safety(dem.mean, grid, LANDER)
        use = own.observed & nominal.observed & field.safety.observed[window]
        use &= (np.arange(grid.rows) % STRIDE == 0)[:, None] & (np.arange(grid.cols) % STRIDE == 0)
        safe = field.safety.safe[window][use]
        slope = nominal.slope[use] / LANDER.slope_limit
        roughness = nominal.roughness[use] / LANDER.roughness_limit
        out.append(
            Judged(own.p_slope[use], own.p_roughness[use], own.p_safe[use], slope, roughness, safe)
        )
    return out


def merged(fields: list[list[Judged]], n: int) -> Judged:
    """Return all sites of a configuration."""
    names = [field.name for field in dataclass_fields(Judged)]
    return Judged(*(np.concatenate([getattr(f[n], name) for f in fields]) for name in names))


def features_of(sites: Judged) -> np.ndarray:
    """Return the features of sites (n, k)."""
    return features(sites.p_slope, sites.p_roughness, sites.slope, sites.roughness)


def draw(rows: list[tuple[np.ndarray, np.ndarray]], path: Path) -> None:
    """Draw reliability before and after, by configuration."""
    figure = new_figure(9.6, 9.6)
    panels = figure.subplots(3, 3, sharex=True, sharey=True)
    for panel, (distance, angle), (raw, fitted) in zip(
        panels.ravel(), CONFIGURATIONS, rows, strict=True
    ):
        plot_ideal(panel)
        for table, colour, label in (
            (raw, COLOURS[1], "Eqs. 15-17"),
            (fitted, COLOURS[0], "calibrated"),
        ):
            error = calibration_error(table)
            plot_reliability(panel, table, color=colour, label=f"{label}, ECE {error:.3f}")
        panel.set_title(f"{distance:.0f} m, {angle:.0f} deg")
        panel.legend(loc="lower right")
        panel.grid(alpha=0.3)
    for panel in panels[-1]:
        panel.set_xlabel("probability of safety")
    for panel in panels[:, 0]:
        panel.set_ylabel("share exactly safe")
    figure.suptitle("Sites of fields kept out of the fit")
    save(figure, path)


@click.command()
@click.option("--fields", type=click.IntRange(min=2), default=20, show_default=True,
              help="Testbeds; the even ones are fitted, the odd ones judged.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Processes; results do not depend on it.")  # fmt: skip
@click.option("--save", "target", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Write the model to this file; the package's own is "
                   "lunarsim/safety/calibration.json.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the diagram.")  # fmt: skip
def main(fields: int, jobs: int, target: Path | None, out: Path | None) -> None:
    """Judge p_safe on testbeds, fit the calibrated one, and judge that."""
    console = Console(width=170)
    judged = gathered(judge, range(fields), jobs, console, "testbeds")
    fields = len(judged)
    fitted, kept = judged[::2], judged[1::2]
    note = f"scenarios/gaussian_dem/calibration.py --fields {fields}"
    models = []
    for n in range(len(CONFIGURATIONS)):
        sites = merged(fitted, n)
        models.append(Logistic.fit(features_of(sites), sites.safe, note, rising=COUNT - 1))
    model = Logistic(tuple(w for m in models for w in m.weights), note)
    table = Table(title=f"{len(kept)} testbeds kept out of the fit, a cell in {STRIDE**2}; p > 0.5")
    for heading in ("range\nm", "angle\ndeg", "sites", "share\nsafe", "ECE of\n15-17",
                    "mean p less\nshare safe", "ECE\nfitted", "mean p less\nshare safe",
                    "precision\nof 15-17", "precision\nfitted", "recall\nof 15-17",
                    "recall\nfitted", "fitted, at recall\nof 15-17", "Brier of\n15-17",
                    "Brier\nfitted"):  # fmt: skip
        table.add_column(heading, justify="right")
    rows = []
    for n, (distance, angle) in enumerate(CONFIGURATIONS):
        sites = merged(kept, n)
        own = models[n].probability(features_of(sites))
        tables = reliability(sites.p_safe, sites.safe), reliability(own, sites.safe)
        rows.append(tables)
        share = sites.safe.mean()
        raw, calibrated = (MapQuality.of(p > 0.5, sites.safe) for p in (sites.p_safe, own))
        # At the threshold at which the calibrated one finds as many.
        strict = precision_at_recall(own, sites.safe, raw.recall)
        table.add_row(
            f"{distance:.0f}", f"{angle:.0f}", f"{sites.safe.size}", f"{share:.3f}",
            f"{calibration_error(tables[0]):.4f}", f"{sites.p_safe.mean() - share:+.3f}",
            f"{calibration_error(tables[1]):.4f}", f"{own.mean() - share:+.3f}",
            f"{raw.precision:.4f}", f"{calibrated.precision:.4f}",
            f"{raw.recall:.4f}", f"{calibrated.recall:.4f}", f"{strict:.4f}",
            *(f"{brier_score(p, sites.safe):.4f}" for p in (sites.p_safe, own)),
        )  # fmt: skip
    console.print(table)
    if target is not None:
        model.save(target)
    if out is not None:
        draw(rows, out / "calibration.png")


if __name__ == "__main__":
    main()
