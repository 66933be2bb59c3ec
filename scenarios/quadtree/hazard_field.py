"""A LiDAR sweeps a hazard field, finds its place on a map, and ranks landing sites meanwhile.

The experiment of the quadtree paper (section 5) on simulated fields: boulders and craters on level
grass, a Morpheus-like lander, 20 s of sweep. Sites are looked at 13 s and 20 s after the start.

python scenarios/quadtree/hazard_field.py --fields 30 --jobs 2 --out out/morpheus
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from lunarsim.campaign.pool import gathered
from lunarsim.evaluation.truth_mesh import TruthMesh, truth_hazards
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.grid import Grid
from lunarsim.onboard.guidance.jerk_limited import site_cost
from lunarsim.onboard.hazards.quadtree import STATUS, InterestMap, Selection
from lunarsim.onboard.navigation.lidar_inertial import LidarInertialFilter
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

HERE = Path(__file__).parent
TIMES = (13.0, 20.0)
# Posting of the truth DEM, m.
TRUTH = 0.1
# Section 5 of the paper, by eye from its text: it gives no areas.
PAPER = {
    "map error": "generally under 0.5 m",
    "slope error": "under 6 deg everywhere",
    "missed": "a couple of decimetre-scale areas",
    "false": "relatively large amounts of safe terrain",
    "zones": "none",
}


@dataclass(frozen=True)
class Task:
    """One field."""

    field: int
    seed: int
    hold: bool
    pictures: bool


def interest_map(grid: Grid) -> InterestMap:
    """Return an interest that is greatest in the north-east and nought in the south-west corner."""
    west, east, south, north = grid.extent
    coarse = Grid.centred((0.5 * (west + east), 0.5 * (south + north)), east - west, 5.0)
    centres = coarse.centres()
    far = np.hypot(centres[..., 0] - 0.7 * east, centres[..., 1] - 0.7 * north)
    value = np.clip(1.0 - far / (1.2 * (east - west)), 0.0, 1.0)
    corner = (centres[..., 0] < 0.7 * west) & (centres[..., 1] < 0.7 * south)
    return InterestMap(coarse, np.where(corner, 0.0, value))


def fly(task: Task) -> dict[str, Any]:
    """Fly the sweep over one field; return figures of merit, and maps for the pictures."""
    scenario = Scenario.load(HERE / "morpheus.toml")
    if not task.hold:
        sites = scenario.sites.model_copy(update={"hold_sigma_m": 1e9})
        scenario = scenario.model_copy(update={"sites": sites})
    simulation = Simulation(scenario, flight_seed(task.seed, task.field))
    eyes = simulation.eyes
    interest = interest_map(eyes.mapper.grid)
    eyes.mapper.selector.interest = interest
    pending, looks = list(TIMES), []
    track: list[tuple[float, ...]] = []
    while pending:
        simulation.step()
        track.append((simulation.time, *navigation_error(simulation), *deviations(eyes.filter)))
        if simulation.time >= pending[0] - 1e-9:
            looks.append(look(simulation, pending.pop(0), task.pictures))
    f = eyes.filter
    return {
        "field": task.field,
        "lock": next((e.time for e in f.events if e.name == "lock"), None),
        "events": [(e.time, e.name) for e in f.events],
        "position_error": list(track[-1][1:4]),
        "attitude_error": list(np.rad2deg(track[-1][4:7])),
        "position_sigma": list(track[-1][7:10]),
        "attitude_sigma": list(np.rad2deg(track[-1][10:13])),
        "points": eyes.mapper.map.count,
        "megabytes": eyes.mapper.map.nbytes / 1e6,
        "looks": looks,
        "track": np.array(track) if task.pictures else None,
    }


def navigation_error(simulation: Simulation) -> np.ndarray:
    """Return true less estimated position (m) and the small turn between (rad) (6,)."""
    inertial = simulation.eyes.filter.inertial
    turn = quat_multiply(quat_conjugate(inertial.attitude), simulation.state.attitude)
    return np.concatenate(
        (simulation.state.position - inertial.position, quat_to_rotation_vector(turn))
    )


def deviations(found: LidarInertialFilter) -> np.ndarray:
    """Return the standard deviations that go with `navigation_error` (6,)."""
    return np.sqrt(np.diag(found.covariance)[np.r_[0:3, 9:12]])


def look(simulation: Simulation, time: float, pictures: bool) -> dict[str, Any]:
    """Judge map and sites as they stand against the truth."""
    mapper = simulation.eyes.mapper
    selection = mapper.select()
    s = mapper.selector.settings
    # A lander that has not found its place maps the ground where it believes it to be.
    shift = np.zeros(3) if simulation.eyes.filter.found else -navigation_error(simulation)[:3]
    g = mapper.grid
    west, east, south, north = g.extent
    fine = Grid.centred((0.5 * (west + east), 0.5 * (south + north)), east - west, TRUTH)
    there = Grid(fine.x0 - shift[0], fine.y0 - shift[1], TRUTH, fine.rows, fine.cols)
    elevation = simulation.world.terrain.raster(there)
    hazard = truth_hazards(elevation, fine, 2.0 * s.zone, s.roughness_limit)
    mesh = TruthMesh(elevation, fine, 2.0 * s.zone)
    height = map_errors(simulation, elevation, fine, shift)
    slope = slope_errors(simulation, selection, mesh)
    confusion, estimated = confused(simulation, hazard, fine)
    cost = site_cost(
        simulation.estimate,
        np.array([site.position for site in selection.ranked]).reshape(-1, 3)
        + np.array([0.0, 0.0, simulation.lander.com_height]),
        simulation.scenario.gravity_m_s2,
        simulation.lander.exhaust_velocity,
        jerk=simulation.scenario.sites.jerk_m_s3,
        snap=simulation.scenario.sites.snap_m_s4,
    )
    exact = simulation.truth
    sites = [
        asdict(site)
        | {
            "position": list(site.position),
            "propellant": float(cost.propellant[i]),
            "increment": float(cost.increment[i]),
            "time_to_go": float(cost.time_to_go[i]),
            "hazard_m2": zone_hazard(site.position, hazard, fine, s.zone),
            "exactly_safe": bool(exact.safe_at(site.position[:2] - shift[:2])),
        }
        for i, site in enumerate(selection.ranked)
    ]
    maps = None
    if pictures:
        maps = {
            "elevation": elevation, "hazard": hazard, "estimated": estimated, "fine": fine,
            "height": height, "slope": slope, "selection": selection,
            "sizes": mapper.map.sizes(selection.nodes),
            "cells": cells_of(mapper.map), "interest": mapper.selector.interest,
            "zone": s.zone, "ratios": mapper.selector.ratios.copy(),
            "side": mapper.map.side, "centre": mapper.map.centre.copy(),
            "limit": s.exception_limit, "mapped": height[2] + height[3],
        }  # fmt: skip
    finite = height[2][np.isfinite(height[2])]
    angles = slope[np.isfinite(slope)]
    return {
        "time": time,
        "map_error_rms": float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan"),
        "map_error_within": float(np.mean(np.abs(finite) < 0.5)) if finite.size else float("nan"),
        "slope_error_max": float(angles.max()) if angles.size else float("nan"),
        "slope_error_mean": float(angles.mean()) if angles.size else float("nan"),
        "status": {STATUS[k]: int((selection.status == k).sum()) for k in range(len(STATUS))},
        **confusion,
        "sites": sites,
        "maps": maps,
    }


def map_errors(
    simulation: Simulation, elevation: np.ndarray, fine: Grid, shift: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return centres (n, 2), sides, elevation errors and true elevations (n,) of cells of 0.4 m."""
    quadtree = simulation.eyes.mapper.map
    nodes = quadtree.band(4.0 * quadtree.least, 8.0 * quadtree.least)
    xy, side = quadtree.centres(nodes), quadtree.sizes(nodes)
    truth = np.full(len(nodes), np.nan)
    for size in np.unique(side):
        n = round(size / fine.posting)
        mine = np.flatnonzero(side == size)
        row, col = fine.cell(xy[mine] - 0.5 * size + 0.5 * fine.posting)
        good = (row >= 0) & (col >= 0) & (row + n <= fine.rows) & (col + n <= fine.cols)
        rows = row[good, None] + np.arange(n)
        cols = col[good, None] + np.arange(n)
        truth[mine[good]] = elevation[rows[:, :, None], cols[:, None, :]].mean(axis=(1, 2))
    truth += shift[2]
    return xy, side, quadtree.elevation(nodes) - truth, truth


