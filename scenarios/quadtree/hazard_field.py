"""Sweep a hazard field by LiDAR, locate it on a map, and rank landing sites.

The experiment of the quadtree paper (section 5) on simulated fields: boulders and craters on
horizontal grass, a Morpheus-like vehicle, a sweep of 20 s. Sites are evaluated 13 s and 20 s after
the start.

python scenarios/quadtree/hazard_field.py --fields 30 --jobs 2 --out out/morpheus
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table
from truth_comparison import (
    QuadtreeTruth,
    evaluated_sites,
    hazard_confusion,
    map_errors,
    slope_errors,
    terrain_truth_of,
)

from lunarsim import Grid, Scenario, Simulation, flight_seed
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.onboard.hazards.quadtree import (
    SITE_STATUS,
    InterestMap,
    QuadtreeMap,
    QuadtreeMapper,
    SiteSelection,
)
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.studies import Case, Report, Study, run_script

SCENARIOS = Path(__file__).parents[1]
TIMES = (13.0, 20.0)
# Section 5 of the paper, estimated from its text, which gives no areas.
PAPER = {
    "map error": "generally under 0.5 m",
    "slope error": "under 6 deg everywhere",
    "missed": "a couple of decimetre-scale areas",
    "false": "relatively large amounts of safe terrain",
    "zones": "none",
}


def make_interest_map(scenario: Scenario) -> InterestMap:
    """Return a map of the mission's interest in each place (0 to 1) for a scenario.

    The interest has its maximum in the north-east; it is zero in the south-west corner.
    """
    side = scenario.mappers["sites"].size_m
    grid = Grid.centred(scenario.target.position_m, side, 5.0)
    east, north = np.moveaxis(grid.centres() - scenario.target.position_m, -1, 0)
    far = np.hypot(east - 0.35 * side, north - 0.35 * side)
    value = np.clip(1.0 - far / (1.2 * side), 0.0, 1.0)
    corner = (east < -0.35 * side) & (north < -0.35 * side)
    return InterestMap(grid, np.where(corner, 0.0, value))


def make_simulation(field: int, seed: int, folder: Path) -> Simulation:
    """Create the simulation over one field; write its interest map into `folder`."""
    scenario = Scenario.load(SCENARIOS / "morpheus.toml")
    interest = make_interest_map(scenario)
    g, path = interest.grid, folder / "interest.npz"
    np.savez(path, value=interest.value, x0=g.x0, y0=g.y0, posting=g.posting)
    sites: dict[str, Any] = {"interest_path": str(path)}
    scenario = scenario.changed(mappers={"sites": sites})
    return Simulation(scenario, flight_seed(seed, field))


def fly(case: Case) -> dict[str, Any]:
    """Simulate the LiDAR sweep over one field; return metrics of map and navigation.

    They are those of `fly_field`, without the arrays for figures.
    """
    found = fly_field(case.number, case.seed)
    evaluations = [{k: v for k, v in one.items() if k != "maps"} for one in found["evaluations"]]
    return {k: v for k, v in found.items() if k != "track"} | {"evaluations": evaluations}


@lru_cache(maxsize=1)
def fly_field(field: int, seed: int) -> dict[str, Any]:
    """Simulate the LiDAR sweep over one field; return metrics, and maps for figures.

    `field` is the number of the field and `seed` the root seed. The last result is cached.
    """
    with TemporaryDirectory() as folder:
        simulation = make_simulation(field, seed, Path(folder))
    found: Navigator = simulation.computer.navigation
    pending, evaluations = list(TIMES), []
    track: list[tuple[float, ...]] = []
    while pending:
        simulation.step()
        track.append(
            (simulation.time, *navigation_error(simulation), *navigation_sigmas(simulation))
        )
        if simulation.time >= pending[0] - 1e-9:
            evaluations.append(evaluate_map(simulation, pending.pop(0)))
    tree = simulation.computer.mappers["sites"].map
    return {
        "lock": next((e.time for e in found.events if e.name == "lock"), None),
        "events": [(e.time, e.name) for e in found.events],
        "position_error": list(track[-1][1:4]),
        "attitude_error": list(np.rad2deg(track[-1][4:7])),
        "position_sigma": list(track[-1][7:10]),
        "attitude_sigma": list(np.rad2deg(track[-1][10:13])),
        "points": tree.count,
        "megabytes": tree.nbytes / 1e6,
        "evaluations": evaluations,
        "track": np.array(track),
    }


def navigation_error(simulation: Simulation) -> np.ndarray:
    """Return true minus estimated position (m) and attitude (rad), ENU (6,)."""
    found = simulation.computer.navigation.estimate_in_site(simulation.time, 1.0)
    turn = quat_multiply(simulation.state.attitude, quat_conjugate(found.attitude))
    return np.concatenate(
        (simulation.state.position - found.position, quat_to_rotation_vector(turn))
    )


def navigation_sigmas(simulation: Simulation) -> np.ndarray:
    """Return the estimated 1 sigma of position (m) and attitude (rad) errors (6,).

    The order is that of `navigation_error`.
    """
    return np.sqrt(np.diag(simulation.estimate.covariance)[np.r_[0:3, 6:9]])


def evaluate_map(simulation: Simulation, time: float) -> dict[str, Any]:
    """Compare the current quadtree map and its landing sites with the true terrain.

    `time` (s) is stored with the metrics; "maps" has the map arrays for the figures.
    """
    mapper = simulation.computer.mappers["sites"]
    selection = mapper.select()
    actual = terrain_truth_of(mapper, simulation)
    height = map_errors(mapper, actual)
    slope = slope_errors(mapper, selection, actual.mesh)
    areas, estimated = hazard_confusion(mapper, actual)
    maps = figure_data(mapper, selection, actual)
    maps |= {"height": height, "slope": slope, "estimated": estimated}
    finite = height[2][np.isfinite(height[2])]
    angles = slope[np.isfinite(slope)]
    return {
        "time": time,
        "map_error_rms": float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan"),
        "map_error_within": float(np.mean(np.abs(finite) < 0.5)) if finite.size else float("nan"),
        "slope_error_max": float(angles.max()) if angles.size else float("nan"),
        "slope_error_mean": float(angles.mean()) if angles.size else float("nan"),
        "status": {
            SITE_STATUS[k]: int((selection.status == k).sum()) for k in range(len(SITE_STATUS))
        },
        **areas,
        "sites": evaluated_sites(simulation, selection, mapper.selector.settings, actual),
        "maps": maps,
    }


def figure_data(
    mapper: QuadtreeMapper, selection: SiteSelection, truth: QuadtreeTruth
) -> dict[str, Any]:
    """Return the map arrays and settings that the figures need.

    `selection` is the site selection on the map of `mapper`.
    """
    tree, selector = mapper.map, mapper.selector
    return {
        "elevation": truth.elevation,
        "hazard": truth.hazard,
        "fine": truth.grid,
        "selection": selection,
        "sizes": tree.sizes(selection.nodes),
        "cells": cells_of(tree),
        "interest": selector.interest,
        "zone": selector.settings.zone_half_side,
        "limit": selector.settings.exception_limit,
        "ratios": selector.ratios.copy(),
        "side": tree.side,
        "centre": tree.centre.copy(),
    }


def cells_of(quadtree: QuadtreeMap) -> tuple[np.ndarray, np.ndarray]:
    """Return centers (n, 2) and sides (n,) of cells down to the 8th division, m."""
    nodes = quadtree.band(quadtree.side / 2**8, quadtree.side)
    return quadtree.centres(nodes), quadtree.sizes(nodes)


def summarise(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Combine the metrics of all fields into means, totals and maxima.

    `results` are the values of `fly`.
    """
    locked = [r for r in results if r["lock"] is not None]
    position = np.array([r["position_error"] for r in locked]).reshape(-1, 3)
    attitude = np.array([r["attitude_error"] for r in locked]).reshape(-1, 3)
    out: dict[str, Any] = {
        "fields": len(results),
        "locked": len(locked),
        "lock_time_median_s": float(np.median([r["lock"] for r in locked])) if locked else None,
        "position_rms_m": list(np.sqrt(np.mean(position**2, axis=0))),
        "attitude_rms_deg": list(np.sqrt(np.mean(attitude**2, axis=0))),
        "evaluations": [],
    }
    for k, time in enumerate(TIMES):
        evaluations = [r["evaluations"][k] for r in results]
        sites = [site for one in evaluations for site in one["sites"]]
        total = {key: sum(one[key] for one in evaluations) for key in
                 ("evaluated_m2", "hazard_m2", "missed_m2", "false_m2")}  # fmt: skip
        objects = sum(one["objects"] for one in evaluations)
        missed = sum(one["objects_missed"] for one in evaluations)
        out["evaluations"].append({
            "time": time,
            "map_error_rms": float(np.nanmean([one["map_error_rms"] for one in evaluations])),
            "map_error_within": float(np.nanmean([one["map_error_within"] for one in evaluations])),
            "slope_error_mean": float(np.nanmean([one["slope_error_mean"] for one in evaluations])),
            "slope_error_max": float(np.nanmax([one["slope_error_max"] for one in evaluations])),
            **{key: value / len(evaluations) for key, value in total.items()},
            "missed_share": total["missed_m2"] / max(total["hazard_m2"], 1e-9),
            "objects_missed": f"{missed} of {objects}",
            "sites": len(sites),
            "fields_without_site": sum(not one["sites"] for one in evaluations),
            "zones_with_hazard": sum(site["hazard_m2"] > 0.0 for site in sites),
            "sites_exactly_safe": sum(site["exactly_safe"] for site in sites),
        })  # fmt: skip
    return out


