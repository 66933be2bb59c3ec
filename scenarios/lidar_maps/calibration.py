"""Fit the safety probability of the Gaussian DEM and test it on held-out terrains.

The script scans a matrix of terrains (relief, rocks, lander, range, angle, noise; `worlds.py`) and
fits the calibrated probability of `lunarsim.safety.calibration` to all of them. The script then
repeats the fit without each relief, rock law, lander and range (a row of the matrix), and evaluates
each fit on the held-out row. A fit is an ensemble: one model for all its terrains, and one without
each of them.

python scenarios/lidar_maps/calibration.py --scenes 480 --jobs 2 --out out/lidar_maps

With --held-out-row, only one row is evaluated, on more scenes of it than the matrix contains:

python scenarios/lidar_maps/calibration.py --scenes 480 --held-out-row "rocks posts" --new-scenes
200
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from scene_cache import SceneSites, evaluated_scenes
from worlds import LANDERS, RANGES, RELIEFS, ROCKS, UPRIGHT, LidarScene, scenes

from lunarsim import exact_safety
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.reliability import (
    brier_skill,
    calibration_error,
    chance_calibration_error,
    reliability,
)
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import dem_site_evidence
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety.calibration import (
    MONOTONE_FEATURES,
    NEAR_DOMAIN_LOG_ODDS_MARGIN,
    features,
    in_domain,
    observed_terrain_bound,
    outside_domain_bound,
    p_no_rock_under_pads,
)
from lunarsim.safety.ensemble import ALMOST_CERTAINLY_UNSAFE_P, Ensemble, conservative_probability
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, new_figure, save

F = TypeVar("F", bound=Callable[..., Any])

SITES = 100  # evaluated sites per scene
# Edges of the strata: nominal slope / limit, and fraction of terrain above the roughness limit.
SLOPES = (0.0, 0.5, 0.85, 1.15, np.inf)
COVERS = (0.0, 0.002, 0.01, np.inf)


def judge(scene: LidarScene) -> SceneSites:
    """Simulate a LiDAR scan of a scene; return calibration inputs and truth of sites."""
    terrain, grid, lander = scene.terrain(), scene.grid(), LANDERS[scene.lander]
    pool = SamplePool(grid)
    scan, position = scene.flash(terrain)
    pool.add(scan.points(position, UPRIGHT), scan.height_sigma(UPRIGHT), scan.spacing(UPRIGHT))
    evidence = dem_site_evidence(pooled_dem(pool), lander, RockExpectation())
    truth = exact_safety(terrain.raster(grid), grid, lander)
    sites = np.flatnonzero(evidence.observed & truth.observed)
    sites = scene.rng(4).choice(sites, min(SITES, len(sites)), replace=False)
    where = np.zeros(grid.shape, bool)
    where.ravel()[sites] = True
    return SceneSites(
        scene,
        features(evidence, where).astype(np.float32),
        in_domain(evidence)[where],
        np.minimum(observed_terrain_bound(evidence), p_no_rock_under_pads(evidence))[where],
        outside_domain_bound(evidence)[where],
        evidence.slope[where],
        np.ones(np.count_nonzero(where), bool),
        float(evidence.curve.at(lander.roughness_limit)),
        truth.safe[where],
    )


@dataclass(frozen=True)
class PooledSites:
    """Landing sites of many scenes, concatenated; fields (n, ...) of `SceneSites`."""

    features: np.ndarray
    known: np.ndarray
    observed_terrain_bound: np.ndarray
    outside_domain_bound: np.ndarray
    slope: np.ndarray
    doomed: np.ndarray
    cover: np.ndarray
    safe: np.ndarray

    @classmethod
    def of(cls, evaluated: list[SceneSites]) -> PooledSites:
        """Concatenate the sites of several scenes."""
        columns = [
            np.concatenate([getattr(j, name) for j in evaluated])
            for name in (
                "features",
                "known",
                "observed_terrain_bound",
                "outside_domain_bound",
                "slope",
                "doomed",
            )
        ]
        cover = np.concatenate([np.full(len(j.safe), j.cover) for j in evaluated])
        return cls(*columns, cover, np.concatenate([j.safe for j in evaluated]))


def fit_model(
    evaluated: list[SceneSites],
    rising: int = MONOTONE_FEATURES,
    note: str = "",
    start: Ensemble | None = None,
) -> Ensemble:
    """Fit the calibrated safety probability to the sites in its domain.

    The result is an ensemble: one model for all sites, and one without each kind of relief, rocks,
    lander and range. The weights of the last `rising` inputs are non-negative; `note` is stored in
    the model; `start` is an ensemble whose weights start the iteration.
    """
    s = PooledSites.of(evaluated)
    number = np.repeat(np.arange(len(evaluated)), [len(j.safe) for j in evaluated])[s.known]
    worlds = {
        f"{axis} {name}": np.array([of(j.scene) == name for j in evaluated])[number]
        for axis, names, of in AXES
        for name in names
    }
    x, y = s.features[s.known], s.safe[s.known]
    return Ensemble.fit(x, y, worlds, note, rising=rising, start=start)


def probability(
    model: Ensemble,
    sites: PooledSites,
    farther: float = NEAR_DOMAIN_LOG_ODDS_MARGIN,
    unsafe_limit: float = ALMOST_CERTAINLY_UNSAFE_P,
) -> tuple[np.ndarray, np.ndarray]:
    """Return p_safe of sites by a model, and whether the value is calibrated (n,).

    `farther` is the log-odds margin outside the calibrated domain. Sites with a probability up to
    `unsafe_limit` are classified as certainly unsafe.
    """
    odds = model.evaluate_features(sites.features)
    p = conservative_probability(
        odds.low, sites.observed_terrain_bound, sites.outside_domain_bound, sites.known, farther
    )
    return p, sites.known & odds.estimate(
        sites.observed_terrain_bound, unsafe_limit, sites.doomed
    ).agreed


def nearest_range(scene: LidarScene) -> str:
    """Return the range of the matrix ("120 m", ...) nearest to that of a scene."""
    return f"{RANGES[int(np.argmin(np.abs(np.log(np.divide(RANGES, scene.distance)))))]:.0f} m"


AXES: tuple[tuple[str, tuple[str, ...], Callable[[LidarScene], str]], ...] = (
    ("relief", RELIEFS, lambda s: s.relief),
    ("rocks", ROCKS, lambda s: s.rocks),
    ("lander", tuple(LANDERS), lambda s: s.lander),
    ("range", tuple(f"{r:.0f} m" for r in RANGES), nearest_range),
)


def held_out_rows(
    evaluated: list[SceneSites],
) -> Iterator[tuple[str, list[SceneSites], list[SceneSites]]]:
    """Yield each row of the matrix: name, scenes outside the row, scenes in it.

    A row is one relief, rock law, lander or range.
    """
    for axis, names, of in AXES:
        for name in names:
            inside = [of(j.scene) == name for j in evaluated]
            others = [j for j, i in zip(evaluated, inside, strict=True) if not i]
            kept = [j for j, i in zip(evaluated, inside, strict=True) if i]
            if kept and others:
                yield f"{axis} {name}", others, kept


FIGURES = ("base", "ece", "chance", "skill", "share", "gap", "surer", "right")


def figures(p: np.ndarray, safe: np.ndarray) -> dict[str, float]:
    """Return calibration metrics (`FIGURES`) of probabilities against truth (n,).

    The values are NaN without sites.
    """
    if not p.size:
        return dict.fromkeys(FIGURES, np.nan)
    base = safe.mean()
    above_95, above_99 = p > 0.95, p > 0.99
    return {
        "base": base,
        "ece": calibration_error(reliability(p, safe)),
        "chance": chance_calibration_error(p, np.random.default_rng(0)),
        "skill": brier_skill(p, safe),
        "share": above_95.mean(),
        "gap": p[above_95].mean() - safe[above_95].mean() if above_95.any() else np.nan,
        "surer": above_99.mean(),
        "right": safe[above_99].mean() if above_99.any() else np.nan,
    }


def worst_stratum(
    p: np.ndarray, claimed: np.ndarray, sites: PooledSites, least: int = 20
) -> tuple[float, str]:
    """Return the minimum Brier skill over classes of slope and cover, and its class.

    `claimed` (n,) selects the sites with a calibrated p. Classes with fewer than `least` safe or
    unsafe sites are ignored: their skill is undefined.
    """
    worst = (np.inf, "")
    k = claimed
    for i in range(len(SLOPES) - 1):
        for j in range(len(COVERS) - 1):
            s, c = sites.slope[k], sites.cover[k]
            inside = (s >= SLOPES[i]) & (s < SLOPES[i + 1])
            inside &= (c >= COVERS[j]) & (c < COVERS[j + 1])
            safe = sites.safe[k][inside]
            if min(safe.sum(), (~safe).sum()) < least:
                continue
            own = brier_skill(p[k][inside], safe)
            if own < worst[0]:
                worst = own, f"slope {SLOPES[i]:g}-{SLOPES[i + 1]:g}, {100 * COVERS[j]:g}+ %"
    return worst


@dataclass(frozen=True)
class HeldOutRow:
    """Predictions for a held-out row of the matrix by the fit without it.

    `p` (n,) is p_safe and `claimed` (n,) whether the value is calibrated; `name` is the relief,
    rock law, lander or range of the row.
    """

    name: str
    p: np.ndarray
    claimed: np.ndarray
    sites: PooledSites


def table_of(rows: list[HeldOutRow]) -> Table:
    """Return the table of calibration metrics of held-out rows of the matrix."""
    table = Table(
        title="Calibration on sites in the domain; each row evaluated with the fit without it"
    )

    def number(value: float, form: str) -> str:
        return format(value, form) if np.isfinite(value) else "-"

    for heading in ("held out", "sites", "in the domain\n(fraction)", "safe\n(fraction)", "ECE",
                    "ECE by chance\n(95th pct.)", "Brier\nskill", "p > 0.95\n(fraction)",
                    "bias (mean p\nminus safe)",
                    "p > 0.99\n(fraction)", "safe\n(fraction)", "not calibrated,\np > 0.5",
                    "mean p", "safe\n(fraction)",
                    "min skill\nof a stratum", "stratum"):  # fmt: skip
        table.add_column(heading, justify="right")
    for row in rows:
        p, k, sites = row.p, row.claimed, row.sites
        f = figures(p[k], sites.safe[k])
        out = ~k & (p > 0.5)
        own = [f"{v[out].mean():.3f}" if out.any() else "-" for v in (p, sites.safe)]
        least, where = worst_stratum(p, k, sites)
        table.add_row(
            row.name, f"{k.size}", f"{k.mean():.2f}", number(f["base"], ".3f"),
            number(f["ece"], ".4f"), number(f["chance"], ".4f"), number(f["skill"], "+.3f"),
            number(f["share"], ".2f"), number(f["gap"], "+.4f"), number(f["surer"], ".2f"),
            number(f["right"], ".4f"), f"{out.sum()}", *own, number(least, "+.2f"), where,
        )  # fmt: skip
    return table


def draw(rows: list[HeldOutRow], path: Path) -> None:
    """Plot predicted against observed safety on held-out scenes by matrix axis."""
    figure = new_figure(9.6, 9.6)
    for panel, axis in zip(
        figure.subplots(2, 2, sharex=True, sharey=True).ravel(),
        ("relief", "rocks", "lander", "range"), strict=True,
    ):  # fmt: skip
        plot_ideal(panel)
        mine = [r for r in rows if r.name.startswith(axis)]
        p = np.concatenate([r.p[r.claimed] for r in mine])
        safe = np.concatenate([r.sites.safe[r.claimed] for r in mine])
        table = reliability(p, safe)
        label = f"{len(mine)} rows, each held out; ECE {calibration_error(table):.3f}"
        plot_reliability(panel, table, color=COLOURS[0], label=label)
        panel.set_title(axis)
        panel.legend(loc="lower right")
        panel.grid(alpha=0.3)
        panel.set_xlabel("Probability of safety")
        panel.set_ylabel("Fraction truly safe")
    save(figure, path)


def options(count: int, own: str) -> Callable[[F], F]:
    """Return a decorator that adds the command-line options of a calibration study.

    `count` is the default number of scenes; `own` is the path of the model supplied with lunarsim.
    """
    first = click.IntRange(min=8)
    wanted = (
        click.option("--scenes", "count", type=first, default=count, show_default=True,
                     help="Number of scenes, spread evenly over the matrix."),
        click.option("--seed", type=click.IntRange(min=0), default=5, show_default=True,
                     help="Random seed of the scenes."),
        click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
                     help="Number of processes; does not change the results."),
        click.option("--scenes-file", "file", type=click.Path(path_type=Path, dir_okay=False),
                     default=None,
                     help="Scene cache (.npz): read if it exists, else written."),
        click.option("--save", "target", type=click.Path(path_type=Path, dir_okay=False),
                     default=None,
                     help=f"Output file of the model (supplied with lunarsim: {own})."),
        click.option("--out", "folder", type=click.Path(path_type=Path, file_okay=False),
                     default=None, help="Output folder of the reliability diagram."),
        click.option("--held-out-row", "row", type=click.Choice(tuple(_REPLACED)), default=None,
        metavar="ROW",
                     help="Evaluate one row ('rocks posts') on new scenes "
                     "with the fit without this row."),
        click.option("--new-scenes", "fresh", type=click.IntRange(min=1), default=120,
        show_default=True,
                     help="Number of new scenes for --held-out-row."),
    )  # fmt: skip

    def decorate(function: F) -> F:
        for option in reversed(wanted):
            function = option(function)
        return function

    return decorate


# Rows whose scenes are generated from other scenes by replacement of relief, rocks or lander.
_REPLACED = {
    f"{axis} {name}": {axis: name}
    for axis, names in (("relief", RELIEFS), ("rocks", ROCKS), ("lander", tuple(LANDERS)))
    for name in names
}


@dataclass(frozen=True)
class CalibrationMethod:
    """A mapper and the settings of its calibration study.

    Attributes
    ----------
    command
        Script that runs the study.
    evaluate, draw
        Functions that map and evaluate a scene, and that sample scenes (count, seed).
    rising
        Number of inputs, the last ones, with non-negative weights.
    farther, unsafe_limit
        Log-odds margin outside the calibrated domain; maximum probability of sites classified as
        certainly unsafe.
    """

    command: str
    evaluate: Callable[[LidarScene], SceneSites]
    draw: Callable[[int, int], list[LidarScene]]
    rising: int
    farther: float = NEAR_DOMAIN_LOG_ODDS_MARGIN
    unsafe_limit: float = ALMOST_CERTAINLY_UNSAFE_P

    def row(self, name: str, model: Ensemble, inside: list[SceneSites]) -> HeldOutRow:
        """Evaluate a model on the scenes of one scene type that its fit excluded.

        `name` is the scene type, for example "rocks posts"; `inside` are its evaluated scenes.
        """
        sites = PooledSites.of(inside)
        return HeldOutRow(name, *probability(model, sites, self.farther, self.unsafe_limit), sites)


def report(
    method: CalibrationMethod,
    evaluated: list[SceneSites],
    note: str,
    target: Path | None,
    folder: Path | None,
    jobs: int,
    console: Console,
) -> None:
    """Fit to all scenes and save the model; evaluate each row with the fit without it.

    `note` is stored in the model, `target` its file (None: not saved) and `folder` the file of the
    figure (None: no figure).
    """
    model = fit_model(evaluated, method.rising, note)
    if target is not None:
        model.save(target)
    left = list(held_out_rows(evaluated))
    fit = partial(fit_model, rising=method.rising, start=model)
    models = [
        model,
        *collect_results(fit, [others for _, others, _ in left], jobs, console, "fits"),
    ]
    kept = [("nothing", evaluated), *((name, inside) for name, _, inside in left)]
    rows = [
        method.row(name, own, inside)
        for (name, inside), own in zip(kept, models, strict=False)
    ]  # fmt: skip
    console.print(table_of(rows))
    rows = [row for row in rows if row.claimed.any()]
    if folder is not None:
        draw(rows, folder)


def evaluate_row(
    method: CalibrationMethod, evaluated: list[SceneSites], name: str, fresh: list[SceneSites]
) -> HeldOutRow:
    """Evaluate new scenes of a row with the fit to all scenes outside this row.

    `fresh` are the new scenes.
    """
    others = next((others for row, others, _ in held_out_rows(evaluated) if row == name), evaluated)
    return method.row(name, fit_model(others, method.rising), fresh)


def fresh_scenes(method: CalibrationMethod, name: str, count: int, seed: int) -> list[LidarScene]:
    """Sample new scenes of one row; none of them is in the matrix of the same seed."""
    changes: dict[str, Any] = _REPLACED[name]
    return [replace(scene, **changes) for scene in method.draw(count, seed + 1)]


def study(
    method: CalibrationMethod, *, count: int, seed: int, jobs: int, file: Path | None,
    target: Path | None,
    folder: Path | None, row: str | None, fresh: int,
) -> None:  # fmt: skip
    """Run a calibration study with the options of its command.

    `count` is the number of scenes, `file` their cache, `target` the output file of the model and
    `folder` that of the figure; `row` evaluates one row on `fresh` new scenes.
    """
    if row is not None and (target is not None or folder is not None):
        raise click.UsageError("--held-out-row: cannot be combined with --save or --out")
    console = plain_console(205)
    evaluated = evaluated_scenes(method.evaluate, method.draw(count, seed), file, jobs, console)
    evaluated = [j for j in evaluated if len(j.safe)]
    if row is not None:
        deck = fresh_scenes(method, row, fresh, seed)
        more = [
            j
            for j in collect_results(method.evaluate, deck, jobs, console, "scenes")
            if len(j.safe)
        ]
        console.print(table_of([evaluate_row(method, evaluated, row, more)]))
        return
    note = f"{method.command} --scenes {count} --seed {seed}"
    path = None if folder is None else folder / f"{Path(method.command).stem}.png"
    report(method, evaluated, note, target, path, jobs, console)


def draw_scenes(count: int, seed: int) -> list[LidarScene]:
    """Return scenes of all ranges; `count` is their number."""
    return list(scenes(count, seed))


@click.command()
@options(480, "lunarsim/safety/calibration.json")
def main(**wanted: Any) -> None:
    """Fit the safety probability of the Gaussian DEM; test it on held-out terrains."""
    study(
        CalibrationMethod(
            "scenarios/lidar_maps/calibration.py", judge, draw_scenes, MONOTONE_FEATURES
        ),
        **wanted,
    )


if __name__ == "__main__":
    main()
