"""How often sites are safe that the Gaussian DEM calls so: the fit, and worlds kept out of it.

Scans a matrix of worlds (relief, rocks, lander, range, angle, noise; `worlds.py`), fits the
calibrated probability of `lunarsim.safety.calibration` to all of them, and then once more without
each relief, each rock law, each lander and each range, to judge it on what it has not seen. A fit
is an ensemble: to its worlds, and without each of them.

python scenarios/lidar_maps/calibration.py --scenes 480 --jobs 2 --out out/lidar_maps

With --row one row alone is judged, on more scenes of it than the matrix has:

python scenarios/lidar_maps/calibration.py --scenes 480 --row "rocks posts" --fresh 200
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import click
import numpy as np
from kept import Judged, judged_scenes
from rich.console import Console
from rich.table import Table
from worlds import LANDERS, RANGES, RELIEFS, ROCKS, UPRIGHT, Scene, scenes

from lunarsim.campaign.pool import gathered
from lunarsim.console import plain_console
from lunarsim.evaluation.reliability import (
    brier_skill,
    calibration_error,
    calibration_error_by_chance,
    reliability,
)
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.drawn import evidence_of
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import exact_safety
from lunarsim.safety.calibration import (
    FARTHER,
    RISING,
    bound,
    ceiling,
    clear_of_pads,
    features,
    in_domain,
)
from lunarsim.safety.ensemble import HOPELESS, Ensemble, cautious
from lunarsim.viz.reliability import plot_ideal, plot_reliability
from lunarsim.viz.style import COLOURS, new_figure, save

F = TypeVar("F", bound=Callable[..., Any])

SITES = 100  # judged of each scene
# Edges of the strata: nominal slope over the limit, and share of ground above the limit.
SLOPES = (0.0, 0.5, 0.85, 1.15, np.inf)
COVERS = (0.0, 0.002, 0.01, np.inf)


def judge(scene: Scene) -> Judged:
    """Scan one scene and judge some of its sites."""
    terrain, grid, lander = scene.terrain(), scene.grid(), LANDERS[scene.lander]
    pool = SamplePool(grid)
    scan, position = scene.flash(terrain)
    pool.add(scan.points(position, UPRIGHT), scan.height_sigma(UPRIGHT), scan.spacing(UPRIGHT))
    evidence = evidence_of(pooled_dem(pool), lander, RockExpectation())
    truth = exact_safety(terrain.raster(grid), grid, lander)
    sites = np.flatnonzero(evidence.observed & truth.observed)
    sites = scene.rng(4).choice(sites, min(SITES, len(sites)), replace=False)
    where = np.zeros(grid.shape, bool)
    where.ravel()[sites] = True
    return Judged(
        scene,
        features(evidence, where).astype(np.float32),
        in_domain(evidence)[where],
        np.minimum(ceiling(evidence), clear_of_pads(evidence))[where],
        bound(evidence)[where],
        evidence.slope[where],
        np.ones(np.count_nonzero(where), bool),
        float(evidence.curve.at(lander.roughness_limit)),
        truth.safe[where],
    )


@dataclass(frozen=True)
class Sites:
    """Sites of many scenes, end to end (n, ...)."""

    features: np.ndarray
    known: np.ndarray
    ceiling: np.ndarray
    bound: np.ndarray
    slope: np.ndarray
    doomed: np.ndarray
    cover: np.ndarray
    safe: np.ndarray

    @classmethod
    def of(cls, judged: list[Judged]) -> Sites:
        """Put scenes end to end."""
        columns = [
            np.concatenate([getattr(j, name) for j in judged])
            for name in ("features", "known", "ceiling", "bound", "slope", "doomed")
        ]
        cover = np.concatenate([np.full(len(j.safe), j.cover) for j in judged])
        return cls(*columns, cover, np.concatenate([j.safe for j in judged]))


def fitted(
    judged: list[Judged], rising: int = RISING, note: str = "", start: Ensemble | None = None
) -> Ensemble:
    """Fit to the sites that may lie in the domain, and without each world; see `Ensemble.fit`."""
    s = Sites.of(judged)
    number = np.repeat(np.arange(len(judged)), [len(j.safe) for j in judged])[s.known]
    worlds = {
        f"{axis} {name}": np.array([of(j.scene) == name for j in judged])[number]
        for axis, names, of in AXES
        for name in names
    }
    x, y = s.features[s.known], s.safe[s.known]
    return Ensemble.fit(x, y, worlds, note, rising=rising, start=start)


def probability(
    model: Ensemble, sites: Sites, farther: float = FARTHER, hopeless: float = HOPELESS
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the map would say of all sites, and where it claims a frequency (n,).

    `farther` is the margin of the log odds where it does not; sites are surely not safe up to
    `hopeless`.
    """
    odds = model.of_features(sites.features)
    p = cautious(odds.low, sites.ceiling, sites.bound, sites.known, farther)
    return p, sites.known & odds.verdict(sites.ceiling, hopeless, sites.doomed).agreed


