"""Fit the safety probability of the Gaussian DEM and test it on held-out terrains.

The script scans a matrix of terrains (relief, rocks, lander, range, angle, noise; `worlds.py`) and
fits the calibrated probability of `lunarsim.onboard.calibration` to all of them. The script then
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
from scene_cache import SceneSites, load_or_evaluate
from worlds import LANDERS, RANGES, RELIEFS, ROCKS, UPRIGHT, LidarScene, sample_matrix

from lunarsim import site_safety
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.reliability import (
    brier_skill,
    calibration_error,
    chance_calibration_error,
    reliability,
)
from lunarsim.onboard.calibration.conservative_probability import conservative_probability
from lunarsim.onboard.calibration.ensemble import Ensemble
from lunarsim.onboard.calibration.evidence import MapRegression
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import dem_site_evidence
from lunarsim.rocks.population import RockExpectation
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, new_figure, save

F = TypeVar("F", bound=Callable[..., Any])

SITES = 100  # evaluated sites per scene
# Edges of the strata: nominal slope / limit, and fraction of terrain above the roughness limit.
SLOPES = (0.0, 0.5, 0.85, 1.15, np.inf)
COVERS = (0.0, 0.002, 0.01, np.inf)


def evaluate_scene(scene: LidarScene, count: int = SITES) -> SceneSites:
    """Simulate a LiDAR scan of a scene; evaluate a random sample of `count` sites."""
    terrain, grid, lander = scene.terrain(), scene.grid(), LANDERS[scene.lander]
    pool = SamplePool(grid)
    scan, position = scene.simulate_scan(terrain)
    pool.add(scan.points(position, UPRIGHT), scan.height_sigma(UPRIGHT), scan.spacing(UPRIGHT))
    evidence = dem_site_evidence(pooled_dem(pool), lander, RockExpectation())
    sites = np.flatnonzero(evidence.observed)
    sites = scene.rng(4).choice(sites, min(count, len(sites)), replace=False)
    where = np.zeros(grid.shape, bool)
    where.ravel()[sites] = True
    safe, where = site_safety(terrain, grid, lander, where=where)
    return SceneSites.of(scene, evidence, where, safe[where])


@dataclass(frozen=True)
class PooledSites:
    """Landing sites of many scenes: the arrays of `SceneSites`, concatenated (n, ...)."""

    features: np.ndarray
    known: np.ndarray
    observed_terrain_bound: np.ndarray
    outside_domain_bound: np.ndarray
    slope: np.ndarray
    may_be_claimed_unsafe: np.ndarray
    rough_fraction: np.ndarray
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
                "may_be_claimed_unsafe",
            )
        ]
        rough_fraction = np.concatenate([np.full(len(j.safe), j.rough_fraction) for j in evaluated])
        return cls(*columns, rough_fraction, np.concatenate([j.safe for j in evaluated]))


def fit_model(
    evaluated: list[SceneSites],
    regression: MapRegression = GAUSSIAN_DEM,
    note: str = "",
    initial: Ensemble | None = None,
) -> Ensemble:
    """Fit the calibrated safety probability to the sites in its domain.

    The result is an ensemble: one model for all sites, and one without each kind of relief, rocks,
    lander and range. `regression` declares the features; `note` is stored in the model; `initial`
    is an ensemble whose weights start the iteration.
    """
    s = PooledSites.of(evaluated)
    number = np.repeat(np.arange(len(evaluated)), [len(j.safe) for j in evaluated])[s.known]
    worlds = {
        f"{axis} {name}": np.array([of(j.scene) == name for j in evaluated])[number]
        for axis, names, of in AXES
        for name in names
    }
    x, y = s.features[s.known], s.safe[s.known]
    return Ensemble.fit(x, y, worlds, note, rising=regression.monotone_count, start=initial)


def predict_safety(
    model: Ensemble, sites: PooledSites, regression: MapRegression = GAUSSIAN_DEM
) -> tuple[np.ndarray, np.ndarray]:
    """Return p_safe of sites by a model, and whether each value is calibrated (n,).

    `regression` declares the margin outside the domain and the threshold of unsafe sites.
    """
    odds = model.evaluate_features(sites.features)
    p = conservative_probability(
        odds.low,
        sites.observed_terrain_bound,
        sites.outside_domain_bound,
        sites.known,
        regression.outside_margin,
    )
    return p, sites.known & odds.estimate(
        sites.observed_terrain_bound, regression.max_unsafe_p, sites.may_be_claimed_unsafe
    ).agreed


def nearest_range(scene: LidarScene) -> str:
    """Return the value of `RANGES` nearest to the range of a scene, as text ("120 m")."""
    return f"{RANGES[int(np.argmin(np.abs(np.log(np.divide(RANGES, scene.distance)))))]:.0f} m"


AXES: tuple[tuple[str, tuple[str, ...], Callable[[LidarScene], str]], ...] = (
    ("relief", RELIEFS, lambda s: s.relief),
    ("rocks", ROCKS, lambda s: s.rocks),
    ("lander", tuple(LANDERS), lambda s: s.lander),
    ("range", tuple(f"{r:.0f} m" for r in RANGES), nearest_range),
)


def split_by_scene_type(
    evaluated: list[SceneSites],
) -> Iterator[tuple[str, list[SceneSites], list[SceneSites]]]:
    """Yield each scene type: its name, all other scenes, and its scenes.

    A scene type is one relief, rock law, lander or range. Types without scenes are skipped.
    """
    for axis, names, of in AXES:
        for name in names:
            inside = [of(j.scene) == name for j in evaluated]
            others = [j for j, i in zip(evaluated, inside, strict=True) if not i]
            kept = [j for j, i in zip(evaluated, inside, strict=True) if i]
            if kept and others:
                yield f"{axis} {name}", others, kept


FIGURES = ("base", "ece", "chance", "skill", "share", "gap", "surer", "right")


def calibration_metrics(p: np.ndarray, safe: np.ndarray) -> dict[str, float]:
    """Return the metrics `FIGURES` of probabilities `p` against true safety (n,).

    "base": safe fraction; "ece": calibration error; "chance": its 95th percentile by chance;
    "skill": Brier skill; "share", "gap": fraction of sites with p above 0.95, and their mean p
    minus safe fraction; "surer", "right": fraction of sites with p above 0.99, and their safe
    fraction. A metric without sites is NaN.
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
    p: np.ndarray, is_calibrated: np.ndarray, sites: PooledSites, min_sites: int = 20
) -> tuple[float, str]:
    """Return the minimum Brier skill over classes of slope and rocks, and its class.

    The classes are those of `SLOPES` (nominal slope over its limit) and `COVERS` (fraction of
    terrain above the roughness limit). `is_calibrated` (n,) selects the sites with a calibrated p.
    Classes with fewer than `min_sites` safe sites or fewer than `min_sites` unsafe sites are
    skipped; if all are, the result is infinity and "".
    """
    worst = (np.inf, "")
    k = is_calibrated
    for i in range(len(SLOPES) - 1):
        for j in range(len(COVERS) - 1):
            s, c = sites.slope[k], sites.rough_fraction[k]
            inside = (s >= SLOPES[i]) & (s < SLOPES[i + 1])
            inside &= (c >= COVERS[j]) & (c < COVERS[j + 1])
            safe = sites.safe[k][inside]
            if min(safe.sum(), (~safe).sum()) < min_sites:
                continue
            own = brier_skill(p[k][inside], safe)
            if own < worst[0]:
                worst = own, f"slope {SLOPES[i]:g}-{SLOPES[i + 1]:g}, {100 * COVERS[j]:g}+ %"
    return worst


