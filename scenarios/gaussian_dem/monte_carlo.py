"""What the two stochastic safety tests make of a Gaussian DEM, against sampled terrain.

Elevation errors are drawn as the model has them, with their correlation: a field drawn from the
prior is scanned, interpolated like the scan itself, and what the interpolation misses is added to
the mean (Matheron's rule). The exact test on many such terrains gives the probability of safety
under the model; Eqs. 15 to 17 and `plane_stochastic_safety` are compared with it.

python scenarios/gaussian_dem/monte_carlo.py --samples 200 --jobs 2 --out out/gaussian_dem
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table
from scipy import fft, ndimage
from testbed import LANDER, MARGIN, Field, Mapped, mapped, testbed

from lunarsim.campaign.pool import gathered
from lunarsim.console import plain_console
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import gaussian_dem
from lunarsim.safety import (
    exact_safety,
    plane_stochastic_safety,
    safe_sites,
    stochastic_safety,
)
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, new_figure, save

CONFIGURATIONS = [(200.0, 30.0), (500.0, 0.0), (500.0, 60.0), (1000.0, 30.0)]
SIDE = 30.0  # of the square that is judged, m
MAP = Grid.centred((0.0, 0.0), SIDE, 0.1)
METHODS = ("Eqs. 15-17", "support planes")


@dataclass(frozen=True)
class Task:
    """Some samples of one configuration."""

    configuration: int
    seed: int
    first: int
    count: int


@lru_cache(maxsize=4)
def scanned(configuration: int, seed: int) -> tuple[Field, Mapped]:
    """Return the testbed and its scan in one configuration."""
    field = testbed(seed, SIDE + 10.0)
    rng = np.random.default_rng([seed, configuration])
    return field, mapped(field, *CONFIGURATIONS[configuration], rng, grid=MAP, **MARGIN)


@lru_cache(maxsize=1)
def spectrum(cells: int) -> np.ndarray:
    """Return the root of the spectrum of Eq. 4 on a periodic square of the map's posting."""
    lag = MAP.posting * np.minimum(np.arange(cells), cells - np.arange(cells))
    distance = np.hypot(lag[:, None], lag[None, :])
    covariance = MARGIN["sigma_f"] ** 2 * np.exp(-distance / MARGIN["length_scale"])
    return np.sqrt(np.maximum(fft.fft2(covariance).real, 0.0))


def error_field(task: Task, rng: np.random.Generator) -> np.ndarray:
    """Return one draw of the DEM's error over the map (rows, cols), m."""
    _, own = scanned(task.configuration, task.seed)
    # Four times as wide as the map: what is periodic in the draw does not show on it.
    cells = fft.next_fast_len(4 * MAP.rows)
    noise = rng.standard_normal((2, cells, cells))
    drawn = fft.ifft2(spectrum(cells) * (noise[0] + 1j * noise[1])).real * cells
    col = (own.points[:, 0] - MAP.x0) / MAP.posting
    row = (own.points[:, 1] - MAP.y0) / MAP.posting
    seen = own.points.copy()
    seen[:, 2] = ndimage.map_coordinates(drawn, (row, col), order=1, mode="grid-wrap")
    seen[:, 2] += own.sigma * rng.standard_normal(len(seen))
    found = gaussian_dem(seen, MAP, sigma_eps=own.sigma, image_shape=own.shape, **MARGIN)
    return np.asarray(drawn[: MAP.rows, : MAP.cols] - found.mean)


def sample(task: Task) -> np.ndarray:
    """Return in how many samples each cell is exactly safe (rows, cols)."""
    dem = scanned(task.configuration, task.seed)[1].dem
    total = np.zeros(MAP.shape, np.int64)
    for n in range(task.first, task.first + task.count):
        rng = np.random.default_rng([task.seed, task.configuration, n])
        safe, _ = safe_sites(dem.mean + error_field(task, rng), MAP, LANDER)
        total += safe
    return total


