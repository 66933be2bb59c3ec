# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled triangulation of a detector's returns by edge flips of their mesh.

Half-edges and coordinates are those of `_geometry_kernels`.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.triangulation._geometry_kernels import in_circle, next_edge, orient


@kernel()
def _fill_pockets(x, y, rows, cols, vertex, twin, used, border):
    """Add triangles in the notches of the mesh's outline until the outline is convex.

    `x` and `y` are the vertices of a mesh of `rows` x `cols`. `border[v]` is the half-edge of the
    outline that starts at vertex v, or -1; `used` is the number of half-edges so far. `vertex`,
    `twin` and `border` are extended in place. Returns the new number of half-edges, or -1 if the
    outline cannot be closed.
    """
    # Start at a point of the hull: it is never in a pocket, so that one pass is sufficient.
    start = 0
    for v in range(x.size):
        if x[v] < x[start] or (x[v] == x[start] and y[v] < y[start]):
            start = v
    if border[start] < 0:
        return -1
    a = start
    steps = 0
    limit = 8 * (rows + cols) + 64
    while steps < limit:
        e = border[a]
        b = vertex[next_edge(e)]
        f = border[b]
        c = vertex[next_edge(f)]
        if c != a and orient(x[a], y[a], x[b], y[b], x[c], y[c]) < 0:
            # A pocket at b: the triangle a, c, b closes it.
            t = used
            vertex[t] = a
            vertex[t + 1] = c
            vertex[t + 2] = b
            twin[t] = -1
            twin[t + 1] = f
            twin[f] = t + 1
            twin[t + 2] = e
            twin[e] = t + 2
            used += 3
            border[a] = t
            border[b] = -1
            steps += 1
            if a != start:  # the new edge may make a pocket with the one before it
                a = _previous_on_outline(vertex, twin, t)
        else:
            a = b
            steps += 1
            if a == start:
                return used
    return -1


@kernel()
def _previous_on_outline(vertex, twin, e):
    """Return the vertex before the start of outline half-edge e."""
    # Rotate about the start of e until the next edge without a twin.
    f = next_edge(next_edge(e))
    while twin[f] >= 0:
        f = next_edge(next_edge(twin[f]))
    return vertex[f]


@kernel()
def _runs_forward(x, y, first, step, count):
    """Return whether every edge along a side of the mesh points to the side's end.

    The side has the vertices `first`, `first` + `step`, ..., `count` of them.
    """
    last = first + step * (count - 1)
    ux = x[last] - x[first]
    uy = y[last] - y[first]
    for v in range(first, last, step):
        if (x[v + step] - x[v]) * ux + (y[v + step] - y[v]) * uy <= 0:
            return False
    return True


@kernel(inline=True)
def _link_twins(twin, e, f):
    """Link the half-edges e and f as twins of each other in `twin`."""
    twin[e] = f
    twin[f] = e


@kernel(inline=True)
def _choose_diagonal(x, y, a, b, c, d):
    """Return the Delaunay diagonal of the quad abcd: 1 for ac, 2 for bd.

    The result is 0 if neither diagonal lies inside the quad. `x` and `y` are the coordinates of all
    vertices, and a to d are vertex indices.
    """
    abc = orient(x[a], y[a], x[b], y[b], x[c], y[c])
    acd = orient(x[a], y[a], x[c], y[c], x[d], y[d])
    abd = orient(x[a], y[a], x[b], y[b], x[d], y[d])
    bcd = orient(x[b], y[b], x[c], y[c], x[d], y[d])
    first = abc > 0 and acd > 0
    second = abd > 0 and bcd > 0
    if first and second:
        inside = in_circle(x[a], y[a], x[b], y[b], x[c], y[c], x[d], y[d]) > 0
        return 2 if inside else 1
    if first:
        return 1
    return 2 if second else 0


@kernel(inline=True)
def _cut_quad(t, a, b, c, d, diagonal, vertex, twin):
    """Write the two triangles of the quad abcd into `vertex` and `twin`.

    Their half-edges are t to t + 5; half-edge t is the south side. The diagonal is ac if `diagonal`
    is 1, otherwise bd. Returns the half-edges of the east, north and west sides.
    """
    vertex[t] = a
    vertex[t + 1] = b
    vertex[t + 4] = c
    vertex[t + 5] = d
    if diagonal == 1:  # a b c, a c d
        vertex[t + 2] = c
        vertex[t + 3] = a
        _link_twins(twin, t + 2, t + 3)
        return t + 1, t + 4, t + 5
    # a b d, b c d
    vertex[t + 2] = d
    vertex[t + 3] = b
    _link_twins(twin, t + 1, t + 5)
    return t + 3, t + 4, t + 2