@dataclass(frozen=True)
class HeldOutPrediction:
    """Predicted safety of the sites of one scene type by a fit that excluded it.

    `p` (n,) is p_safe and `is_calibrated` (n,) whether the value is calibrated; `name` is the scene
    type, that is, a relief, rock law, lander or range.
    """

    name: str
    p: np.ndarray
    is_calibrated: np.ndarray
    sites: PooledSites


def table_of(rows: list[HeldOutPrediction]) -> Table:
    """Return the table of calibration metrics by held-out scene type."""
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
        p, k, sites = row.p, row.is_calibrated, row.sites
        f = calibration_metrics(p[k], sites.safe[k])
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


def draw(rows: list[HeldOutPrediction], path: Path) -> None:
    """Plot predicted against observed safety on held-out scenes.

    The panels show all reliefs, all rock laws, all landers and all ranges.
    """
    figure = new_figure(9.6, 9.6)
    for panel, axis in zip(
        figure.subplots(2, 2, sharex=True, sharey=True).ravel(),
        ("relief", "rocks", "lander", "range"), strict=True,
    ):  # fmt: skip
        plot_ideal(panel)
        mine = [r for r in rows if r.name.startswith(axis)]
        p = np.concatenate([r.p[r.is_calibrated] for r in mine])
        safe = np.concatenate([r.sites.safe[r.is_calibrated] for r in mine])
        table = reliability(p, safe)
        label = f"{len(mine)} rows, each held out; ECE {calibration_error(table):.3f}"
        # No line: nothing is claimed between the bins near 0 and those above 0.95.
        plot_reliability(panel, table, color=COLOURS[0], label=label, ls="none")
        panel.set_title(axis)
        panel.legend(loc="lower right")
        panel.grid(alpha=0.3)
        panel.set_xlabel("Probability of safety")
        panel.set_ylabel("Fraction truly safe")
    save(figure, path)


