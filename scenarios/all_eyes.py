"""All eyes on one descent: Gaussian DEM, quadtree, shadows, and the fused map, side by side.

Every flight carries all mappers at once, so that their maps are made of the same returns and
pictures of the same ground; all are judged on the same cells at the same moments. Fields of a row
differ in everything that is drawn; maps are compared field by field.

python scenarios/all_eyes.py --fields 3 --jobs 1 --json out/all_eyes.json --out out
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from lunarsim.campaign.pool import gathered
from lunarsim.evaluation.map_quality import MapQuality, local_ground
from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.evaluation.statistics import mean_interval
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.rng import Streams, flight_seed
from lunarsim.safety import exact_safety
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation, build_world
from lunarsim.whole_files import write_text_whole
from lunarsim.world import World

HERE = Path(__file__).parent
PRECISION = 0.99
SIZE, POSTING = 60.0, 0.25
# Half side of the quadtree's landing zone over that of the lander's footprint, as in its paper.
ZONE = 1.35
DROPPED = 0.5
DEAD_BELOW = 400.0
# Of the width of the picture. Chosen on one field of seed 1: with 30 deg the fused map gains at
# 300 m, with 45 and 60 rocks are too small there, and with 20 more pictures count as smeared.
VIEW_DEG = 30.0
MAPS = {"dem": "Gaussian DEM", "quadtree": "quadtree", "rocks": "shadows", "fused": "fused"}
COLOURS = {"dem": "tab:blue", "quadtree": "tab:cyan", "rocks": "tab:orange", "fused": "black"}
# Half spheres: those over 0.5 m are higher than the lander's limit, whichever way they are seen.
# The ground is wide enough to fill the pictures: those that show where it ends do not count.
_HALF: dict[str, Any] = {
    "terrain": {"size_m": 500.0},
    "rocks": {"shape": "hemisphere"},
    "expected_rocks": {"shape": "hemisphere"},
}
_HIRISE = _HALF | {
    "terrain": {
        "kind": "dtm", "posting_m": 0.5, "relief_scale": 0.2, "detail": False,
        "path": str(HERE / "data" / "hirise_dteec_010228_1490_crop.tif"),
    }
}  # fmt: skip
_HIGHLAND = {
    "terrain": {"preset": "highland", "rms_slope_deg": 4.0, "size_m": 500.0},
    "rocks": {"shape": "mixed", "cover": 0.04, "burial": [0.0, 0.5]},
    "expected_rocks": {"shape": "mixed", "cover": 0.04, "burial": [0.0, 0.5]},
}
# World and what fails; rows of the same world share it.
WORLDS: dict[str, dict[str, Any]] = {
    "level": _HALF,
    "HiRISE": _HIRISE,
    "highland": _HIGHLAND,
    "15 % cover": {
        name: table if name == "terrain" else table | {"cover": 0.15}
        for name, table in _HALF.items()
    },
    "Sun 5 deg": _HALF | {"sun": {"elevation_deg": 5.0}},
}
ROWS: dict[str, tuple[str, str]] = {
    "level, rocks": ("level", ""),
    "LiDAR with 50 % drop-outs": ("level", "drop-outs"),
    "camera dead from 400 m on": ("level", "dead camera"),
    "HiRISE, c = 0.2": ("HiRISE", ""),
    "cratered highland": ("highland", ""),
    "15 % cover": ("15 % cover", ""),
    "Sun at 5 deg": ("Sun 5 deg", ""),
}


@dataclass(frozen=True)
class Task:
    """One flight: a row's name, a field, the root seed, and where maps are judged, m."""

    row: str
    field: int
    seed: int
    altitudes: tuple[float, ...]


# --- a flight --------------------------------------------------------------------------------


