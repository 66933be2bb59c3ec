"""Compiled selection of sites: ground planes, hazard cells, landing zones.

Places are counted in half sides of the least cells from the south-west corner of the map, so that
centres of cells of every size are whole numbers and a point on an edge is found exactly.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.onboard.hazards.quadtree._tree_kernels import (
    STACK,
    SUMS,
    add_shifted,
    cell_centre,
    node_at,
    points_in,
    with_room,
)

# Why a site is not to be landed on; 0: it may be.
ELIGIBLE, NO_PLANE, OFF_MAP, NO_INTEREST, STEEP, SPARSE, HAZARD = range(7)


@kernel(inline=True)
def half_steps(tree, node):
    """Return the centre of a node in half sides of the least cells."""
    size = 1 << (tree.depths - tree.depth[node])
    return (2 * tree.column[node] + 1) * size, (2 * tree.row[node] + 1) * size


@kernel()
def mesh_nodes(tree, nodes, per_area):
    """Tell which cells (n,) each of whose quarters holds enough points to a square metre."""
    good = np.zeros(nodes.size, np.bool_)
    for i in range(nodes.size):
        good[i] = _evenly_seen(tree, nodes[i], per_area)
    return good


@kernel()
def _evenly_seen(tree, node, per_area):
    """Tell whether each quarter of a cell is dense enough; the whole one if it has none."""
    size = 2.0 * tree.half / (1 << tree.depth[node])
    if tree.child[node] < 0:
        return tree.count[node] >= per_area * size * size
    for q in range(4):  # noqa: SIM110  (compiled)
        if tree.count[tree.child[node] + q] < per_area * 0.25 * size * size:
            return False
    return True


@kernel()
def normals(x, y, z, triangles):
    """Return the upward unit normals (t, 3) of counter-clockwise triangles, Eq. 2."""
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
def list_triangles(px, py, triangles, bucket, wide):
    """List the triangles that touch each square of side `bucket` (half steps).

    Returns
    -------
    start, index
        Triangles of square s are index[start[s] : start[s + 1]].
    """
    start = np.zeros(wide * wide + 1, np.int32)
    for stage in range(2):
        if stage == 1:
            for s in range(wide * wide):
                start[s + 1] += start[s]
            index = np.empty(start[-1], np.int32)
            fill = start[:-1].copy()
        for t in range(triangles.shape[0]):
            a, b, c = triangles[t]
            for row in range(
                min(py[a], py[b], py[c]) // bucket, max(py[a], py[b], py[c]) // bucket + 1
            ):
                for col in range(
                    min(px[a], px[b], px[c]) // bucket, max(px[a], px[b], px[c]) // bucket + 1
                ):
                    s = row * wide + col
                    if stage == 0:
                        start[s + 1] += 1
                    else:
                        index[fill[s]] = t
                        fill[s] += 1
    return start, index


@kernel(inline=True)
def _holds(px, py, a, b, c, x, y):
    """Tell whether (x, y) lies in the closed counter-clockwise triangle abc; exact."""
    return (
        (px[b] - px[a]) * (y - py[a]) - (py[b] - py[a]) * (x - px[a]) >= 0
        and (px[c] - px[b]) * (y - py[b]) - (py[c] - py[b]) * (x - px[b]) >= 0
        and (px[a] - px[c]) * (y - py[c]) - (py[a] - py[c]) * (x - px[c]) >= 0
    )


@kernel()
def steepest_normal(x, y, mesh, out):
    """Write the normal (3,) of the steepest triangle that holds a point; tell if there is one.

    On an edge or a vertex several do.
    """
    px, py, triangles, normal, bucket, wide, start, index = mesh
    s = (y // bucket) * wide + x // bucket
    found = False
    for i in range(start[s], start[s + 1]):
        t = index[i]
        a, b, c = triangles[t]
        if _holds(px, py, a, b, c, x, y) and (not found or normal[t, 2] < out[2]):
            for k in range(3):
                out[k] = normal[t, k]
            found = True
    return found


@kernel()
def normals_at(x, y, mesh):
    """Return the steepest normals (n, 3) at places given in half steps, NaN off the mesh."""
    out = np.full((x.size, 3), np.nan)
    normal = np.empty(3)
    for i in range(x.size):
        if steepest_normal(x[i], y[i], mesh, normal):
            out[i] = normal
    return out


@kernel()
def _exceptions(tree, node, x, y, z, normal, tolerance, stack):
    """Count a cell's points farther than `tolerance` from a plane through (x, y, z)."""
    beyond = 0
    stack[0] = node
    top = 1
    while top > 0:
        top -= 1
        m = stack[top]
        if tree.child[m] >= 0:
            for q in range(4):
                if tree.count[tree.child[m] + q] > 0:
                    stack[top] = tree.child[m] + q
                    top += 1
            continue
        run = tree.head[m]
        while run >= 0:
            begin = tree.start[run]
            for i in range(begin, begin + tree.length[run]):
                d = (
                    (tree.xyz[i, 0] - x) * normal[0]
                    + (tree.xyz[i, 1] - y) * normal[1]
                    + (tree.xyz[i, 2] - z) * normal[2]
                )
                if abs(d) > tolerance:
                    beyond += 1
            run = tree.following[run]
    return beyond


