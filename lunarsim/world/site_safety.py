"""Exact landing safety of sites on the terrain, sampled finely."""

from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import footprint_of, safe_sites
from lunarsim.safety.footprint import MAX_LEG_DISTANCE_CELLS
from lunarsim.typing import BoolArray
from lunarsim.world.terrain import Terrain

# Grid spacing at which the safety has converged, m: `python scenarios/lidar_maps/posting.py`.
CONVERGED_POSTING_M = 0.05
# Sites of one block: rasters of the terrain around them fit into tens of megabytes.
_BLOCK_SITES = 128


def site_safety(
    terrain: Terrain,
    sites: Grid,
    lander: Lander,
    *,
    heading: float | None = None,
    where: BoolArray | None = None,
    posting: float = CONVERGED_POSTING_M,
) -> tuple[BoolArray, BoolArray]:
    """Return which sites of a grid are safe by the exact safety test on the terrain.

    The terrain is sampled at most `posting` apart, independently of the distance between sites. On
    a coarser raster, edges and peaks of rocks lie between the samples, and unsafe sites seem safe.

    Parameters
    ----------
    terrain
        Relief and rocks.
    sites
        Grid of the sites, the lander's centres.
    lander
        Geometry and limits of the lander.
    heading
        Azimuth of body x (rad) to evaluate only one heading; omitted: all headings.
    where
        Sites to evaluate (rows, cols); omitted: all. The others count as not observed.
    posting
        Maximum distance between samples of the terrain, m. It is increased for a lander whose legs
        are more than 256 samples from its centre.

    Returns
    -------
    safe, observed
        Whether a lander centred on each site is safe, False where not observed, and whether the
        terrain under its complete footprint is known; each (rows, cols).
    """
    wanted = np.ones(sites.shape, np.bool_) if where is None else where
    most = int(sites.posting * MAX_LEG_DISTANCE_CELLS / lander.leg_radius)
    stride = max(1, min(int(np.ceil(sites.posting / posting - 1e-9)), most))
    fine = sites.posting / stride
    margin = -(-footprint_of(lander, fine).reach // stride)  # distances between sites
    safe, observed = (np.zeros(sites.shape, np.bool_) for _ in range(2))
    for row in range(0, sites.rows, _BLOCK_SITES):
        for col in range(0, sites.cols, _BLOCK_SITES):
            part = np.s_[row : row + _BLOCK_SITES, col : col + _BLOCK_SITES]
            if not wanted[part].any():
                continue
            rows, cols = (n + 2 * margin for n in wanted[part].shape)
            grid = Grid(
                sites.x0 + (col - margin) * sites.posting,
                sites.y0 + (row - margin) * sites.posting,
                fine,
                stride * (rows - 1) + 1,
                stride * (cols - 1) + 1,
            )
            chosen = np.zeros((rows, cols), np.bool_)
            inner = np.s_[margin : rows - margin, margin : cols - margin]
            chosen[inner] = wanted[part]
            found = safe_sites(
                terrain.raster(grid), grid, lander, heading=heading, where=chosen, stride=stride
            )
            safe[part], observed[part] = (each[inner] for each in found)
    return safe, observed