def print_fields(report: Report) -> None:
    """Print the metrics of all fields, and the ranked sites of the first field.

    If there is an output folder, the first field is also plotted.
    """
    summary, first = summarise(report.rows), report.rows[0]
    n, lock = summary["fields"], summary["lock_time_median_s"]
    report.print(
        f"{summary['locked']} of {n} flights were located on the map"
        + (f", after {lock:.1f} s (median)" if lock is not None else "")
        + "; RMS errors per axis at 20 s: position "
        + ", ".join(f"{v:.3f}" for v in summary["position_rms_m"])
        + " m, attitude "
        + ", ".join(f"{v:.3f}" for v in summary["attitude_rms_deg"])
        + " deg"
    )
    table = Table(title=f"Map and sites, mean of {n} fields")
    for heading in ("metric", "at 13 s", "at 20 s", "paper, at 20 s"):
        table.add_column(
            heading, justify="left" if heading in {"metric", "paper, at 20 s"} else "right"
        )
    rows = (
        ("map error, RMS (m)", "map_error_rms", "{:.3f}", PAPER["map error"]),
        ("cells with an error below 0.5 m (fraction)", "map_error_within", "{:.4f}", ""),
        ("slope error, mean (deg)", "slope_error_mean", "{:.2f}", ""),
        ("slope error, maximum of all fields (deg)", "slope_error_max", "{:.2f}",
         PAPER["slope error"]),
        ("evaluated area (m2)", "evaluated_m2", "{:.0f}", ""),
        ("true hazards in it (m2)", "hazard_m2", "{:.1f}", ""),
        ("missed hazards (m2)", "missed_m2", "{:.2f}", PAPER["missed"]),
        ("missed fraction of hazard area", "missed_share", "{:.3f}", ""),
        ("completely missed hazards, all fields", "objects_missed", "{}", ""),
        ("false hazards (m2)", "false_m2", "{:.0f}", PAPER["false"]),
        ("ranked sites, all fields", "sites", "{:d}", ""),
        ("fields without a site", "fields_without_site", "{:d}", ""),
        ("landing zones with a true hazard", "zones_with_hazard", "{:d}", PAPER["zones"]),
        ("sites exactly safe", "sites_exactly_safe", "{:d}", ""),
    )  # fmt: skip
    for label, key, form, paper in rows:
        table.add_row(label, *(form.format(one[key]) for one in summary["evaluations"]), paper)
    report.print(table)
    for one in first["evaluations"]:
        sites = Table(title=f"Field {first['number']}: sites at {one['time']:.0f} s, local frame")
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
        report.print(sites)
    if report.out is not None:
        from figures import draw_all

        draw_all(fly_field(first["number"], report.seed), report.out)


study = Study(fly, repeats="fields", count=1, report=print_fields)

if __name__ == "__main__":
    run_script(study)