@kernel(parallel=True)
def exception_ratios(tree, nodes, mesh, tolerance, per_area):
    """Return the share of each cell's points off its plane (n,), NaN where too few or no plane."""
    out = np.full(nodes.size, np.nan, np.float32)
    for i in prange(nodes.size):
        node = nodes[i]
        normal = np.empty(3)
        stack = np.empty(STACK, np.int32)
        hx, hy = half_steps(tree, node)
        if _evenly_seen(tree, node, per_area) and steepest_normal(hx, hy, mesh, normal):
            x, y = cell_centre(tree, node)
            z = tree.sums[node, 2] / tree.count[node]
            beyond = _exceptions(tree, node, x, y, z, normal, tolerance, stack)
            out[i] = beyond / tree.count[node]
    return out


@kernel()
def paint(tree, nodes, ratios, raster, steps):
    """Write cells' ratios into the squares of a raster (side: `steps` least cells) they cover.

    Returns the squares whose value changed, as row * columns + column.
    """
    wide = raster.shape[1]
    changed = np.empty(nodes.size, np.int64)
    n = 0
    for i in range(nodes.size):
        node = nodes[i]
        size = (1 << (tree.depths - tree.depth[node])) // steps
        for row in range(tree.row[node] * size, (tree.row[node] + 1) * size):
            for col in range(tree.column[node] * size, (tree.column[node] + 1) * size):
                old = raster[row, col]
                new = ratios[i]
                if old == new or (np.isnan(old) and np.isnan(new)):
                    continue
                raster[row, col] = new
                changed = with_room(changed, n)
                changed[n] = row * wide + col
                n += 1
    return changed[:n].copy()