def scenario_of(world: str, altitudes: tuple[float, ...]) -> Scenario:
    """Return the descent over a world, all mappers on board, a flash at every altitude judged."""
    base = Scenario.load(HERE / "two_eyes.toml").changed(**WORLDS[world])
    lander = base.vehicle.make()
    half = lander.leg_radius + 0.5 * lander.pad_diameter
    # Straight on along the way of the default start.
    top = max(altitudes) + 60.0
    rocks = base.expected_rocks
    # The least rock that is too high for the lander.
    ratio = {"hemisphere": 0.5, "cube": 1.0}.get(rocks.shape, rocks.height_ratio[0])
    return base.changed(
        start={"position_m": [-1.2 * top, 0.0, top], "position_sigma_m": 0.0},
        sensors={"camera": {"field_of_view_deg": VIEW_DEG}},
        tasking={
            # A flash a little before a map is judged.
            "flash": {"altitudes_m": [a + 15.0 for a in altitudes]},
            "camera": {"rate_hz": 2.0, "first_altitude_m": top},
        },
        mappers={
            "dem": {"size_m": SIZE, "posting_m": POSTING},
            "rocks": {
                "size_m": SIZE, "posting_m": POSTING,
                "hazard_diameter_m": lander.roughness_limit / ratio,
            },
            "quadtree": {
                "kind": "quadtree", "sensor": "flash", "size_m": SIZE, "posting_m": POSTING,
                "sites": {"zone_m": ZONE * half, "roughness_limit_m": lander.roughness_limit},
            },
        },
    )  # fmt: skip


@lru_cache(maxsize=1)
def world_of(world: str, seed: int) -> World:
    """Return a world."""
    return build_world(scenario_of(world, (100.0,)), Streams(seed))


def fly(task: Task) -> dict[str, Any]:
    """Fly once; return what each map was worth at each altitude, as JSON has it."""
    world, fails = ROWS[task.row]
    seed = flight_seed(task.seed, task.field)
    scenario = scenario_of(world, task.altitudes)
    simulation = Simulation(scenario, seed, "no-divert", world=world_of(world, seed))
    if fails == "drop-outs":
        for name in ("dem", "quadtree"):
            mapper = simulation.computer.mappers[name]
            mapper.update = dropping(mapper.update)  # type: ignore[method-assign]
    clock = Clock({name: simulation.computer.mappers[name] for name in MAPS})
    eye = simulation.computer.mappers["rocks"]
    judged: dict[str, Any] = {}
    waiting = sorted(task.altitudes, reverse=True)
    while waiting and not simulation.done:
        simulation.step()
        if fails == "dead camera" and simulation.altitude < DEAD_BELOW:
            cameras = zip(scenario.tasking, simulation.computer.tasking, strict=True)
            for part in (part for name, part in cameras if name == "camera"):
                part.stop()
        if simulation.altitude <= waiting[0]:
            judged[f"{waiting.pop(0):g}"] = judge(simulation)
    return {"row": task.row, "field": task.field, "maps": judged, "ms": clock.mean_ms(),
            "refused": {fault.value: count for fault, count in eye.refused.items()}}  # fmt: skip