def judge(configuration: int, seed: int, share: np.ndarray) -> dict[str, Any]:
    """Compare both tests with the share of samples in which each cell is safe."""
    field, scan = scanned(configuration, seed)
    dem = scan.dem
    own = stochastic_safety(dem.mean, dem.variance, MAP, LANDER)
    planes = plane_stochastic_safety(dem.mean, dem.variance, MAP, LANDER)
    _, judged = safe_sites(dem.mean, MAP, LANDER)
    judged &= own.observed & planes.observed
    truth = exact_safety(field.elevation, field.grid, LANDER).safe[scan.window]
    p = {"Eqs. 15-17": own.p_safe[judged], "support planes": planes.p_safe[judged]}
    return {
        "sampled": float(share[judged].mean()),
        "true": float(truth[judged].mean()),
        "bias": {m: float((p[m] - share[judged]).mean()) for m in METHODS},
        "rms": {m: float(np.sqrt(((p[m] - share[judged]) ** 2).mean())) for m in METHODS},
        "over": {m: float((p[m] > share[judged] + 0.1).mean()) for m in METHODS},
        "table": {m: reliability(p[m], share[judged]) for m in METHODS},
        "cells": int(judged.sum()),
    }


def draw(results: list[dict[str, Any]], path: Path) -> None:
    """Draw the sampled probability against the stated one."""
    figure = new_figure(3.0 * len(results), 3.6)
    panels = figure.subplots(1, len(results), sharey=True)
    for panel, result, (distance, angle) in zip(panels, results, CONFIGURATIONS, strict=True):
        plot_ideal(panel)
        for name, colour in zip(METHODS, (COLOURS[1], COLOURS[0]), strict=True):
            plot_reliability(panel, result["table"][name], color=colour, label=name)
        panel.set_title(f"{distance:.0f} m, {angle:.0f} deg")
        panel.set_xlabel("stated probability of safety")
        panel.set_aspect("equal")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("share of sampled terrains safe")
    panels[0].legend(loc="lower right")
    save(figure, path)


@click.command()
@click.option("--samples", type=click.IntRange(min=2), default=100, show_default=True,
              help="Terrains for each configuration.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="Of the testbed and the draws.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Processes; results do not depend on it.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure.")  # fmt: skip
def main(samples: int, seed: int, jobs: int, out: Path | None) -> None:
    """Compare stochastic safety with exact safety on sampled terrain."""
    console = plain_console(150)
    tasks = [
        Task(c, seed, first, min(10, samples - first))
        for c in range(len(CONFIGURATIONS))
        for first in range(0, samples, 10)
    ]
    counts = gathered(sample, tasks, jobs, console, "tasks")
    if len(counts) < len(tasks):
        raise click.Abort
    table = Table(title=f"{samples} terrains drawn from each Gaussian DEM, testbed {seed}")
    for heading in ("range\nm", "angle\ndeg", "cells", "truly\nsafe", "sampled\nsafe", "",
                    "mean p less\nsampled", "rms\ndifference", "p > sampled\n+ 0.1",
                    "calibration\nerror"):  # fmt: skip
        table.add_column(heading, justify="right")
    results = []
    for c, (distance, angle) in enumerate(CONFIGURATIONS):
        own = [n for n, task in zip(counts, tasks, strict=True) if task.configuration == c]
        result = judge(c, seed, sum(own) / samples)
        results.append(result)
        for m in METHODS:
            first = m == METHODS[0]
            table.add_row(
                f"{distance:.0f}" if first else "", f"{angle:.0f}" if first else "",
                f"{result['cells']}" if first else "", f"{result['true']:.3f}" if first else "",
                f"{result['sampled']:.3f}" if first else "", m, f"{result['bias'][m]:+.3f}",
                f"{result['rms'][m]:.3f}", f"{result['over'][m]:.4f}",
                f"{calibration_error(result['table'][m]):.3f}",
            )  # fmt: skip
    console.print(table)
    if out is not None:
        draw(results, out / "monte_carlo.png")


if __name__ == "__main__":
    main()
