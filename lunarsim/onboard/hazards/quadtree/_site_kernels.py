# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled selection of sites: terrain planes, hazard cells, landing zones.

Positions are integers in half sides of the smallest cells ("half steps") from the south-west corner
of the map. Cell centres of every size are then integers, and points on an edge are located exactly.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.onboard.hazards.quadtree._sum_kernels import (
    NUMBER,
    SUMS,
    add_leaf,
    add_point,
    add_shifted,
    empty_sums,
    sums_of,
)
from lunarsim.onboard.hazards.quadtree._tree_kernels import (
    STACK,
    cell_centre,
    node_at,
    points_in,
    with_capacity,
)

# Status of a site: index into `sites.SITE_STATUS`.
ELIGIBLE, NO_PLANE, OFF_MAP, NO_INTEREST, STEEP, SPARSE, HAZARD = range(7)
# Columns of the results per site.
(
    COSINE,
    ROUGHNESS,
    RATIO,
    FOOTPRINT_RATIO,
    RELIEF,
    FOOTPRINT_RELIEF,
    POINT_COUNT,
    FITTED_SLOPE,
    SLOPE_SIGMA,
) = range(9)


@kernel(inline=True, inner=True)
def half_steps(tree, node):
    """Return the centre of a cell as integers, in half sides of the smallest cells.

    `node` is the index of the cell; the origin is the south-west corner of the map.
    """
    size = 1 << (tree.depths - tree.depth[node])
    return (2 * tree.column[node] + 1) * size, (2 * tree.row[node] + 1) * size


@kernel()
def is_mesh_node(tree, nodes, min_density):
    """Return which cells (n,) have enough points in each quarter to be mesh nodes.

    `nodes` (n,) are the indices of the cells; `min_density` is in points per square metre.
    """
    good = np.zeros(nodes.size, np.bool_)
    for i in range(nodes.size):
        good[i] = is_evenly_sampled(tree, nodes[i], min_density)
    return good


@kernel(inner=True)
def is_evenly_sampled(tree, node, min_density):
    """Return whether each quarter of a cell has enough points per square metre.

    `node` is the index of the cell and `min_density` the minimum density, 1/m^2. A leaf has no
    quarters and is tested as one area.
    """
    size = 2.0 * tree.half / (1 << tree.depth[node])
    if tree.child[node] < 0:
        return tree.count[node] >= min_density * size * size
    for q in range(4):
        if tree.count[tree.child[node] + q] < min_density * 0.25 * size * size:
            return False
    return True


@kernel()
def normals(x, y, z, triangles):
    """Return the upward unit normals (t, 3) of counter-clockwise triangles (Eq. 2).

    `x`, `y`, `z` (n,) are the vertices, m, and `triangles` (t, 3) their indices. Eq. 2 is that of
    the quadtree paper.
    """
    out = np.empty((triangles.shape[0], 3))
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t]
        ux, uy, uz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
        vx, vy, vz = x[c] - x[a], y[c] - y[a], z[c] - z[a]
        nx = uy * vz - uz * vy
        ny = uz * vx - ux * vz
        nz = ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        out[t, 0] = nx / length
        out[t, 1] = ny / length
        out[t, 2] = nz / length
    return out


@kernel()
def list_triangles(px, py, triangles, square_side, side_count):
    """List the triangles that touch each square of a raster, as a spatial index.

    `px` and `py` (n,) are the vertices and `square_side` the side of a square, all in half steps
    (half sides of the smallest cells). `triangles` (t, 3) are indices of vertices. The raster has
    `side_count` x `side_count` squares. Returns two arrays, start and index: the triangles of
    square s are index[start[s] : start[s + 1]].
    """
    start = np.zeros(side_count * side_count + 1, np.int32)
    for stage in range(2):
        if stage == 1:
            for s in range(side_count * side_count):
                start[s + 1] += start[s]
            index = np.empty(start[-1], np.int32)
            fill = start[:-1].copy()
        for t in range(triangles.shape[0]):
            a, b, c = triangles[t]
            for row in range(
                min(py[a], py[b], py[c]) // square_side, max(py[a], py[b], py[c]) // square_side + 1
            ):
                for col in range(
                    min(px[a], px[b], px[c]) // square_side,
                    max(px[a], px[b], px[c]) // square_side + 1,
                ):
                    s = row * side_count + col
                    if stage == 0:
                        start[s + 1] += 1
                    else:
                        index[fill[s]] = t
                        fill[s] += 1
    return start, index


