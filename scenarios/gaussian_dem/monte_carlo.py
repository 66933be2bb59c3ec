"""Compare two stochastic safety tests on a Gaussian DEM with sampled terrain.

Elevation errors are sampled from the model with their correlation (Matheron's rule): a field from
the prior is scanned and interpolated like the scan itself, and the interpolation error is added
to the mean. The exact test on many such terrains gives the probability of safety under the model.
Eqs. 15 to 17 of the Gaussian DEM paper and `plane_stochastic_safety` are compared with it.

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
from testbed import LANDER, MARGIN, ScannedDem, TestbedField, map_testbed, testbed

from lunarsim import Grid, exact_safety, gaussian_dem
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.safety import plane_stochastic_safety, safe_sites, stochastic_safety
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, new_figure, save

CONFIGURATIONS = [(200.0, 30.0), (500.0, 0.0), (500.0, 60.0), (1000.0, 30.0)]
SIDE = 30.0  # side of the evaluated square, m
MAP = Grid.centred((0.0, 0.0), SIDE, 0.1)
METHODS = ("Eqs. 15-17", "support planes")


@dataclass(frozen=True)
class TerrainSampleTask:
    """Work of one process: a range of terrain samples for one scan configuration.

    `configuration` is an index of `CONFIGURATIONS`, `seed` the seed of the testbed; the samples
    have the numbers `first` to `first + count - 1`.
    """

    configuration: int
    seed: int
    first: int
    count: int


@lru_cache(maxsize=4)
def scan_testbed(configuration: int, seed: int) -> tuple[TestbedField, ScannedDem]:
    """Return the testbed of a seed and its LiDAR scan in one configuration.

    `configuration` is an index of `CONFIGURATIONS`. The last four results are cached.
    """
    field = testbed(seed, SIDE + 10.0)
    rng = np.random.default_rng([seed, configuration])
    return field, map_testbed(field, *CONFIGURATIONS[configuration], rng, grid=MAP, **MARGIN)


@lru_cache(maxsize=1)
def spectrum(cells: int) -> np.ndarray:
    """Return the square root of the power spectrum of the random field prior, m.

    The prior is Eq. 4 of the Gaussian DEM paper (exponential covariance) on a periodic square grid
    of `cells` x `cells`.
    """
    lag = MAP.posting * np.minimum(np.arange(cells), cells - np.arange(cells))
    distance = np.hypot(lag[:, None], lag[None, :])
    covariance = MARGIN["sigma_f"] ** 2 * np.exp(-distance / MARGIN["length_scale"])
    return np.sqrt(np.maximum(fft.fft2(covariance).real, 0.0))


def error_field(task: TerrainSampleTask, rng: np.random.Generator) -> np.ndarray:
    """Sample one correlated elevation error of the Gaussian DEM (rows, cols), m.

    `task` gives the testbed and the scan configuration.
    """
    _, own = scan_testbed(task.configuration, task.seed)
    # Four times as wide as the map, so that the periodicity of the sample has no effect on it.
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


def count_safe_samples(task: TerrainSampleTask) -> np.ndarray:
    """Count the sampled terrains in which each map cell is safe (rows, cols).

    The terrains are the DEM plus sampled elevation errors; their safety is computed without
    uncertainty. `task` gives the scan and the numbers of the samples.
    """
    dem = scan_testbed(task.configuration, task.seed)[1].dem
    total = np.zeros(MAP.shape, np.int64)
    for n in range(task.first, task.first + task.count):
        rng = np.random.default_rng([task.seed, task.configuration, n])
        safe, _ = safe_sites(dem.mean + error_field(task, rng), MAP, LANDER)
        total += safe
    return total


def compare_safety_tests(
    configuration: int, seed: int, safe_fraction: np.ndarray
) -> dict[str, Any]:
    """Compare two safety tests with the safe fraction of sampled terrains per cell.

    `configuration` and `seed` select the scan; `safe_fraction` (rows, cols) is the sampled safe
    fraction. The result holds, by method, bias (mean p minus fraction), RMS difference, fraction of
    cells with p more than 0.1 too high ("over") and calibration counts ("table"); also the mean
    sampled and true safe fractions and the number of cells.
    """
    field, scan = scan_testbed(configuration, seed)
    dem = scan.dem
    own = stochastic_safety(dem.mean, dem.variance, MAP, LANDER)
    planes = plane_stochastic_safety(dem.mean, dem.variance, MAP, LANDER)
    _, evaluated = safe_sites(dem.mean, MAP, LANDER)
    evaluated &= own.observed & planes.observed
    truth = exact_safety(field.elevation, field.grid, LANDER).safe[scan.window]
    p = {"Eqs. 15-17": own.p_safe[evaluated], "support planes": planes.p_safe[evaluated]}
    return {
        "sampled": float(safe_fraction[evaluated].mean()),
        "true": float(truth[evaluated].mean()),
        "bias": {m: float((p[m] - safe_fraction[evaluated]).mean()) for m in METHODS},
        "rms": {
            m: float(np.sqrt(((p[m] - safe_fraction[evaluated]) ** 2).mean())) for m in METHODS
        },
        "over": {m: float((p[m] > safe_fraction[evaluated] + 0.1).mean()) for m in METHODS},
        "table": {m: reliability(p[m], safe_fraction[evaluated]) for m in METHODS},
        "cells": int(evaluated.sum()),
    }


def draw(results: list[dict[str, Any]], path: Path) -> None:
    """Plot sampled against predicted probability of safety, one panel per scan.

    `results` are the dictionaries of `compare_safety_tests`; `path` is the output file.
    """
    figure = new_figure(3.0 * len(results), 3.6)
    panels = figure.subplots(1, len(results), sharey=True)
    for panel, result, (distance, angle) in zip(panels, results, CONFIGURATIONS, strict=True):
        plot_ideal(panel)
        for name, colour in zip(METHODS, (COLOURS[1], COLOURS[0]), strict=True):
            plot_reliability(panel, result["table"][name], color=colour, label=name)
        panel.set_title(f"{distance:.0f} m, {angle:.0f} deg")
        panel.set_xlabel("Predicted probability of safety")
        panel.set_aspect("equal")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("Fraction of sampled terrains safe")
    panels[0].legend(loc="lower right")
    save(figure, path)


@click.command()
@click.option("--samples", type=click.IntRange(min=2), default=100, show_default=True,
              help="Number of sampled terrains for each scan configuration (distance and "
              "angle).")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="Random seed of the simulated test field and of the sampled "
              "terrains.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure. Default: no figure.")  # fmt: skip
def main(samples: int, seed: int, jobs: int, out: Path | None) -> None:
    """Compare stochastic safety with exact safety on sampled terrain."""
    console = plain_console(150)
    tasks = [
        TerrainSampleTask(c, seed, first, min(10, samples - first))
        for c in range(len(CONFIGURATIONS))
        for first in range(0, samples, 10)
    ]
    counts = collect_results(count_safe_samples, tasks, jobs, console, "tasks")
    if len(counts) < len(tasks):
        raise click.Abort
    table = Table(
        title=f"Safety tests on {samples} terrains sampled from each Gaussian DEM, testbed {seed}"
    )
    for heading in ("range\n(m)", "angle\n(deg)", "cells", "truly safe\n(fraction)",
    "sampled safe\n(fraction)", "method",
                    "bias (mean p\nminus sampled)", "difference,\nRMS",
                    "cells with p >\nsampled + 0.1",
                    "calibration\nerror"):  # fmt: skip
        table.add_column(heading, justify="right")
    results = []
    for c, (distance, angle) in enumerate(CONFIGURATIONS):
        own = [n for n, task in zip(counts, tasks, strict=True) if task.configuration == c]
        result = compare_safety_tests(c, seed, sum(own) / samples)
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