def options(default_count: int, supplied_model: str) -> Callable[[F], F]:
    """Return a decorator that adds the command-line options of a calibration study.

    `default_count` is the default number of scenes; `supplied_model` is the path of the model in
    lunarsim.
    """
    first = click.IntRange(min=8)
    wanted = (
        click.option("--scenes", "count", type=first, default=default_count, show_default=True,
                     help="Number of simulated scenes, spread evenly over all kinds of terrain, "
                     "lander, range, angle and noise."),
        click.option("--seed", type=click.IntRange(min=0), default=5, show_default=True,
                     help="Random seed of the simulated scenes."),
        click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
                     help="Number of parallel processes; it does not change the results."),
        click.option("--scenes-file", type=click.Path(path_type=Path, dir_okay=False),
                     default=None,
                     help="File of the evaluated scenes (.npz): read if it exists, otherwise "
                     "written. Default: none."),
        click.option("--save", "model_file", type=click.Path(path_type=Path, dir_okay=False),
                     default=None,
                     help=f"Output file of the model (supplied with lunarsim: {supplied_model})."),
        click.option("--out", "figure_folder", type=click.Path(path_type=Path, file_okay=False),
                     default=None, help="Folder for the reliability diagram. Default: no diagram."),
        click.option("--held-out-row", "scene_type", type=click.Choice(tuple(_REPLACED)),
                     default=None, metavar="ROW",
                     help="Fit without one kind of scene, named by the row of the results table "
                     "(for example 'rocks posts'), and evaluate the fit on new scenes of this "
                     "kind."),
        click.option("--new-scenes", "new_count", type=click.IntRange(min=1), default=120,
        show_default=True,
                     help="Number of new scenes that --held-out-row evaluates."),
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
    evaluate, sample
        Function that maps and evaluates a scene; function of count and seed that samples scenes.
    regression
        Declaration of the calibrated probability of the mapper.
    """

    command: str
    evaluate: Callable[[LidarScene], SceneSites]
    sample: Callable[[int, int], list[LidarScene]]
    regression: MapRegression

    def predict_held_out(
        self, name: str, model: Ensemble, scenes: list[SceneSites]
    ) -> HeldOutPrediction:
        """Predict the safety of the sites of a scene type with a fit that excluded it.

        `name` is the scene type, for example "rocks posts"; `scenes` are its evaluated scenes.
        """
        sites = PooledSites.of(scenes)
        return HeldOutPrediction(name, *predict_safety(model, sites, self.regression), sites)


def report(
    method: CalibrationMethod,
    evaluated: list[SceneSites],
    note: str,
    model_file: Path | None,
    figure_file: Path | None,
    jobs: int,
    console: Console,
) -> None:
    """Fit and save the model; evaluate each scene type with a fit that excludes it.

    `note` is stored in the model. Without `model_file` or `figure_file`, the model is not saved or
    the figure not plotted.
    """
    model = fit_model(evaluated, method.regression, note)
    if model_file is not None:
        model.save(model_file)
    left = list(split_by_scene_type(evaluated))
    fit = partial(fit_model, regression=method.regression, initial=model)
    models = [
        model,
        *collect_results(fit, [others for _, others, _ in left], jobs, console, "fits"),
    ]
    kept = [("nothing", evaluated), *((name, inside) for name, _, inside in left)]
    rows = [
        method.predict_held_out(name, own, inside)
        for (name, inside), own in zip(kept, models, strict=False)
    ]  # fmt: skip
    console.print(table_of(rows))
    rows = [row for row in rows if row.is_calibrated.any()]
    if figure_file is not None:
        draw(rows, figure_file)


def evaluate_scene_type(
    method: CalibrationMethod, evaluated: list[SceneSites], name: str, new_scenes: list[SceneSites]
) -> HeldOutPrediction:
    """Predict the safety of new scenes of a type with a fit that excludes this type.

    `name` is the scene type; `new_scenes` are its evaluated new scenes.
    """
    others = next(
        (others for row, others, _ in split_by_scene_type(evaluated) if row == name), evaluated
    )
    return method.predict_held_out(name, fit_model(others, method.regression), new_scenes)


def sample_new_scenes(
    method: CalibrationMethod, name: str, count: int, seed: int
) -> list[LidarScene]:
    """Sample scenes of one type; none of them is in the study matrix of this seed.

    `name` is the scene type.
    """
    changes: dict[str, Any] = _REPLACED[name]
    return [replace(scene, **changes) for scene in method.sample(count, seed + 1)]


def study(
    method: CalibrationMethod, *, count: int, seed: int, jobs: int, scenes_file: Path | None,
    model_file: Path | None,
    figure_folder: Path | None, scene_type: str | None, new_count: int,
) -> None:  # fmt: skip
    """Run a calibration study with the options of its command.

    `count` is the number of scenes and `scenes_file` their cache. With `scene_type`, only this type
    is evaluated, on `new_count` new scenes.
    """
    if scene_type is not None and (model_file is not None or figure_folder is not None):
        raise click.UsageError("--held-out-row: cannot be combined with --save or --out")
    console = plain_console(205)
    evaluated = load_or_evaluate(
        method.evaluate, method.sample(count, seed), scenes_file, jobs, console
    )
    evaluated = [j for j in evaluated if len(j.safe)]
    if scene_type is not None:
        deck = sample_new_scenes(method, scene_type, new_count, seed)
        more = [
            j
            for j in collect_results(method.evaluate, deck, jobs, console, "scenes")
            if len(j.safe)
        ]
        console.print(table_of([evaluate_scene_type(method, evaluated, scene_type, more)]))
        return
    note = f"{method.command} --scenes {count} --seed {seed}"
    path = None if figure_folder is None else figure_folder / f"{Path(method.command).stem}.png"
    report(method, evaluated, note, model_file, path, jobs, console)


def sample_scenes(count: int, seed: int) -> list[LidarScene]:
    """Return `count` scenes with all reliefs, rock laws, landers and ranges."""
    return list(sample_matrix(count, seed))


@click.command()
@options(480, "lunarsim/onboard/calibration/gaussian_dem.json")
def main(**values: Any) -> None:
    """Fit the safety probability of the Gaussian DEM; test it on held-out terrains."""
    study(
        CalibrationMethod(
            "scenarios/lidar_maps/calibration.py", evaluate_scene, sample_scenes, GAUSSIAN_DEM
        ),
        **values,
    )


if __name__ == "__main__":
    main()