@kernel()
def _cut_quads(x, y, rows, cols, vertex, twin):
    """Write two triangles for each quad of a mesh; return whether this is possible.

    The mesh has `rows` x `cols` vertices `x`, `y`, row by row. The triangles are written into
    `vertex` and `twin`. The function stops and returns False at a folded quad, which has no
    diagonal inside.
    """
    south = np.empty(cols - 1, np.int64)  # upper half-edges of the quads in the previous row
    for i in range(rows - 1):
        west = -1
        for j in range(cols - 1):
            a = i * cols + j
            b = a + 1
            d = a + cols
            c = d + 1
            diagonal = _choose_diagonal(x, y, a, b, c, d)
            if diagonal == 0:
                return False
            t = 6 * (i * (cols - 1) + j)
            east, north, left = _cut_quad(t, a, b, c, d, diagonal, vertex, twin)
            if i > 0:
                _link_twins(twin, t, south[j])
            if j > 0:
                _link_twins(twin, left, west)
            south[j] = north
            west = east
    return True


@kernel()
def triangulate_mesh(points, rows, cols):
    """Return the Delaunay triangles (m, 3) of the mesh of a detector's returns.

    `points` (rows * cols, 2) are the returns of a detector of `rows` x `cols`, row by row, as
    integers. The result is empty if the mesh folds over or may overlap itself. Triangles are
    counter-clockwise.
    """
    n = rows * cols
    nothing = np.empty((0, 3), np.int64)
    x = points[:, 0].copy()
    y = points[:, 1].copy()
    mirrored = orient(x[0], y[0], x[cols - 1], y[cols - 1], x[n - 1], y[n - 1]) < 0
    if mirrored:  # triangulate the mirror image
        for v in range(n):
            x[v] = -x[v]
    size = 6 * (rows - 1) * (cols - 1)
    room = size + 3 * (2 * (rows + cols) + 8)
    vertex = np.empty(room, np.int64)
    twin = np.full(room, -1, np.int64)
    if not _cut_quads(x, y, rows, cols, vertex, twin):
        return nothing
    # The outline must run forward along each side, or the mesh may overlap itself.
    if not (
        _runs_forward(x, y, 0, 1, cols)
        and _runs_forward(x, y, n - cols, 1, cols)
        and _runs_forward(x, y, 0, cols, rows)
        and _runs_forward(x, y, cols - 1, cols, rows)
    ):
        return nothing
    border = np.full(n, -1, np.int64)
    for e in range(size):
        if twin[e] < 0:
            border[vertex[e]] = e
    used = _fill_pockets(x, y, rows, cols, vertex, twin, size, border)
    if used < 0:
        return nothing
    _flip_until_delaunay(x, y, vertex, twin, used)
    out = np.empty((used // 3, 3), np.int64)
    for t in range(used // 3):
        out[t, 0] = vertex[3 * t]
        out[t, 1] = vertex[3 * t + (2 if mirrored else 1)]
        out[t, 2] = vertex[3 * t + (1 if mirrored else 2)]
    return out


@kernel()
def _flip_until_delaunay(x, y, vertex, twin, used):
    """Flip edges until every edge is Delaunay.

    `x` and `y` are the vertices; the first `used` half-edges in `vertex` and `twin` are changed in
    place.
    """
    stack = np.empty(used + 64, np.int64)
    for seed in range(used):
        if twin[seed] < seed:
            continue  # no twin, or its twin has been seeded
        top = 1
        stack[0] = seed
        while top > 0:
            top -= 1
            e = stack[top]
            f = twin[e]
            if f < 0:
                continue
            e1 = next_edge(e)
            e2 = next_edge(e1)
            f1 = next_edge(f)
            f2 = next_edge(f1)
            a = vertex[e]
            b = vertex[e1]
            c = vertex[e2]
            d = vertex[f2]
            if in_circle(x[a], y[a], x[b], y[b], x[c], y[c], x[d], y[d]) <= 0:
                continue
            # Triangles a b c and b a d become d b c and c a d.
            vertex[e] = d
            vertex[f] = c
            out_e = twin[e2]
            out_f = twin[f2]
            # Triangle of e: d, b, c with half-edges e (d-b), e1 (b-c), e2 (c-d).
            # Triangle of f: c, a, d with half-edges f (c-a), f1 (a-d), f2 (d-c).
            twin[e] = out_f
            if out_f >= 0:
                twin[out_f] = e
            twin[f] = out_e
            if out_e >= 0:
                twin[out_e] = f
            twin[e2] = f2
            twin[f2] = e2
            if top + 4 > stack.size:
                grown = np.empty(2 * stack.size, np.int64)
                grown[:top] = stack[:top]
                stack = grown
            stack[top] = e
            stack[top + 1] = e1
            stack[top + 2] = f
            stack[top + 3] = f1
            top += 4