def nearest_range(scene: Scene) -> str:
    """Return the range of the matrix that a scene belongs to."""
    return f"{RANGES[int(np.argmin(np.abs(np.log(np.divide(RANGES, scene.distance)))))]:.0f} m"


AXES: tuple[tuple[str, tuple[str, ...], Callable[[Scene], str]], ...] = (
    ("relief", RELIEFS, lambda s: s.relief),
    ("rocks", ROCKS, lambda s: s.rocks),
    ("lander", tuple(LANDERS), lambda s: s.lander),
    ("range", tuple(f"{r:.0f} m" for r in RANGES), nearest_range),
)


def left_out(judged: list[Judged]) -> Iterator[tuple[str, list[Judged], list[Judged]]]:
    """Yield the name of a row of the matrix, the scenes outside of it and those in it."""
    for axis, names, of in AXES:
        for name in names:
            inside = [of(j.scene) == name for j in judged]
            others = [j for j, i in zip(judged, inside, strict=True) if not i]
            kept = [j for j, i in zip(judged, inside, strict=True) if i]
            if kept and others:
                yield f"{axis} {name}", others, kept


FIGURES = ("base", "ece", "chance", "skill", "share", "gap", "surer", "right")


def figures(p: np.ndarray, safe: np.ndarray) -> dict[str, float]:
    """Return how well probabilities (n,) tell what is safe (n,): `FIGURES`, NaN of none."""
    if not p.size:
        return dict.fromkeys(FIGURES, np.nan)
    base = safe.mean()
    sure, surer = p > 0.95, p > 0.99
    return {
        "base": base,
        "ece": calibration_error(reliability(p, safe)),
        "chance": calibration_error_by_chance(p, np.random.default_rng(0)),
        "skill": brier_skill(p, safe),
        "share": sure.mean(),
        "gap": p[sure].mean() - safe[sure].mean() if sure.any() else np.nan,
        "surer": surer.mean(),
        "right": safe[surer].mean() if surer.any() else np.nan,
    }


def worst_stratum(
    p: np.ndarray, claimed: np.ndarray, sites: Sites, least: int = 20
) -> tuple[float, str]:
    """Return the least Brier skill of the strata of slope and cover with enough sites.

    Only where some sites are safe and some are not: else there is no skill to be had.
    """
    worst = (np.inf, "")
    k = claimed
    for i in range(len(SLOPES) - 1):
        for j in range(len(COVERS) - 1):
            s, c = sites.slope[k], sites.cover[k]
            inside = (s >= SLOPES[i]) & (s < SLOPES[i + 1])
            inside &= (c >= COVERS[j]) & (c < COVERS[j + 1])
            safe = sites.safe[k][inside]
            # At least so many of either kind.
            if min(safe.sum(), (~safe).sum()) < least:
                continue
            own = brier_skill(p[k][inside], safe)
            if own < worst[0]:
                worst = own, f"slope {SLOPES[i]:g}-{SLOPES[i + 1]:g}, {100 * COVERS[j]:g}+ %"
    return worst


@dataclass(frozen=True)
class Row:
    """A row of the matrix: what the fit without it says of its sites, and where it claims that."""

    name: str
    p: np.ndarray
    claimed: np.ndarray
    sites: Sites


def table_of(rows: list[Row]) -> Table:
    """Return the figures of rows of the matrix."""
    table = Table(title="Sites in the domain; each row judged by the fit without it")

    def number(value: float, form: str) -> str:
        return format(value, form) if np.isfinite(value) else "-"

    for heading in ("kept out", "sites", "in the\ndomain", "share\nsafe", "ECE",
                    "by chance\n(95 %)", "Brier\nskill", "p > 0.95", "mean p less\nshare safe",
                    "p > 0.99", "share\nsafe", "not claimed,\np > 0.5", "mean p", "share\nsafe",
                    "least skill\nof a stratum", "where"):  # fmt: skip
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


def draw(rows: list[Row], path: Path) -> None:
    """Draw the reliability of what was kept out, by axis of the matrix."""
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
        label = f"{len(mine)} kept out in turn, ECE {calibration_error(table):.3f}"
        plot_reliability(panel, table, color=COLOURS[0], label=label)
        panel.set_title(axis)
        panel.legend(loc="lower right")
        panel.grid(alpha=0.3)
        panel.set_xlabel("probability of safety")
        panel.set_ylabel("share exactly safe")
    save(figure, path)