@kernel()
def mark(rectangles, reach, square, wide, marked):
    """Mark the squares of a raster that rectangles (n, 4), grown by `reach`, touch.

    All in half steps; west, east, south, north.
    """
    for i in range(rectangles.shape[0]):
        west = max((rectangles[i, 0] - reach) // square, 0)
        east = min((rectangles[i, 1] + reach) // square, wide - 1)
        south = max((rectangles[i, 2] - reach) // square, 0)
        north = min((rectangles[i, 3] + reach) // square, wide - 1)
        for row in range(south, north + 1):
            marked[row, west : east + 1] = True


@kernel()
def clear_unseen(tree, marked, raster, smallest, largest):
    """Set the marked squares without a cell of the band to NaN; return those that changed."""
    wide = marked.shape[1]
    step = 2.0 * tree.half / wide
    changed = np.empty(64, np.int64)
    n = 0
    for row in range(wide):
        for col in range(wide):
            if not marked[row, col] or np.isnan(raster[row, col]):
                continue
            x, y = (col + 0.5) * step - tree.half, (row + 0.5) * step - tree.half
            if node_at(tree, x, y, smallest, largest) >= 0:
                continue
            raster[row, col] = np.nan
            changed = with_room(changed, n)
            changed[n] = row * wide + col
            n += 1
    return changed[:n].copy()


@kernel()
def marked_nodes(tree, marked, smallest, largest, seen, version):
    """Return the cells of a band in the marked squares (one square a cell of the smallest size)."""
    wide = marked.shape[1]
    step = 2.0 * tree.half / wide
    out = np.empty(1024, np.int32)
    n = 0
    for row in range(wide):
        for col in range(wide):
            if not marked[row, col]:
                continue
            node = node_at(
                tree,
                (col + 0.5) * step - tree.half,
                (row + 0.5) * step - tree.half,
                smallest,
                largest,
            )
            if node < 0 or seen[node] == version:
                continue
            seen[node] = version
            out = with_room(out, n)
            out[n] = node
            n += 1
    return out[:n].copy()


@kernel()
def rectangles_of(tree, nodes):
    """Return the outlines (n, 4) of cells in half steps: west, east, south, north."""
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
def _zone_sums(tree, west, east, south, north, cx, cy, stack, s):
    """Write the sums over the points in a closed rectangle, about (cx, cy); return their number."""
    s[:] = 0.0
    n = 0
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        m = stack[top]
        if tree.count[m] == 0:
            continue
        x, y = cell_centre(tree, m)
        reach = tree.half / (1 << tree.depth[m])
        if x - reach > east or x + reach < west or y - reach > north or y + reach < south:
            continue
        if x - reach >= west and x + reach <= east and y - reach >= south and y + reach <= north:
            add_shifted(s, tree.sums[m], np.float64(tree.count[m]), x - cx, y - cy)
            n += tree.count[m]
            continue
        if tree.child[m] >= 0:
            for q in range(4):
                stack[top] = tree.child[m] + q
                top += 1
            continue
        run = tree.head[m]
        while run >= 0:
            begin = tree.start[run]
            for i in range(begin, begin + tree.length[run]):
                px, py = np.float64(tree.xyz[i, 0]), np.float64(tree.xyz[i, 1])
                if west <= px <= east and south <= py <= north:
                    dx, dy, z = px - cx, py - cy, np.float64(tree.xyz[i, 2])
                    s[0] += dx
                    s[1] += dy
                    s[2] += z
                    s[3] += dx * dx
                    s[4] += dx * dy
                    s[5] += dx * z
                    s[6] += dy * dy
                    s[7] += dy * z
                    s[8] += z * z
                    n += 1
            run = tree.following[run]
    return n


@kernel(inline=True)
def _mean_square(s, n, z0, normal):
    """Return the mean squared distance of n points to the plane through (0, 0, z0)."""
    a, b, c = normal
    sxz = s[5] - z0 * s[0]
    syz = s[7] - z0 * s[1]
    szz = s[8] - 2.0 * z0 * s[2] + n * z0 * z0
    total = (
        a * a * s[3] + b * b * s[6] + c * c * szz + 2.0 * (a * b * s[4] + a * c * sxz + b * c * syz)
    )
    return max(total / n, 0.0)


@kernel()
def _root_sum(tree, west, east, south, north, x, y, z, normal):
    """Return sum |d| and the number of the points in a closed rectangle: for Eq. 8 as printed."""
    index = points_in(tree, west, east, south, north)
    total = 0.0
    for i in index:
        total += abs(
            (tree.xyz[i, 0] - x) * normal[0]
            + (tree.xyz[i, 1] - y) * normal[1]
            + (tree.xyz[i, 2] - z) * normal[2]
        )
    return total, index.size


@kernel()
def _worst_ratio(raster, x, y, reach):
    """Return the greatest exception ratio over squares that overlap a zone; NaN if one is NaN.

    Middle and half side of the zone in squares of the raster, as fractions; squares that only touch
    do not count.
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
def _verdict(interest, cosine, worst, least_cosine, exception):
    """Return why a site is not to be landed on."""
    if interest <= 0.0:
        return NO_INTEREST
    if cosine < least_cosine:
        return STEEP
    if np.isnan(worst):
        return SPARSE
    return HAZARD if worst > exception else ELIGIBLE


@kernel()
def _roughness(tree, node, zone, normal, printed, stack, s):
    """Return the roughness of the zone about a cell over its plane."""
    x, y = cell_centre(tree, node)
    west, east, south, north = x - zone, x + zone, y - zone, y + zone
    z = tree.sums[node, 2] / tree.count[node]
    if printed:
        total, n = _root_sum(tree, west, east, south, north, x, y, z, normal)
        return total / np.sqrt(n)
    n = _zone_sums(tree, west, east, south, north, x, y, stack, s)
    return np.sqrt(_mean_square(s, n, z, normal))


@kernel(parallel=True)
def judge_sites(tree, nodes, mesh, raster, interest, limits, printed, thorough, out):
    """Judge sites at the centres of cells.

    Parameters
    ----------
    nodes
        Cells (n,).
    mesh
        Ground planes.
    raster
        Exception ratios of squares over the whole map; NaN: hazardous for want of points.
    interest
        Of each site (n,).
    limits
        Least cosine of the slope, exception tolerance, half sides of the zone and of its middle,
        m.
    printed
        Roughness by Eq. 8 as printed, else root mean square.
    thorough
        Find the roughness of rejected sites too, where there are points.
    out
        cosine, roughness, ratio, ratio near the middle (N,) and status (N,), one entry a node of
        the tree.
    """
    cosine, roughness, ratio, near, status = out
    least_cosine, exception, zone, middle = limits
    per_square = 2.0 * tree.half / raster.shape[0]
    for i in prange(nodes.size):
        node = nodes[i]
        normal = np.empty(3)
        stack = np.empty(STACK, np.int32)
        s = np.empty(SUMS)
        cosine[node] = np.nan
        roughness[node] = np.nan
        ratio[node] = np.nan
        near[node] = np.nan
        hx, hy = half_steps(tree, node)
        if not steepest_normal(hx, hy, mesh, normal):
            status[node] = NO_PLANE
            continue
        cosine[node] = normal[2]
        x, y = cell_centre(tree, node)
        if max(abs(x), abs(y)) + zone > tree.half:
            status[node] = OFF_MAP
            continue
        column, row = (x + tree.half) / per_square, (y + tree.half) / per_square
        worst = _worst_ratio(raster, column, row, zone / per_square)
        ratio[node] = worst
        near[node] = _worst_ratio(raster, column, row, middle / per_square)
        status[node] = _verdict(interest[i], normal[2], worst, least_cosine, exception)
        if status[node] == ELIGIBLE or (thorough and not np.isnan(worst)):
            roughness[node] = _roughness(tree, node, zone, normal, printed, stack, s)
