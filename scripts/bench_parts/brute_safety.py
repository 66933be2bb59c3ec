"""Compute the exact safety map by brute force, without bounds, as a reference."""

from __future__ import annotations

import numpy as np

from bench_parts.common import median_ms
from lunarsim._jit import kernel, prange
from lunarsim._simd import SIMD_WIDTH, item, lane_fill, lane_max, lane_sqrt, load, store
from lunarsim.safety import footprint_of
from lunarsim.safety._plane_kernels import flat_offsets, squared_tangent, support_plane
from lunarsim.safety.exact import exact_safety
from lunarsim.safety.footprint import polygon_runs


@kernel(inline=True)
def _max_height_above_plane(z, first_site, cols, runs, begin, end, gx, gy):
    """Return the maximum height above a plane within a leg polygon, for several sites.

    The sites are one SIMD vector of adjacent cells that starts at `first_site` in the flattened
    heights `z`. `runs[begin:end]` are the cells of the polygon by row; `gx` and `gy` are the
    slopes of the plane per cell.
    """
    top = lane_fill(-1e30)
    for n in range(begin, end):
        row, col = item(runs, 3 * n), item(runs, 3 * n + 1)
        cell = first_site + row * cols + col
        line = load(z, cell)
        for c in range(1, item(runs, 3 * n + 2)):
            line = lane_max(line, load(z, cell + c) - np.float32(c) * gx)
        top = lane_max(top, line - np.float32(row) * gy - np.float32(col) * gx)
    return top


@kernel(parallel=True, inner=False)
def _brute(z, feet, shape, cells, legs, runs, first, posting, tangent, roughness):
    """Write the maximum slope tangent and roughness of each site over all headings.

    `feet` are heights under the pads, `cells` and `legs` the footprint at each heading, and
    `runs[first[h]:first[h + 1]]` the cells of its leg polygon at heading `h`.
    """
    inverse, first_leg, reach = cells.inverse, cells.first_leg, cells.reach
    rows, cols = shape
    for i in prange(reach, rows - reach):
        for j in range(reach, cols - reach - SIMD_WIDTH + 1, SIMD_WIDTH):
            site = i * cols + j
            steepest = lane_fill(0.0)
            worst = lane_fill(0.0)
            for h in range(legs.shape[0]):
                for s in range(inverse.shape[1]):
                    gx, gy, base = support_plane(feet, site, legs, inverse, first_leg, h, s)
                    square = squared_tangent(gx, gy, posting)
                    top = _max_height_above_plane(
                        z, site, cols, runs, first[h], first[h + 1], gx, gy
                    )
                    steepest = lane_max(steepest, square)
                    worst = lane_max(worst, (top - base) / lane_sqrt(square + np.float32(1.0)))
            store(tangent, site, lane_sqrt(steepest))
            store(roughness, site, worst)


def brute(z, grid, lander):
    """Compute tangent of slope and roughness of all sites by brute force.

    `z` (rows, cols) are heights on `grid`, m. Both results are (rows, cols), and 0 near the edge.
    """
    footprint = footprint_of(lander, grid.posting)
    lines = [polygon_runs(polygon) for polygon in footprint.legs]
    first = np.cumsum([0] + [len(line) for line in lines])
    runs = np.array([run for line in lines for run in line], dtype=np.int64).ravel()
    z = np.asarray(z, dtype=np.float32)
    feet = z.copy()
    for row, col in footprint.pad:
        np.maximum(feet, np.roll(z, (-row, -col), (0, 1)), out=feet)
    out = np.zeros((2, z.size + SIMD_WIDTH), np.float32)
    legs = flat_offsets(footprint.legs, grid.cols)
    _brute(
        z.ravel(), feet.ravel(), grid.shape, footprint.cells, legs, runs, first,
        np.float32(grid.posting), out[0], out[1],
    )  # fmt: skip
    return out[:, : z.size].reshape(2, *grid.shape)


def terrains(grid):
    """Return test terrains by name: heights (rows, cols), m, on `grid`."""
    from lunarsim.world.terrain import fractal_relief

    rng = np.random.default_rng(0)
    x, y = np.meshgrid(grid.x, grid.y)

    def stones(density, radius):
        z = np.zeros(grid.shape)
        half = 0.5 * grid.cols * grid.posting
        for east, north in rng.uniform(-half, half, (round(density * 4.0 * half**2), 2)):
            rows = np.abs(grid.y - north) < radius
            cols = np.abs(grid.x - east) < radius
            apart = (x[np.ix_(rows, cols)] - east) ** 2 + (y[np.ix_(rows, cols)] - north) ** 2
            cap = np.sqrt(np.maximum(radius**2 - apart, 0.0))
            z[np.ix_(rows, cols)] = np.maximum(z[np.ix_(rows, cols)], cap)
        return z

    tilt = np.tan(np.deg2rad(10.0)) * x
    found = {
        "level": np.zeros(grid.shape),
        "10 deg": tilt,
        "rocks": stones(0.4, 0.5),
        "small rocks": stones(7.0, 0.15),
        "rocks, 10 deg": stones(2.0, 0.15) + tilt,
        "ridge of 40 m": -(x**2) / 80.0,
        "ripples": 0.02 * (np.cos(2.0 * np.pi * x / 2.0) + np.cos(2.0 * np.pi * y / 2.0)),
        "terraces": 0.05 * np.floor(x),
        "saw": 0.1 * ((x / 0.8) % 1.0),
    }
    for radius in (40, 100, 1000):
        found[f"dome of {radius} m"] = -(x**2 + y**2) / (2.0 * radius)
    found["rough dome"] = found["dome of 100 m"] + 0.01 * rng.standard_normal(grid.shape)
    for hurst in (0.2, 0.5, 0.85, 0.99):
        relief = fractal_relief(
            grid, np.random.default_rng(1), hurst=hurst, rms_slope=np.deg2rad(8.0)
        )
        found[f"relief, H {hurst}"] = relief.z
    return found


def compare(lander, width: float = 25.0, posting: float = 0.1) -> None:
    """Time the exact safety map relative to brute force, and check that both agree.

    `width` and `posting` are side and grid spacing of the map, m.
    """
    import numba

    from lunarsim.grid import Grid

    grid = Grid.centred((0.0, 0.0), width, posting)
    reach = footprint_of(lander, posting).reach
    inner = slice(reach, -reach - SIMD_WIDTH)
    sites = (grid.rows - 2 * reach) * (grid.cols - 2 * reach)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    plain = 1e3 * median_ms(lambda: brute(np.zeros(grid.shape), grid, lander), 3) / sites
    print(
        f"  exact map at {posting} m, one thread: us per site; ratio to brute force ({plain:.2f} "
        f"us)"
    )
    for name, z in terrains(grid).items():
        ours = 1e3 * median_ms(lambda z=z: exact_safety(z, grid, lander), 3) / sites
        print(f"    {name:16s} {ours:5.2f}  {ours / plain:.2f}")
        rough = exact_safety(z, grid, lander).roughness - brute(z, grid, lander)[1]
        if np.abs(rough[inner, inner]).max() > 1e-4:
            raise AssertionError(f"terrain {name}: the exact map and brute force must agree")
    numba.set_num_threads(threads)