class Clock:
    """Counts the time that each mapper works: what it asks of another is the other's.

    Parameters
    ----------
    mappers
        By name.
    """

    def __init__(self, mappers: dict[str, HazardMapper]) -> None:
        self._seconds = dict.fromkeys(mappers, 0.0)
        self._drawn: dict[str, dict[int, Any]] = {name: {} for name in mappers}
        self._inside = 0.0
        for name, mapper in mappers.items():
            for method in ("update", "refresh", "hazard_map", "evidence"):
                setattr(mapper, method, self._timed(name, getattr(mapper, method)))

    def _timed(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            began, others, self._inside = time.perf_counter(), self._inside, 0.0
            try:
                given = method(*args)
                if isinstance(given, HazardMap):
                    # Kept, so that no other is given its number.
                    self._drawn[name][id(given.p_safe)] = given.p_safe
                return given
            finally:
                whole = time.perf_counter() - began
                self._seconds[name] += whole - self._inside
                self._inside = others + whole

        return call

    def mean_ms(self) -> dict[str, float]:
        """Return the time of all that a mapper did, over the number of maps that it drew, ms."""
        return {n: 1e3 * s / max(len(self._drawn[n]), 1) for n, s in self._seconds.items()}


def dropping(update: Callable[..., None]) -> Callable[..., None]:
    """Return the method of a mapper, given scans of which half of the returns are lost."""

    def taken(scan: LidarScan, estimate: Any) -> None:
        # Drawn by the scan's own time: all mappers lose the same returns.
        lost = np.random.default_rng(round(1e3 * scan.time)).random(scan.range.shape) < DROPPED
        update(replace(scan, range=np.where(lost, np.nan, scan.range)), estimate)

    return taken


def judge(simulation: Simulation) -> dict[str, Any]:
    """Compare all maps as they stand with the truth, on the cells of the Gaussian DEM."""
    mappers = simulation.computer.mappers
    grid = mappers["dem"].hazard_map().grid
    ground = local_ground(simulation.world.terrain, grid, simulation.navigation_error)
    truth = exact_safety(ground, grid, simulation.lander)
    xy, safe = grid.centres()[truth.observed], truth.safe[truth.observed]
    return {name: _judged(mappers[name], xy, safe) for name in MAPS}


def _judged(mapper: Any, xy: np.ndarray, safe: np.ndarray) -> dict[str, Any]:
    """Return counts of one map at places (n, 2) that are safe or not (n,)."""
    drawn: HazardMap = mapper.hazard_map()
    p = drawn.p_safe_at(xy)
    claimed = _under(drawn, drawn.observed if drawn.in_domain is None else drawn.in_domain, xy)
    curve = PrecisionRecall.of(p, safe)
    c, s = p[claimed], safe[claimed].astype(np.float64)
    return {
        "unsafe": curve.unsafe.tolist(),
        "safe": curve.safe.tolist(),
        "table": reliability(c, s).tolist(),
        "squares": [float(c.size), float(s.sum()), float(((c - s) ** 2).sum())],
        "observed": float(_under(drawn, drawn.observed, xy).mean()),
    }


def _under(drawn: HazardMap, layer: np.ndarray, xy: np.ndarray) -> np.ndarray:
    g = drawn.grid
    row, col = g.cell(xy)
    found = layer[np.clip(row, 0, g.rows - 1), np.clip(col, 0, g.cols - 1)]
    return np.asarray(found & g.contains(xy))


# --- figures ---------------------------------------------------------------------------------


def recall_of(judged: list[dict[str, Any]]) -> float:
    """Return the recall at precision `PRECISION` of maps, their cells pooled."""
    return _curve(judged).recall_at(PRECISION)


def _curve(judged: list[dict[str, Any]]) -> PrecisionRecall:
    unsafe, safe = (np.sum([j[name] for j in judged], axis=0) for name in ("unsafe", "safe"))
    return PrecisionRecall(unsafe, safe)


def figures_of(judged: list[dict[str, Any]]) -> dict[str, float]:
    """Return the figures of one map over the fields."""
    curve = _curve(judged)
    quality: MapQuality = curve.at_half()
    unsafe = quality.false_safe + quality.rejected
    n, good, squares = np.sum([j["squares"] for j in judged], axis=0)
    base = good / n if n else float("nan")
    spread = base * (1.0 - base)
    return {
        "precision": quality.precision,
        "recall": quality.recall,
        "recall_at_precision": curve.recall_at(PRECISION),
        "missed_hazard": quality.false_safe / unsafe if unsafe else float("nan"),
        "ece": calibration_error(np.sum([j["table"] for j in judged], axis=0)),
        "skill": 1.0 - squares / n / spread if n and spread > 0.0 else float("nan"),
        "claimed": n / max(quality.judged, 1),
        "observed": float(np.mean([j["observed"] for j in judged])),
    }


def best_single(flights: list[dict[str, Any]], altitude: str) -> str:
    """Return the map other than the fused one with the greatest pooled recall at the precision."""
    of = {n: recall_of([f["maps"][altitude][n] for f in flights]) for n in MAPS if n != "fused"}
    return max(of, key=lambda name: of[name])


def gained(flights: list[dict[str, Any]], altitude: str, other: str) -> list[float]:
    """Return by how much the fused map's recall exceeds another's, field by field."""
    pairs = ((f["maps"][altitude]["fused"], f["maps"][altitude][other]) for f in flights)
    return [recall_of([a]) - recall_of([b]) for a, b in pairs]


def show(flights: list[dict[str, Any]], console: Console) -> None:
    """Print the figures of each row, altitude and map, and the fused map against the best other."""
    for row in dict.fromkeys(f["row"] for f in flights):
        mine = [f for f in flights if f["row"] == row]
        table = Table(title=f"{row}: {len(mine)} fields")
        for heading in ("altitude", "map", "precision", "recall", f"recall at {PRECISION}",
                        "hazard missed", "ECE", "skill", "claimed", "seen"):  # fmt: skip
            table.add_column(heading, justify="left" if heading == "map" else "right")
        for altitude in _common(mine):
            for name, words in MAPS.items():
                f = figures_of([one["maps"][altitude][name] for one in mine])
                table.add_row(
                    altitude, words, *(f"{f[key]:.3f}" for key in (
                        "precision", "recall", "recall_at_precision", "missed_hazard", "ece",
                        "skill", "claimed", "observed")),
                )  # fmt: skip
        console.print(table)
        spent = {n: float(np.median([one["ms"][n] for one in mine])) for n in MAPS}
        words = ", ".join(f"{MAPS[n]} {ms:.0f}" for n, ms in spent.items())
        console.print(f"ms a map drawn, all that it took counted: {words}")
        for altitude in _common(mine):
            best = best_single(mine, altitude)
            gain = mean_interval(gained(mine, altitude, best))
            console.print(
                f"{altitude} m: fused less {MAPS[best]}, recall at {PRECISION}: {gain.text(3)}"
            )


def _common(flights: list[dict[str, Any]]) -> list[str]:
    """Return the altitudes that all flights were judged at."""
    return [a for a in flights[0]["maps"] if all(a in f["maps"] for f in flights)]


def draw(flights: list[dict[str, Any]], path: Path) -> None:
    """Draw a panel a row: how much safe ground each map finds on the way down."""
    from matplotlib import pyplot as plt

    rows = list(dict.fromkeys(f["row"] for f in flights))
    figure, axes = plt.subplots(
        1, len(rows), figsize=(3.2 * len(rows) + 0.6, 3.4), sharey=True, squeeze=False
    )
    for axis, row in zip(axes[0], rows, strict=True):
        mine = [f for f in flights if f["row"] == row]
        altitudes = _common(mine)
        for name, words in MAPS.items():
            found = [recall_of([f["maps"][a][name] for f in mine]) for a in altitudes]
            axis.plot(
                range(len(altitudes)), found, "o-", color=COLOURS[name], label=words,
                lw=2.6 if name == "fused" else 1.4, zorder=3 if name == "fused" else 2,
            )  # fmt: skip
        axis.set_xticks(range(len(altitudes)), altitudes)
        axis.set_title(row, fontsize=10)
        axis.set_xlabel("altitude, m")
        axis.set_ylim(-0.03, 1.03)
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("safe ground found,\n1 in 100 called safe wrong")
    axes[0, -1].legend(fontsize=8, loc="best")
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plt.close(figure)


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=10, show_default=True,
              help="Fields a row.")  # fmt: skip