def slope_errors(simulation: Simulation, selection: Selection, mesh: TruthMesh) -> np.ndarray:
    """Return the angle between estimated and true normals at the sites (n,), deg; NaN off one."""
    estimated = simulation.eyes.mapper.selector.mesh.normals_of(selection.nodes)
    true, _ = mesh.plane(selection.position[:, :2])
    cosine = np.einsum("ij,ij->i", estimated, true)
    return np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))


def confused(
    simulation: Simulation, hazard: np.ndarray, fine: Grid
) -> tuple[dict[str, float], np.ndarray]:
    """Compare hazard cells with the truth; return areas (m^2) and the estimate (rows, cols).

    The estimate is NaN where cells have too few points: the paper's grey.
    """
    mapper = simulation.eyes.mapper
    ratios, tree = mapper.selector.ratios, mapper.map
    square = tree.side / len(ratios)
    corner = tree.centre[:2] - 0.5 * tree.side
    col = np.floor((fine.x - corner[0]) / square).astype(int)
    row = np.floor((fine.y - corner[1]) / square).astype(int)
    ratio = ratios[np.ix_(row, col)]
    estimated = np.where(np.isnan(ratio), np.nan, ratio > mapper.selector.settings.exception_limit)
    judged = np.isfinite(estimated) & np.isfinite(hazard)
    area = fine.posting**2
    called, true = estimated == 1.0, hazard == 1.0
    return {
        "judged_m2": float(judged.sum() * area),
        "hazard_m2": float((judged & true).sum() * area),
        "missed_m2": float((judged & true & ~called).sum() * area),
        "false_m2": float((judged & ~true & called).sum() * area),
    }, estimated


