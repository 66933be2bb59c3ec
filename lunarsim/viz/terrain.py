"""Draw an overview of a terrain: hillshade, slopes and rocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.collections import EllipseCollection

from lunarsim.grid import Grid
from lunarsim.viz.style import escape_dollars, hillshade, map_axes, new_figure, save, show
from lunarsim.world.terrain import Terrain

_MAX_POSTS = 1200


def draw_terrain(terrain: Terrain, title: str, path: Path) -> None:
    """Write hillshade, slope map and rocks of a terrain to a PNG file.

    Slopes exclude rocks. They are computed at the grid spacing of the figure, which is coarser than
    the terrain's if the terrain has more than 1200 grid points per side.
    """
    g = terrain.relief.grid
    step = -(-max(g.rows, g.cols) // _MAX_POSTS)
    z = terrain.relief.z[::step, ::step].astype(np.float64)
    grid = Grid(g.x0, g.y0, g.posting * step, *z.shape)
    gy, gx = np.gradient(z, grid.posting)
    slope = np.degrees(np.arctan(np.hypot(gx, gy)))
    figure = new_figure(13.5, 4.6)
    figure.suptitle(escape_dollars(title))
    left, middle, right = figure.subplots(1, 3, sharex=True, sharey=True)
    shade = hillshade(z, grid.posting)
    show(left, shade, grid, cmap="gray", vmin=0, vmax=1)
    contours = left.contour(grid.x, grid.y, z, 8, colors="C0", linewidths=0.6)
    left.clabel(contours, fontsize=6, fmt="%.3g")
    map_axes(left, "Hillshade, elevation (m)")
    top = float(np.nanpercentile(slope, 99.0))
    drawn = show(middle, slope, grid, cmap="viridis", vmin=0.0, vmax=max(top, 0.1))
    figure.colorbar(drawn, ax=middle, label="Slope (deg)", shrink=0.8, extend="max")
    map_axes(middle, f"Slope at {grid.posting:.3g} m, median {np.nanmedian(slope):.1f} deg")
    show(right, shade, grid, cmap="gray", vmin=0, vmax=1)
    rocks = terrain.rocks
    right.add_collection(
        EllipseCollection(
            2.0 * rocks.a, 2.0 * rocks.b, np.degrees(rocks.yaw), units="x",
            offsets=np.column_stack((rocks.x, rocks.y)), offset_transform=right.transData,
            facecolor="C3", edgecolor="none",
        )
    )  # fmt: skip
    covered = float(np.sum(np.pi * rocks.a * rocks.b)) / (g.rows * g.cols * g.posting**2)
    map_axes(right, f"{len(rocks)} rocks" + (f", {100 * covered:.1f} % cover" if covered else ""))
    # Rocks across the edge must not add a margin.
    west, east, south, north = grid.extent
    right.set(xlim=(west, east), ylim=(south, north))
    save(figure, path)