@click.option("--rows", default="all", show_default=True,
              help="Names of rows, semicolons between them.")  # fmt: skip
@click.option("--altitudes", default="1000,500,200,100", show_default=True,
              help="Where maps are judged, m.")  # fmt: skip
@click.option("--seed", type=int, default=1, show_default=True, help="Root seed.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Processes; results do not depend on it.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="File for the counts of every flight.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure.")  # fmt: skip
def main(
    fields: int,
    rows: str,
    altitudes: str,
    seed: int,
    jobs: int,
    json_file: Path | None,
    out: Path | None,
) -> None:
    """Fly the rows and print what each map is worth."""
    wanted = list(ROWS) if rows == "all" else [name.strip() for name in rows.split(";")]
    unknown = [name for name in wanted if name not in ROWS]
    if unknown:
        raise click.BadParameter(
            f"{unknown[0]!r}: not one of {'; '.join(ROWS)}", param_hint="--rows"
        )
    try:
        levels = tuple(float(a) for a in altitudes.split(","))
    except ValueError:
        levels = ()
    if not (levels and all(50.0 <= a <= 1500.0 for a in levels)):
        raise click.BadParameter(
            f"{altitudes!r}: metres from 50 to 1500, commas between them", param_hint="--altitudes"
        )
    # Rows of one world and field one after the other: it is built once.
    tasks = [Task(row, n, seed, levels) for n in range(fields) for row in wanted]
    console = Console(width=150)
    flights = gathered(fly, tasks, jobs, console, "flights")
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        settings = {"seed": seed, "altitudes": levels}
        write_text_whole(json_file, json.dumps({"settings": settings, "flights": flights}))
    show(flights, console)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        draw(flights, out / "all_eyes.png")


if __name__ == "__main__":
    main()