def options(count: int, own: str) -> Callable[[F], F]:
    """Return the options of a calibration: how many scenes, and the file of the package's model."""
    first = click.IntRange(min=8)
    wanted = (
        click.option("--scenes", "count", type=first, default=count, show_default=True,
                     help="Scenes, drawn evenly from the matrix."),
        click.option("--seed", type=click.IntRange(min=0), default=5, show_default=True,
                     help="Of the scenes."),
        click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
                     help="Processes; results do not depend on it."),
        click.option("--scenes-file", "file", type=click.Path(path_type=Path, dir_okay=False),
                     default=None,
                     help="Scenes are read from this .npz file; if there is none, written to it."),
        click.option("--save", "target", type=click.Path(path_type=Path, dir_okay=False),
                     default=None,
                     help=f"Write the model to this file; the package's own is {own}."),
        click.option("--out", "picture", type=click.Path(path_type=Path, file_okay=False),
                     default=None, help="Folder for the diagram."),
        click.option("--row", type=click.Choice(tuple(_REPLACED)), default=None, metavar="ROW",
                     help="Judge this row alone ('rocks posts', 'relief pits', 'lander small'), by "
                     "the fit without it, on scenes that are in no fit."),
        click.option("--fresh", type=click.IntRange(min=1), default=120, show_default=True,
                     help="Scenes that --row is judged on."),
    )  # fmt: skip

    def decorate(function: F) -> F:
        for option in reversed(wanted):
            function = option(function)
        return function

    return decorate


# Rows that scenes of any other become by a part of theirs replaced.
_REPLACED = {
    f"{axis} {name}": {axis: name}
    for axis, names in (("relief", RELIEFS), ("rocks", ROCKS), ("lander", tuple(LANDERS)))
    for name in names
}


@dataclass(frozen=True)
class Method:
    """A map and its probability.

    Attributes
    ----------
    command
        That fits and judges it.
    judge, draw
        Map and judge a scene; draw so many scenes by a seed.
    rising, farther, hopeless
        As for `fitted` and `probability`.
    """

    command: str
    judge: Callable[[Scene], Judged]
    draw: Callable[[int, int], list[Scene]]
    rising: int
    farther: float = FARTHER
    hopeless: float = HOPELESS

    def row(self, name: str, model: Ensemble, inside: list[Judged]) -> Row:
        """Return what a model says of scenes."""
        sites = Sites.of(inside)
        return Row(name, *probability(model, sites, self.farther, self.hopeless), sites)


def report(
    method: Method,
    judged: list[Judged],
    note: str,
    target: Path | None,
    picture: Path | None,
    jobs: int,
    console: Console,
) -> None:
    """Fit to all scenes and write that model; judge every row of the matrix by a fit without it."""
    model = fitted(judged, method.rising, note)
    if target is not None:
        model.save(target)
    left = list(left_out(judged))
    fit = partial(fitted, rising=method.rising, start=model)
    models = [model, *gathered(fit, [others for _, others, _ in left], jobs, console, "fits")]
    kept = [("nothing", judged), *((name, inside) for name, _, inside in left)]
    rows = [
        method.row(name, own, inside)
        for (name, inside), own in zip(kept, models, strict=False)
    ]  # fmt: skip
    console.print(table_of(rows))
    rows = [row for row in rows if row.claimed.any()]
    if picture is not None:
        draw(rows, picture)


def judged_again(method: Method, judged: list[Judged], name: str, fresh: list[Judged]) -> Row:
    """Judge fresh scenes of a row of the matrix by the fit to all scenes that are not of it."""
    others = next((others for row, others, _ in left_out(judged) if row == name), judged)
    return method.row(name, fitted(others, method.rising), fresh)


def fresh_scenes(method: Method, name: str, count: int, seed: int) -> list[Scene]:
    """Draw scenes of a row; the matrix of the same seed has none of them."""
    changes: dict[str, Any] = _REPLACED[name]
    return [replace(scene, **changes) for scene in method.draw(count, seed + 1)]


def study(
    method: Method, *, count: int, seed: int, jobs: int, file: Path | None, target: Path | None,
    picture: Path | None, row: str | None, fresh: int,
) -> None:  # fmt: skip
    """Do what the options of a calibration ask for."""
    if row is not None and (target is not None or picture is not None):
        raise click.UsageError("--row judges one row: it saves no model and draws no diagram")
    console = plain_console(205)
    judged = judged_scenes(method.judge, method.draw(count, seed), file, jobs, console)
    judged = [j for j in judged if len(j.safe)]
    if row is not None:
        deck = fresh_scenes(method, row, fresh, seed)
        more = [j for j in gathered(method.judge, deck, jobs, console, "scenes") if len(j.safe)]
        console.print(table_of([judged_again(method, judged, row, more)]))
        return
    note = f"{method.command} --scenes {count} --seed {seed}"
    path = None if picture is None else picture / f"{Path(method.command).stem}.png"
    report(method, judged, note, target, path, jobs, console)


def drawn(count: int, seed: int) -> list[Scene]:
    """Return scenes of all ranges."""
    return list(scenes(count, seed))


@click.command()
@options(480, "lunarsim/safety/calibration.json")
def main(**wanted: Any) -> None:
    """Fit the calibrated probability, and judge it on worlds kept out of the fit."""
    study(Method("scenarios/lidar_maps/calibration.py", judge, drawn, RISING), **wanted)


if __name__ == "__main__":
    main()
