"""Compare quadtree map, hazards and sites with the true terrain."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from lunarsim import Grid, Simulation
from lunarsim.api import SiteToLocal
from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.evaluation.truth_mesh import TruthMesh
from lunarsim.onboard.guidance.jerk_limited import site_cost
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper, SiteSelection, SiteSettings

# Grid spacing of the true DEM, m.
TRUTH = 0.1
# Limits that set the time-to-go in the propellant cost of a site, m/s^3 and m/s^4.
JERK, SNAP = 0.25, 0.05


@dataclass(frozen=True)
class QuadtreeTruth:
    """The true terrain in the frame of the map (shifted by the navigation error).

    Attributes
    ----------
    grid
        Cells of 0.1 m over the map.
    elevation
        Elevation (rows, cols), m.
    hazard
        1 where the terrain deviates from the mesh by more than the roughness limit, else 0
        (rows, cols); NaN without a mesh.
    mesh
        True surface mesh of triangles; its vertices are mean true elevations of square cells.
    true_to_local
        Transformation from the true (site) frame to the frame of the map.
    """

    grid: Grid
    elevation: np.ndarray
    hazard: np.ndarray
    mesh: TruthMesh
    true_to_local: SiteToLocal


def terrain_truth_of(mapper: QuadtreeMapper, simulation: Simulation) -> QuadtreeTruth:
    """Return the true terrain in the area of a quadtree map, with its hazards."""
    s, frame = mapper.selector.settings, simulation.true_to_local
    west, east, _, _ = mapper.grid.extent
    grid = Grid.centred(mapper.grid.centre, east - west, TRUTH)
    centres = grid.centres()
    there = frame.to_site(np.dstack((centres, np.zeros(centres.shape[:2]))))
    elevation = simulation.world.terrain.elevation(there[..., :2]) + frame.offset[2]
    mesh = TruthMesh(elevation, grid, 2.0 * s.zone_half_side)
    hazard = mesh.hazards(elevation, grid, s.roughness_limit)
    return QuadtreeTruth(grid, elevation, hazard, mesh, frame)


def evaluated_sites(
    simulation: Simulation,
    selection: SiteSelection,
    settings: SiteSettings,
    truth: QuadtreeTruth,
) -> list[dict[str, Any]]:
    """Return the ranked landing sites with their propellant and their true safety.

    `settings` are those of the site selection.
    """
    com = np.array([0.0, 0.0, simulation.lander.com_height])
    cost = site_cost(
        simulation.estimate,
        np.array([site.position for site in selection.ranked]).reshape(-1, 3) + com,
        simulation.scenario.gravity_m_s2,
        simulation.lander.exhaust_velocity,
        jerk=JERK,
        snap=SNAP,
    )
    return [
        asdict(site)
        | {
            "position": list(site.position),
            "propellant": float(cost.propellant[i]),
            "increment": float(cost.delta_v[i]),
            "time_to_go": float(cost.time_to_go[i]),
            "hazard_m2": hazard_area_in_zone(site.position, truth, settings.zone_half_side),
            "exactly_safe": bool(
                simulation.truth.is_safe_at(truth.true_to_local.to_site(site.position)[:2])
            ),
        }
        for i, site in enumerate(selection.ranked)
    ]


def map_errors(
    mapper: QuadtreeMapper, terrain_truth: QuadtreeTruth
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return center, side, elevation error and true elevation of quadtree cells, m.

    The cells (n,) are the smallest ones with sides of 0.4 to 0.8 m; errors are map minus truth.
    """
    tree, fine = mapper.map, terrain_truth.grid
    nodes = tree.band(4.0 * tree.min_cell_size, 8.0 * tree.min_cell_size)
    xy, side = tree.centres(nodes), tree.sizes(nodes)
    truth = np.full(len(nodes), np.nan)
    for size in np.unique(side):
        n = round(size / fine.posting)
        mine = np.flatnonzero(side == size)
        row, col = fine.cell(xy[mine] - 0.5 * size + 0.5 * fine.posting)
        good = (row >= 0) & (col >= 0) & (row + n <= fine.rows) & (col + n <= fine.cols)
        rows = row[good, None] + np.arange(n)
        cols = col[good, None] + np.arange(n)
        truth[mine[good]] = terrain_truth.elevation[rows[:, :, None], cols[:, None, :]].mean(
            axis=(1, 2)
        )
    return xy, side, tree.elevation(nodes) - truth, truth


def slope_errors(mapper: QuadtreeMapper, selection: SiteSelection, mesh: TruthMesh) -> np.ndarray:
    """Return the angle between estimated and true normals at the sites (n,), deg.

    `mesh` is the true surface mesh.
    """
    estimated = mapper.selector.mesh.normals_of(selection.nodes)
    true, _ = mesh.plane(selection.position[:, :2])
    cosine = np.einsum("ij,ij->i", estimated, true)
    return np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))


def hazard_confusion(
    mapper: QuadtreeMapper, truth: QuadtreeTruth
) -> tuple[dict[str, float], np.ndarray]:
    """Compare the mapped hazard cells with the true ones.

    Returns areas (evaluated, hazardous, missed, false; m^2) and counts by name, and the mapped
    hazard (rows, cols): 1, 0, or NaN where cells have too few points.
    """
    fine, hazard = truth.grid, truth.hazard
    hazards, tree = mapper.selector.hazards, mapper.map
    square = tree.side / len(hazards)
    corner = tree.centre[:2] - 0.5 * tree.side
    col = np.floor((fine.x - corner[0]) / square).astype(int)
    row = np.floor((fine.y - corner[1]) / square).astype(int)
    estimated = hazards[np.ix_(row, col)].astype(np.float64)
    evaluated = np.isfinite(estimated) & np.isfinite(hazard)
    quality = MapQuality.of(estimated[evaluated] == 0.0, hazard[evaluated] == 0.0)
    area = fine.posting**2
    objects, wholly = count_missed_hazards(hazard == 1.0, estimated)
    return {
        "objects": objects,
        "objects_missed": wholly,
        "evaluated_m2": quality.evaluated * area,
        "hazard_m2": (quality.false_safe + quality.rejected) * area,
        "missed_m2": quality.false_safe * area,
        "false_m2": quality.false_unsafe * area,
    }, estimated


def count_missed_hazards(true_hazard: np.ndarray, mapped_hazard: np.ndarray) -> tuple[int, int]:
    """Count the true connected hazards, and those that the map misses completely.

    `mapped_hazard` is 1, 0, or NaN where the map has no value; hazards there are not counted.
    """
    label, count = ndimage.label(true_hazard, structure=np.ones((3, 3)))
    evaluated, called = (
        np.bincount(label[where], minlength=count + 1)[1:] > 0
        for where in (np.isfinite(mapped_hazard), mapped_hazard == 1.0)
    )
    return int(evaluated.sum()), int((evaluated & ~called).sum())


def hazard_area_in_zone(site: np.ndarray, truth: QuadtreeTruth, half_side: float) -> float:
    """Return the area of true hazards in the square landing zone at a site, m^2.

    `half_side` is half the side of the zone, m.
    """
    g = truth.grid
    near = np.ix_(np.abs(g.y - site[1]) <= half_side, np.abs(g.x - site[0]) <= half_side)
    return float((truth.hazard[near] == 1.0).sum() * g.posting**2)
