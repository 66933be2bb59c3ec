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
    """The true terrain in the local frame, that is, shifted by the navigation error.

    Attributes
    ----------
    grid
        Cells of 0.1 m over the map.
    elevation
        Elevation (rows, cols), m.
    hazard
        1 where the terrain deviates from the mesh by more than the roughness limit, else 0; NaN
        without a mesh (rows, cols).
    mesh
        True surface mesh: triangles between the means of squares of the true elevation.
    frame
        Transformation from the true frame to the local one.
    """

    grid: Grid
    elevation: np.ndarray
    hazard: np.ndarray
    mesh: TruthMesh
    frame: SiteToLocal


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
    actual: QuadtreeTruth,
) -> list[dict[str, Any]]:
    """Return the ranked landing sites with their flight cost and their true safety.

    `settings` are those of the site selection; `actual` is the true terrain.
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
            "hazard_m2": zone_hazard(site.position, actual, settings.zone_half_side),
            "exactly_safe": bool(
                simulation.truth.is_safe_at(actual.frame.to_site(site.position)[:2])
            ),
        }
        for i, site in enumerate(selection.ranked)
    ]


def map_errors(
    mapper: QuadtreeMapper, actual: QuadtreeTruth
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return center, side, elevation error and true elevation of quadtree cells, m.

    The cells (n,) are the smallest ones with sides of 0.4 to 0.8 m; errors are map minus truth.
    """
    tree, fine = mapper.map, actual.grid
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
        truth[mine[good]] = actual.elevation[rows[:, :, None], cols[:, None, :]].mean(axis=(1, 2))
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
    mapper: QuadtreeMapper, actual: QuadtreeTruth
) -> tuple[dict[str, float], np.ndarray]:
    """Compare the mapped hazard cells with the true ones.

    Returns areas and counts by name (evaluated, hazardous, missed, false; m^2), and the mapped
    hazard (rows, cols): 1, 0, or NaN where cells have too few points (grey in the paper).
    """
    fine, hazard = actual.grid, actual.hazard
    hazards, tree = mapper.selector.hazards, mapper.map
    square = tree.side / len(hazards)
    corner = tree.centre[:2] - 0.5 * tree.side
    col = np.floor((fine.x - corner[0]) / square).astype(int)
    row = np.floor((fine.y - corner[1]) / square).astype(int)
    estimated = hazards[np.ix_(row, col)].astype(np.float64)
    evaluated = np.isfinite(estimated) & np.isfinite(hazard)
    quality = MapQuality.of(estimated[evaluated] == 0.0, hazard[evaluated] == 0.0)
    area = fine.posting**2
    objects, wholly = missed_objects(hazard == 1.0, estimated)
    return {
        "objects": objects,
        "objects_missed": wholly,
        "judged_m2": quality.evaluated * area,
        "hazard_m2": (quality.false_safe + quality.rejected) * area,
        "missed_m2": quality.false_safe * area,
        "false_m2": quality.false_unsafe * area,
    }, estimated


def missed_objects(hazard: np.ndarray, estimated: np.ndarray) -> tuple[int, int]:
    """Count evaluated connected hazards, and those that the map misses completely.

    `hazard` is the true hazard map; `estimated` is 1, 0, or NaN where the map has no value.
    """
    label, count = ndimage.label(hazard, structure=np.ones((3, 3)))
    evaluated, called = (
        np.bincount(label[where], minlength=count + 1)[1:] > 0
        for where in (np.isfinite(estimated), estimated == 1.0)
    )
    return int(evaluated.sum()), int((evaluated & ~called).sum())


def zone_hazard(position: np.ndarray, actual: QuadtreeTruth, zone: float) -> float:
    """Return the area of true hazards in the square landing zone at a site, m^2.

    `zone` is half the side of the landing zone, m.
    """
    g = actual.grid
    near = np.ix_(np.abs(g.y - position[1]) <= zone, np.abs(g.x - position[0]) <= zone)
    return float((actual.hazard[near] == 1.0).sum() * g.posting**2)
