"""Fit the calibration stage of the fused map to flights of the all-sensor study.

The quadtree maps the same LiDAR returns as the Gaussian DEM. It is therefore a second input of the
calibration stage and never an independent factor. The fit uses fields on which no map is evaluated;
the fields of each study condition (row) are evaluated with a fit to the other conditions.

python scenarios/sensor_fusion.py --fields 3 --seed 11 --out out/fit
python scenarios/sensor_fusion_calibration.py out/fit/results.json --out out/fused.json
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table
from scipy.special import expit
from sensor_fusion_flights import ODDS, POSTING

from lunarsim import InputError
from lunarsim.api import Lander
from lunarsim.console import plain_console
from lunarsim.onboard.calibration.fused import FusedCalibration

Array = np.ndarray[Any, Any]

# Fits without a second map and with it.
FITS = ("none", "without the quadtree", "with the quadtree")


def sum_site_counts(flights: list[dict[str, Any]]) -> Array:
    """Sum the site counts of flights by true safety and probability of two maps.

    The axes of the result are truth (unsafe, safe), bin of the fused probability, and bin of the
    quadtree probability (last bin: not observed by the quadtree).
    """
    shape = (2, len(ODDS) - 1, len(ODDS))
    pooled = np.zeros(shape)
    for flight in flights:
        for maps in flight["maps"].values():
            pooled += np.array(maps["fused"]["joint"])
    return pooled


def probability_bins() -> tuple[Array, Array, Array]:
    """Return the probabilities of each bin of the site counts (n,).

    These are fused probability, quadtree probability, and whether the quadtree observed the sites.
    """
    middle = expit(0.5 * (ODDS[1:] + ODDS[:-1]))
    p, q = np.meshgrid(middle, np.append(middle, 0.5), indexing="ij")
    seen = np.ones(p.shape, np.bool_)
    seen[:, -1] = False
    return p.ravel(), q.ravel(), seen.ravel()


def fit_calibration(site_counts: Array, with_quadtree: bool, lander: Lander) -> FusedCalibration:
    """Fit the calibrated p_safe of the fused map, C, to site counts of two maps.

    `site_counts` of the fused map and the quadtree is the value of `sum_site_counts`;
    `with_quadtree` uses the quadtree as second input. Sites whose lander footprints overlap count
    as one.
    """
    p, q, seen = probability_bins()
    unsafe, safe = site_counts.reshape(2, -1)
    footprint = np.pi * (lander.leg_radius + 0.5 * lander.pad_diameter) ** 2
    return FusedCalibration.fit(
        p, q, seen & with_quadtree, safe, unsafe, site_weight=min(POSTING**2 / footprint, 1.0)
    )


def evaluate_calibration(calibration: FusedCalibration, site_counts: Array) -> tuple[float, float]:
    """Return Brier score and bias of a calibration of the fused map on site counts.

    The bias is the mean calibrated p_safe minus the safe fraction.
    """
    p, q, seen = probability_bins()
    unsafe, safe = site_counts.reshape(2, -1)
    c = calibration.probability(p.astype(np.float32), q, seen).astype(np.float64)
    n = max(site_counts.sum(), 1.0)
    return (
        float((safe * (1.0 - c) ** 2 + unsafe * c**2).sum() / n),
        float((safe * (c - 1.0) + unsafe * c).sum() / n),
    )


@click.command()
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="File for the fit to all study conditions. Default: none.")  # fmt: skip
def main(file: Path, out: Path | None) -> None:
    """Fit C, the calibrated p_safe, to the flights in FILE; test on held-out rows."""
    try:
        flights = json.loads(file.read_text(encoding="utf-8"))["rows"]
        rows = {row: [f for f in flights if f["row"] == row] for row in (f["row"] for f in flights)}
        all_counts = {row: sum_site_counts(mine) for row, mine in rows.items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise click.BadParameter(
            f"{file} is not a file of flights ({error!r})", param_hint="FILE"
        ) from None
    if len(all_counts) < 2:
        raise click.BadParameter(
            f"{file} must contain flights of two or more study conditions (rows), because each "
            "row is evaluated by a fit to the other rows",
            param_hint="FILE",
        )
    console, lander = plain_console(140), Lander()
    table = Table(title="Brier score and bias (mean C minus safe fraction), leave-one-row-out")
    table.add_column("row")
    for name in FITS:
        table.add_column(name, justify="right")
    try:
        for row, mine in all_counts.items():
            rest = np.sum([c for other, c in all_counts.items() if other != row], axis=0)
            fits = [
                FusedCalibration(),
                *(fit_calibration(rest, second, lander) for second in (False, True)),
            ]
            words = (evaluate_calibration(c, mine) for c in fits)
            table.add_row(row, *(f"{square:.4f}, {off:+.4f}" for square, off in words))
        overall = fit_calibration(np.sum(list(all_counts.values()), axis=0), True, lander)
    except InputError as error:
        raise click.ClickException(str(error)) from None
    console.print(table)
    console.print(
        f"all rows: logit C = {overall.intercept:+.3f} + {overall.slope:.3f} logit p + "
        f"{overall.other:.3f} logit q"
    )
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        overall.save(out)


if __name__ == "__main__":
    main()