def zone_hazard(position: np.ndarray, hazard: np.ndarray, fine: Grid, zone: float) -> float:
    """Return the area of true hazard in a landing zone, m^2."""
    near = (np.abs(fine.x - position[0]) <= zone)[None, :] & (np.abs(fine.y - position[1]) <= zone)[
        :, None
    ]
    return float((hazard[near] == 1.0).sum() * fine.posting**2)


def cells_of(quadtree: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return centres (n, 2) and sides (n,) of the smallest cells down to the eighth division."""
    nodes = quadtree.band(quadtree.side / 2**8, quadtree.side)
    return quadtree.centres(nodes), quadtree.sizes(nodes)


def summarise(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of merit over all fields."""
    locked = [r for r in results if r["lock"] is not None]
    position = np.array([r["position_error"] for r in locked]).reshape(-1, 3)
    attitude = np.array([r["attitude_error"] for r in locked]).reshape(-1, 3)
    out: dict[str, Any] = {
        "fields": len(results),
        "locked": len(locked),
        "lock_time_median_s": float(np.median([r["lock"] for r in locked])) if locked else None,
        "position_rms_m": list(np.sqrt(np.mean(position**2, axis=0))),
        "attitude_rms_deg": list(np.sqrt(np.mean(attitude**2, axis=0))),
        "looks": [],
    }
    for k, time in enumerate(TIMES):
        looks = [r["looks"][k] for r in results]
        sites = [site for one in looks for site in one["sites"]]
        total = {key: sum(one[key] for one in looks) for key in
                 ("judged_m2", "hazard_m2", "missed_m2", "false_m2")}  # fmt: skip
        out["looks"].append({
            "time": time,
            "map_error_rms": float(np.nanmean([one["map_error_rms"] for one in looks])),
            "map_error_within": float(np.nanmean([one["map_error_within"] for one in looks])),
            "slope_error_mean": float(np.nanmean([one["slope_error_mean"] for one in looks])),
            "slope_error_max": float(np.nanmax([one["slope_error_max"] for one in looks])),
            **{key: value / len(looks) for key, value in total.items()},
            "sites": len(sites),
            "fields_without_site": sum(not one["sites"] for one in looks),
            "zones_with_hazard": sum(site["hazard_m2"] > 0.0 for site in sites),
            "sites_exactly_safe": sum(site["exactly_safe"] for site in sites),
        })  # fmt: skip
    return out


def show(summary: dict[str, Any], first: dict[str, Any], console: Console) -> None:
    """Print the tables."""
    n = summary["fields"]
    console.print(
        f"{summary['locked']} of {n} flights found their place on the map, the median after "
        f"{summary['lock_time_median_s']} s; then at 20 s, root mean square of each axis: position "
        + ", ".join(f"{v:.3f}" for v in summary["position_rms_m"])
        + " m, attitude "
        + ", ".join(f"{v:.3f}" for v in summary["attitude_rms_deg"])
        + " deg"
    )
    table = Table(title=f"Map and sites, mean of {n} fields")
    for heading in ("", "at 13 s", "at 20 s", "paper, at 20 s"):
        table.add_column(heading, justify="left" if heading in {"", "paper, at 20 s"} else "right")
    rows = (
        ("map error, root mean square (m)", "map_error_rms", "{:.3f}", PAPER["map error"]),
        ("cells with less than 0.5 m", "map_error_within", "{:.4f}", ""),
        ("slope error, mean (deg)", "slope_error_mean", "{:.2f}", ""),
        ("slope error, greatest of all (deg)", "slope_error_max", "{:.2f}", PAPER["slope error"]),
        ("ground judged (m2)", "judged_m2", "{:.0f}", ""),
        ("true hazards in it (m2)", "hazard_m2", "{:.1f}", ""),
        ("hazards missed (m2)", "missed_m2", "{:.2f}", PAPER["missed"]),
        ("safe ground called hazardous (m2)", "false_m2", "{:.0f}", PAPER["false"]),
        ("sites ranked, all fields", "sites", "{:d}", ""),
        ("fields without a site", "fields_without_site", "{:d}", ""),
        ("landing zones with a true hazard", "zones_with_hazard", "{:d}", PAPER["zones"]),
        ("sites exactly safe", "sites_exactly_safe", "{:d}", ""),
    )
    for label, key, form, paper in rows:
        table.add_row(label, *(form.format(one[key]) for one in summary["looks"]), paper)
    console.print(table)
    for one in first["looks"]:
        sites = Table(title=f"Field {first['field']}: sites at {one['time']:.0f} s")
        for heading in ("rank", "east (m)", "north (m)", "score", "interest", "slope (deg)",
                        "roughness (m)", "time-to-go (s)", "delta-v (m/s)",
                        "propellant (kg)"):  # fmt: skip
            sites.add_column(heading, justify="right")
        for rank, site in enumerate(one["sites"], 1):
            sites.add_row(
                str(rank), f"{site['position'][0]:.1f}", f"{site['position'][1]:.1f}",
                f"{site['score']:.2f}", f"{site['interest']:.2f}",
                f"{np.rad2deg(site['slope']):.2f}", f"{site['roughness']:.3f}",
                f"{site['time_to_go']:.1f}", f"{site['increment']:.0f}",
                f"{site['propellant']:.1f}",
            )  # fmt: skip
        console.print(sites)


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=1, show_default=True,
              help="Hazard fields.")  # fmt: skip
@click.option("--seed", type=int, default=1, show_default=True, help="Root seed.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Processes; results do not depend on it.")  # fmt: skip
@click.option("--hold/--no-hold", default=True, show_default=True,
              help="Let scans wait for the lock, or map them at once (the paper).")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Write all figures to this file.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for pictures of the first field; left out, none are drawn.")  # fmt: skip
def main(
    fields: int, seed: int, jobs: int, hold: bool, json_file: Path | None, out: Path | None
) -> None:
    """Sweep hazard fields and judge maps and sites against the truth."""
    console = Console(width=140)
    tasks = [Task(i, seed, hold, out is not None and i == 0) for i in range(fields)]
    results = gathered(fly, tasks, jobs, console, "sweeps")
    summary = summarise(results)
    show(summary, results[0], console)
    if json_file is not None:
        plain = [
            {k: v for k, v in r.items() if k not in {"looks", "track"}}
            | {"looks": [{k: v for k, v in one.items() if k != "maps"} for one in r["looks"]]}
            for r in results
        ]
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(
            json.dumps({"summary": summary, "flights": plain}, indent=1), encoding="utf-8"
        )
    if out is not None:
        from figures import draw_all

        draw_all(results[0], out)


if __name__ == "__main__":
    main()