@kernel(inline=True)
def _triangle_contains(px, py, a, b, c, x, y):
    """Return whether (x, y) lies in the closed counter-clockwise triangle abc; exact.

    `px` and `py` (n,) are integer coordinates of the vertices; `a`, `b`, `c` are their indices.
    """
    return (
        (px[b] - px[a]) * (y - py[a]) - (py[b] - py[a]) * (x - px[a]) >= 0
        and (px[c] - px[b]) * (y - py[b]) - (py[c] - py[b]) * (x - px[b]) >= 0
        and (px[a] - px[c]) * (y - py[c]) - (py[a] - py[c]) * (x - px[c]) >= 0
    )


@kernel()
def steepest_normal(x, y, mesh, out):
    """Find the steepest triangle of a mesh that contains a point; write its normal.

    `x` and `y` are in half steps (half sides of the smallest cells); `mesh` is
    `TerrainMesh.arrays`. `out` (3,) receives the normal. Returns the index of the triangle, -1 off
    the mesh. Several triangles contain a point on an edge or a vertex.
    """
    px, py, _, triangles, normal, square_side, side_count, start, index = mesh
    s = (y // square_side) * side_count + x // square_side
    found = -1
    for i in range(start[s], start[s + 1]):
        t = index[i]
        a, b, c = triangles[t]
        if _triangle_contains(px, py, a, b, c, x, y) and (found < 0 or normal[t, 2] < out[2]):
            for k in range(3):
                out[k] = normal[t, k]
            found = t
    return found


@kernel()
def mesh_height(x, y, mesh, t, half_step_m):
    """Return the height (m) of triangle `t` of a mesh at a point.

    `x` and `y` are in half steps (half sides of the smallest cells) of `half_step_m` m; `mesh` is
    `TerrainMesh.arrays`.
    """
    px, py, z, triangles, normal = mesh[0], mesh[1], mesh[2], mesh[3], mesh[4]
    a = triangles[t, 0]
    east, north = (x - px[a]) * half_step_m, (y - py[a]) * half_step_m
    return z[a] - (normal[t, 0] * east + normal[t, 1] * north) / normal[t, 2]


@kernel()
def normals_at(x, y, mesh):
    """Return the unit normals (n, 3) of a mesh at points; NaN off the mesh.

    `x` and `y` (n,) are in half steps (half sides of the smallest cells); `mesh` is
    `TerrainMesh.arrays`. On an edge or a vertex, the steepest triangle is used.
    """
    out = np.full((x.size, 3), np.nan)
    normal = np.empty(3)
    for i in range(x.size):
        if steepest_normal(x[i], y[i], mesh, normal) >= 0:
            out[i] = normal
    return out


@kernel()
def mark_squares(rectangles, margin, square_side, side_count, marked):
    """Mark the squares of a raster that are touched by enlarged rectangles.

    `rectangles` (n, 4) are west, east, south and north, enlarged by `margin` on all sides. They and
    `square_side` are in half steps (half sides of the smallest cells). `marked` (side_count,
    side_count) receives True.
    """
    for i in range(rectangles.shape[0]):
        west = max((rectangles[i, 0] - margin) // square_side, 0)
        east = min((rectangles[i, 1] + margin) // square_side, side_count - 1)
        south = max((rectangles[i, 2] - margin) // square_side, 0)
        north = min((rectangles[i, 3] + margin) // square_side, side_count - 1)
        for row in range(south, north + 1):
            marked[row, west : east + 1] = True


@kernel()
def marked_nodes(tree, marked, smallest, largest, last_visit, visit):
    """Return the cells of a size band in marked squares, and the empty squares.

    `marked` (rows, cols) is a raster whose squares have the smallest size of the band. `smallest`
    and `largest` are the depths of the smallest and largest cells. `last_visit` (rows * cols,)
    holds the number of the last visit of each square and is updated with `visit`, the number of
    this call, so that no cell is listed twice. Returns the indices of the cells (n,) and the marked
    squares without a cell as west, east, south and north (m, 4), in half steps (half sides of the
    smallest cells).
    """
    wide = marked.shape[1]
    step = 2.0 * tree.half / wide
    square = 2 << (tree.depths - smallest)
    out = np.empty(1024, np.int32)
    empty_squares = np.empty(64, np.int64)
    n, m = np.int64(0), np.int64(0)  # typed zeros, so that functions compile once
    for row in range(wide):
        for col in range(wide):
            if not marked[row, col]:
                continue
            x, y = (col + 0.5) * step - tree.half, (row + 0.5) * step - tree.half
            node = node_at(tree, x, y, smallest, largest)
            if node < 0:
                empty_squares = with_capacity(empty_squares, m)
                empty_squares[m] = row * wide + col
                m += 1
                continue
            place = raster_index(tree, node, smallest)
            if last_visit[place] != visit:
                last_visit[place] = visit
                out = with_capacity(out, n)
                out[n] = node
                n += 1
    empty = np.empty((m, 4), np.int64)
    for i in range(m):
        row, col = empty_squares[i] // wide, empty_squares[i] % wide
        empty[i, 0] = col * square
        empty[i, 1] = (col + 1) * square
        empty[i, 2] = row * square
        empty[i, 3] = (row + 1) * square
    return out[:n].copy(), empty


@kernel(inline=True, inner=True)
def raster_index(tree, node, smallest):
    """Return the index of a cell in the flattened raster of all cells of one depth.

    `node` is the cell and `smallest` the depth of the raster. A larger cell gets the index of its
    south-west corner.
    """
    more = smallest - tree.depth[node]
    row, column = np.int64(tree.row[node]) << more, np.int64(tree.column[node]) << more
    return (row << smallest) + column


@kernel()
def raster_indices(tree, nodes, smallest):
    """Return the indices (n,) of cells in the flattened raster of one depth.

    `nodes` (n,) are the cells and `smallest` the depth of the raster. A larger cell gets the index
    of its south-west corner.
    """
    out = np.empty(nodes.size, np.int64)
    for i in range(nodes.size):
        out[i] = raster_index(tree, nodes[i], smallest)
    return out


@kernel()
def rectangles_of(tree, nodes):
    """Return west, east, south and north of cells (n, 4).

    `nodes` (n,) are the indices of the cells. The result is in half steps (half sides of the
    smallest cells).
    """
    out = np.empty((nodes.size, 4), np.int64)
    for i in range(nodes.size):
        x, y = half_steps(tree, nodes[i])
        size = 1 << (tree.depths - tree.depth[nodes[i]])
        out[i, 0] = x - size
        out[i, 1] = x + size
        out[i, 2] = y - size
        out[i, 3] = y + size
    return out


@kernel()
def zone_sums(tree, west, east, south, north, cx, cy, stack, sums):
    """Sum the moments of all points in a rectangle about the centre (cx, cy).

    All coordinates are relative to the centre of the map, m. `stack` is a work array; `sums` (12,)
    receives the moments. Outliers in height and cells that only touch the rectangle are ignored.
    """
    empty_sums(sums)
    # Tolerance, m: edges of cells and zones often coincide except for rounding.
    edge = 1e-6
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        m = stack[top]
        if tree.count[m] == 0:
            continue
        x, y = cell_centre(tree, m)
        reach = tree.half / (1 << tree.depth[m]) - edge
        if x - reach > east or x + reach < west or y - reach > north or y + reach < south:
            continue
        inside = (
            x - reach >= west and x + reach <= east and y - reach >= south and y + reach <= north
        )
        if inside and tree.slot[m] >= 0:
            add_shifted(sums, tree.sums[tree.slot[m]], x - cx, y - cy)
            continue
        if tree.child[m] >= 0:
            for q in range(4):
                stack[top] = tree.child[m] + q
                top += 1
            continue
        if inside:
            add_leaf(tree, m, cx, cy, sums)
            continue
        run = tree.head[m]
        while run >= 0:
            begin = tree.start[run]
            for i in range(begin, begin + tree.length[run]):
                px, py = np.float64(tree.xyz[i, 0]), np.float64(tree.xyz[i, 1])
                if not tree.is_outlier[i] and west <= px <= east and south <= py <= north:
                    add_point(sums, px - cx, py - cy, np.float64(tree.xyz[i, 2]))
            run = tree.following[run]


@kernel(inline=True)
def _mean_square(sums, z0, normal):
    """Return the mean squared distance (m^2) of summed points to a plane.

    `sums` (12,) are the moment sums of the points. The plane passes through (0, 0, `z0`) and has
    the unit `normal` (3,).
    """
    a, b, c = normal
    n = sums[NUMBER]
    sxz = sums[5] - z0 * sums[0]
    syz = sums[7] - z0 * sums[1]
    szz = sums[8] - 2.0 * z0 * sums[2] + n * z0 * z0
    total = (
        a * a * sums[3]
        + b * b * sums[6]
        + c * c * szz
        + 2.0 * (a * b * sums[4] + a * c * sxz + b * c * syz)
    )
    return max(total / n, 0.0)


@kernel(inline=True)
def _fitted_slope(sums):
    """Return slope and standard error (rad) of the least-squares plane of points.

    `sums` (12,) are the moment sums of the points. Both results are NaN if the points do not span a
    plane. The error is the standard error of the gradient magnitude, for independent residuals.
    """
    n = sums[NUMBER]
    mx, my, mz = sums[0] / n, sums[1] / n, sums[2] / n
    xx, xy, yy = sums[3] / n - mx * mx, sums[4] / n - mx * my, sums[6] / n - my * my
    xz, yz, zz = sums[5] / n - mx * mz, sums[7] / n - my * mz, sums[8] / n - mz * mz
    spread = xx * yy - xy * xy
    if n < 4 or not spread > 1e-12 * (xx + yy) ** 2:
        return np.nan, np.nan
    east, north = (yy * xz - xy * yz) / spread, (xx * yz - xy * xz) / spread
    residual = max(zz - east * xz - north * yz, 0.0) / (n - 3.0)
    return np.arctan(np.hypot(east, north)), np.sqrt(residual * (xx + yy) / spread)


@kernel()
def _abs_distance_sum(tree, west, east, south, north, x, y, z, normal):
    """Sum the absolute distances of the points in a rectangle to a plane.

    The plane passes through (`x`, `y`, `z`), m, with the unit `normal` (3,). Returns the sum, m,
    and the number of points, without outliers in height. They are needed for Eq. 8 of the quadtree
    paper as printed. The sides of the rectangle are relative to the centre of the map, m.
    """
    index = points_in(tree, west, east, south, north)
    total = 0.0
    n = 0
    for i in index:
        if tree.is_outlier[i]:
            continue
        n += 1
        total += abs(
            (tree.xyz[i, 0] - x) * normal[0]
            + (tree.xyz[i, 1] - y) * normal[1]
            + (tree.xyz[i, 2] - z) * normal[2]
        )
    return total, n


@kernel()
def _max_over_zone(raster, x, y, reach):
    """Return the maximum of a raster over a square zone; NaN if one value is NaN.

    `raster` (rows, cols) has no negative values. `x` and `y` are the centre of the zone and `reach`
    its half side, in squares of the raster. Squares that only touch the zone are ignored.
    """
    worst = np.float32(0.0)
    reach = reach - 1e-6
    for row in range(int(np.floor(y - reach)), int(np.ceil(y + reach))):
        for col in range(int(np.floor(x - reach)), int(np.ceil(x + reach))):
            v = raster[row, col]
            if np.isnan(v):
                return v
            worst = max(worst, v)
    return worst


@kernel()
def _max_known_over_zone(raster, x, y, reach):
    """Return the maximum of a raster over a square zone, ignoring NaN; at least 0.

    `x` and `y` are the centre of the zone and `reach` its half side, in squares of the raster.
    Squares that only touch the zone are ignored.
    """
    worst = np.float32(0.0)
    reach = reach - 1e-6
    wide = raster.shape[0]
    for row in range(max(int(np.floor(y - reach)), 0), min(int(np.ceil(y + reach)), wide)):
        for col in range(max(int(np.floor(x - reach)), 0), min(int(np.ceil(x + reach)), wide)):
            if raster[row, col] > worst:  # noqa: PLR1730  (NaN is passed over)
                worst = raster[row, col]
    return worst


@kernel()
def _site_status(cosine, max_ratio, min_cosine, max_exceptions):
    """Classify a site by its slope and its fraction of points off the terrain plane.

    `cosine` is the cosine of the slope and `min_cosine` its minimum. `max_ratio` is the maximum
    fraction of such points (exceptions) in a square of the zone, NaN with too few points;
    `max_exceptions` is its limit. Returns a status code such as `ELIGIBLE` or `STEEP`.
    """
    if cosine < min_cosine:
        return STEEP
    if np.isnan(max_ratio):
        return SPARSE
    return HAZARD if max_ratio > max_exceptions else ELIGIBLE


@kernel()
def _measure_zone(tree, node, half_side, normal, printed, stack, sums, out):
    """Measure number, fitted slope and roughness of the points in a landing zone.

    The zone is a square with half side `half_side` (m) about the centre of cell `node`. `normal`
    (3,) is the normal of the terrain plane. If `printed`, the roughness follows Eq. 8 of the
    quadtree paper as printed, otherwise it is the root mean square distance to the plane. `stack`
    and `sums` are work arrays. The results are written to the entries POINT_COUNT, FITTED_SLOPE,
    SLOPE_SIGMA and ROUGHNESS of `out` (9,).
    """
    x, y = cell_centre(tree, node)
    west, east, south, north = x - half_side, x + half_side, y - half_side, y + half_side
    sums_of(tree, node, sums)
    z = sums[2] / sums[NUMBER]
    zone_sums(tree, west, east, south, north, x, y, stack, sums)
    out[POINT_COUNT] = sums[NUMBER]
    out[FITTED_SLOPE], out[SLOPE_SIGMA] = _fitted_slope(sums)
    if printed:
        total, n = _abs_distance_sum(tree, west, east, south, north, x, y, z, normal)
        out[ROUGHNESS] = total / np.sqrt(n)
    else:
        out[ROUGHNESS] = np.sqrt(_mean_square(sums, z, normal))


@kernel(parallel=True)
def evaluate_sites(
    tree, nodes, smallest, mesh, rasters, limits, printed, thorough, results, status
):
    """Evaluate slope, roughness and hazards of landing sites at the centres of cells.

    `nodes` (n,) are the cells, `smallest` is the depth of the smallest cells that are sites, and
    `mesh` is `TerrainMesh.arrays`. `rasters` are the two results of `evaluate_cells`. `limits` are
    the minimum cosine of the slope, the maximum fraction of exceptions (points off the terrain
    plane), the half sides of the landing zone and of the footprint of the lander, and the margin
    around hazards, m. If `printed`, the roughness follows Eq. 8 of the quadtree paper as printed,
    otherwise it is the root mean square distance to the plane. If `thorough`, it is computed for
    rejected sites too, if they have a plane, enough points and a zone on the map. `results` (N, 9)
    and `status` (N,) receive the results, NaN where not evaluated, and status codes. They have one
    row per square of the smallest cells; rows of cells that are not in `nodes` stay unchanged.
    """
    ratios, reliefs = rasters
    min_cosine, exception, zone, footprint, margin = limits
    per_square = 2.0 * tree.half / ratios.shape[0]
    for i in prange(nodes.size):
        node = np.int64(
            nodes[i]
        )  # one integer type for all node arguments, so that functions compile once
        place = raster_index(tree, node, smallest)
        normal = np.empty(3)
        stack = np.empty(STACK, np.int32)
        s = np.empty(SUMS)
        out = results[place]
        out[:] = np.nan
        hx, hy = half_steps(tree, node)
        if steepest_normal(hx, hy, mesh, normal) < 0:
            status[place] = NO_PLANE
            continue
        out[COSINE] = normal[2]
        x, y = cell_centre(tree, node)
        if max(abs(x), abs(y)) + max(zone, footprint) > tree.half:
            status[place] = OFF_MAP
            continue
        sums_of(tree, node, s)
        if s[NUMBER] == 0.0:
            status[place] = SPARSE
            continue
        column, row = (x + tree.half) / per_square, (y + tree.half) / per_square
        max_ratio = _max_over_zone(ratios, column, row, zone / per_square)
        if not np.isnan(max_ratio):
            reach = (zone + margin) / per_square
            max_ratio = _max_known_over_zone(ratios, column, row, reach)
            out[RATIO] = max_ratio
            out[FOOTPRINT_RATIO] = _max_over_zone(ratios, column, row, footprint / per_square)
            out[RELIEF] = _max_known_over_zone(reliefs, column, row, reach)
            out[FOOTPRINT_RELIEF] = _max_known_over_zone(
                reliefs, column, row, footprint / per_square
            )
        status[place] = _site_status(normal[2], max_ratio, min_cosine, exception)
        if status[place] == ELIGIBLE or (thorough and not np.isnan(max_ratio)):
            _measure_zone(tree, node, zone, normal, printed, stack, s, out)
