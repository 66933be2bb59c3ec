"""Compare two stochastic safety tests on a Gaussian DEM with sampled terrain.

Elevation errors are sampled from the model with their correlation (Matheron's rule): a field from
the prior is scanned and interpolated like the scan itself, and the interpolation error is added
to the mean. The exact test on many such terrains gives the probability of safety under the model.
Eqs. 15 to 17 of the Gaussian DEM paper and `plane_stochastic_safety` are compared with it.

python scenarios/gaussian_dem/monte_carlo.py --samples 200 --jobs 2 --out out/gaussian_dem
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from scipy import fft, ndimage
from testbed import LANDER, MARGIN, ScannedDem, TestbedField, map_testbed, testbed

from lunarsim import Grid, exact_safety, gaussian_dem
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.safety import plane_stochastic_safety, safe_sites, stochastic_safety
from lunarsim.studies import Case, Report, Study, pack_array, run_script, unpack_array
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, new_figure, save

CONFIGURATIONS = [(200.0, 30.0), (500.0, 0.0), (500.0, 60.0), (1000.0, 30.0)]
SCANS = [f"{distance:.0f} m, {angle:.0f} deg" for distance, angle in CONFIGURATIONS]
SIDE = 30.0  # side of the evaluated square, m
MAP = Grid.centred((0.0, 0.0), SIDE, 0.1)
METHODS = ("Eqs. 15-17", "support planes")


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


def error_field(configuration: int, seed: int, rng: np.random.Generator) -> np.ndarray:
    """Sample one correlated elevation error of the Gaussian DEM (rows, cols), m.

    `configuration` and `seed` select the scan.
    """
    _, own = scan_testbed(configuration, seed)
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


def find_safe_cells(case: Case) -> dict[str, str]:
    """Return the safe cells of one sampled terrain, as text.

    The terrain is the DEM plus a sampled elevation error; its safety is computed without
    uncertainty. The text is the map (rows, cols), packed by `pack_array`.
    """
    configuration = SCANS.index(case["scan"])
    dem = scan_testbed(configuration, case.seed)[1].dem
    rng = np.random.default_rng([case.seed, configuration, case.number])
    safe, _ = safe_sites(dem.mean + error_field(configuration, case.seed, rng), MAP, LANDER)
    return {"safe": pack_array(safe)}


def compare_safety_tests(
    configuration: int, seed: int, safe_fraction: np.ndarray
) -> dict[str, Any]:
    """Compare two safety tests with the safe fraction of sampled terrains per cell.

    The tests are Eqs. 15 to 17 of the Gaussian DEM paper, and support planes
    (`plane_stochastic_safety`). `configuration` and `seed` select the scan; `safe_fraction` (rows,
    cols) is the sampled safe fraction. The result holds, by test, bias (mean p minus fraction), RMS
    difference, fraction of cells with p more than 0.1 too high ("over") and calibration counts
    ("table"); also the mean sampled and true safe fractions and the number of cells.
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


def draw(results: dict[str, dict[str, Any]], path: Path) -> None:
    """Plot sampled against predicted probability of safety, one panel per scan.

    `results` are the dictionaries of `compare_safety_tests` by scan; `path` is the output file.
    """
    figure = new_figure(3.0 * len(results), 3.6)
    (panels,) = figure.subplots(1, len(results), sharey=True, squeeze=False)
    for panel, (scan, result) in zip(panels, results.items(), strict=True):
        plot_ideal(panel)
        for name, colour in zip(METHODS, (COLOURS[1], COLOURS[0]), strict=True):
            plot_reliability(panel, result["table"][name], color=colour, label=name)
        panel.set_title(scan)
        panel.set_xlabel("Predicted probability of safety")
        panel.set_aspect("equal")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("Fraction of sampled terrains safe")
    panels[0].legend(loc="lower right")
    save(figure, path)


def print_comparison(report: Report) -> None:
    """Print how p_safe of two safety tests differs from the sampled safe fraction.

    The table has one row per scan and test. If there is an output folder, the comparison is also
    plotted.
    """
    groups = report.groups("scan")
    samples = max(map(len, groups.values()))
    table = Table(
        title=f"Safety tests on {samples} terrains sampled from each Gaussian DEM, "
        f"testbed {report.seed}"
    )
    for heading in (
        "scan: range\nand angle", "cells", "truly safe\n(fraction)", "sampled safe\n(fraction)",
        "method", "bias (mean p\nminus sampled)", "difference,\nRMS",
        "cells with p >\nsampled + 0.1", "calibration\nerror",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    results = {}
    for (scan,), rows in groups.items():
        total = np.sum([unpack_array(row["safe"]) for row in rows], axis=0, dtype=np.int64)
        result = compare_safety_tests(SCANS.index(scan), report.seed, total / len(rows))
        results[scan] = result
        cells = (scan, f"{result['cells']}", f"{result['true']:.3f}", f"{result['sampled']:.3f}")
        for m in METHODS:
            table.add_row(
                *(cells if m == METHODS[0] else [""] * 4), m, f"{result['bias'][m]:+.3f}",
                f"{result['rms'][m]:.3f}", f"{result['over'][m]:.4f}",
                f"{calibration_error(result['table'][m]):.3f}",
            )  # fmt: skip
    report.print(table)
    if report.out is not None:
        draw(results, report.out / "monte_carlo.png")


study = Study(
    find_safe_cells,
    repeats="samples",
    count=100,
    minimum=2,
    seed=0,
    factors={"scan": SCANS},
    factor_help={"scan": "Range and angle off nadir of the scan."},
    report=print_comparison,
)

if __name__ == "__main__":
    run_script(study)
