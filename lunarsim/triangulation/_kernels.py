"""Compiled triangulation on integer coordinates below 2**25.

Triangles are half-edges: triangle t owns half-edges 3 t, 3 t + 1, 3 t + 2; `vertex[e]` is where
half-edge e starts, `twin[e]` the half-edge on its other side (-1 for none). The in-circle test
multiplies 52-bit minors with 52-bit lifts; where a float64 filter cannot tell the sign the sum
is done in three 64-bit limbs, exactly.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def orient(ax, ay, bx, by, cx, cy):
    """Return twice the area of triangle abc, positive for counter-clockwise; exact."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@kernel()
def _exact_sign(m0, l0, m1, l1, m2, l2):
    """Return the sign of m0 l0 + m1 l1 + m2 l2 for integers below 2**54, exactly."""
    mask = (1 << 28) - 1
    high = 0
    middle = 0
    low = 0
    for n in range(3):
        m = m0 if n == 0 else (m1 if n == 1 else m2)
        v = l0 if n == 0 else (l1 if n == 1 else l2)
        mh = m >> 28
        ml = m & mask
        vh = v >> 28
        vl = v & mask
        high += mh * vh
        middle += mh * vl + ml * vh
        low += ml * vl
    middle += low >> 28
    low &= mask
    high += middle >> 28
    middle &= mask
    if high > 0:
        return 1
    if high < 0:
        return -1
    return 1 if middle > 0 or low > 0 else 0


@kernel()
def in_circle(ax, ay, bx, by, cx, cy, px, py):
    """Return 1 if p lies inside the circle through the counter-clockwise a, b, c, 0 on it."""
    ax -= px
    ay -= py
    bx -= px
    by -= py
    cx -= px
    cy -= py
    m0 = bx * cy - by * cx
    m1 = cx * ay - cy * ax
    m2 = ax * by - ay * bx
    l0 = ax * ax + ay * ay
    l1 = bx * bx + by * by
    l2 = cx * cx + cy * cy
    t0 = float(m0) * float(l0)
    t1 = float(m1) * float(l1)
    t2 = float(m2) * float(l2)
    total = t0 + t1 + t2
    bound = 1e-15 * (abs(t0) + abs(t1) + abs(t2))
    if total > bound:
        return 1
    if total < -bound:
        return -1
    return _exact_sign(m0, l0, m1, l1, m2, l2)


@kernel()
def hilbert_keys(points, bits):
    """Return the place of every point along a Hilbert curve of 2**bits steps a side."""
    out = np.empty(points.shape[0], np.int64)
    for n in range(points.shape[0]):
        x = points[n, 0]
        y = points[n, 1]
        key = 0
        for b in range(bits - 1, -1, -1):
            rx = (x >> b) & 1
            ry = (y >> b) & 1
            key = (key << 2) | ((3 * rx) ^ ry)
            if ry == 0:
                if rx == 1:
                    x = ~x
                    y = ~y
                x, y = y, x
        out[n] = key
    return out


@kernel()
def _next(e):
    return e - 2 if e % 3 == 2 else e + 1


@kernel()
def _conflicts(t, vertex, x, y, ghost, px, py):
    """Tell whether point p destroys triangle t: inside its circle, or outside its hull edge."""
    a = vertex[3 * t]
    b = vertex[3 * t + 1]
    c = vertex[3 * t + 2]
    if c == ghost:
        side = orient(x[a], y[a], x[b], y[b], px, py)
        if side != 0:
            return side > 0
        # On the line of the hull edge: only between its ends.
        along = (px - x[a]) * (px - x[b]) + (py - y[a]) * (py - y[b])
        return along < 0
    return in_circle(x[a], y[a], x[b], y[b], x[c], y[c], px, py) > 0


@kernel()
def _first_triangle(x, y, order):
    """Return two points and the first that is not on their line, counter-clockwise; or -1s."""
    first = order[0]
    second = order[1] if order.size > 1 else -1
    third = -1
    if second >= 0:
        for m in range(2, order.size):
            if orient(x[first], y[first], x[second], y[second], x[order[m]], y[order[m]]) != 0:
                third = order[m]
                break
    if third < 0:
        return -1, -1, -1
    if orient(x[first], y[first], x[second], y[second], x[third], y[third]) < 0:
        second, third = third, second
    return first, second, third


@kernel()
def _surround_by_ghosts(corner, ghost, vertex, twin):
    """Write the first triangle and a ghost outside each of its edges."""
    for e in range(3):
        vertex[e] = corner[e]
        t = e + 1  # ghost outside half-edge e
        vertex[3 * t] = corner[(e + 1) % 3]
        vertex[3 * t + 1] = corner[e]
        vertex[3 * t + 2] = ghost
        twin[e] = 3 * t
        twin[3 * t] = e
        # The ghost after this one around the hull starts where this one ends.
        twin[3 * t + 1] = 3 * ((e + 2) % 3 + 1) + 2
        twin[3 * ((e + 2) % 3 + 1) + 2] = 3 * t + 1


@kernel(inline=True)
def _walk_to(px, py, t, x, y, ghost, vertex, twin):
    """Walk from triangle t to one that point p destroys."""
    if vertex[3 * t + 2] == ghost:
        t = twin[3 * t] // 3
    came = -1
    while True:
        moved = False
        for e in range(3 * t, 3 * t + 3):
            if e == came:
                continue
            a = vertex[e]
            b = vertex[_next(e)]
            if orient(x[a], y[a], x[b], y[b], px, py) < 0:
                came = twin[e]
                t = came // 3
                moved = True
                break
        if not moved or vertex[3 * t + 2] == ghost:
            return t


@kernel(inline=True)
def _dig_cavity(px, py, t, x, y, ghost, vertex, twin, marked, stack, cavity, rim):
    """List all triangles that point p destroys, t among them, and the rim of the hole.

    The rim is made of the half-edges outside. Returns the number of triangles and of half-edges;
    the marks are wiped again.
    """
    top = 1
    stack[0] = t
    marked[t] = 1
    holes = 0
    edges = 0
    while top > 0:
        top -= 1
        t = stack[top]
        cavity[holes] = t
        holes += 1
        for e in range(3 * t, 3 * t + 3):
            other = twin[e] // 3
            if marked[other] == 1:
                continue
            if _conflicts(other, vertex, x, y, ghost, px, py):
                marked[other] = 1
                stack[top] = other
                top += 1
            else:
                rim[edges] = twin[e]
                edges += 1
    for h in range(holes):
        marked[cavity[h]] = 0
    return holes, edges


@kernel(inline=True)
def _write_fan_triangle(t, a, b, p, ghost, vertex):
    """Write triangle a, b, p, a ghost vertex last; return its half-edge from a to b."""
    if a == ghost:
        vertex[3 * t] = b
        vertex[3 * t + 1] = p
        vertex[3 * t + 2] = a
        return 3 * t + 2
    if b == ghost:
        vertex[3 * t] = p
        vertex[3 * t + 1] = a
        vertex[3 * t + 2] = b
        return 3 * t + 1
    vertex[3 * t] = a
    vertex[3 * t + 1] = b
    vertex[3 * t + 2] = p
    return 3 * t


@kernel(inline=True)
def _fill_by_fan(p, holes, edges, count, ghost, vertex, twin, cavity, rim, fan):
    """Fill the hole by a fan from p over its rim; return the last triangle and their number.

    Old triangles' places are used again. `fan` is room for the new half-edge that starts at each
    vertex of the rim.
    """
    t = count
    for h in range(edges):
        outside = rim[h]
        a = vertex[_next(outside)]  # the rim's half-edge as seen from inside: a to b
        b = vertex[outside]
        if h < holes:
            t = cavity[h]
        else:
            t = count
            count += 1
        base = _write_fan_triangle(t, a, b, p, ghost, vertex)
        twin[base] = outside
        twin[outside] = base
        fan[a] = base
        rim[h] = base
    for h in range(edges):
        base = rim[h]
        inward = _next(base)  # b to p
        neighbour = fan[vertex[inward]]  # half-edge of the rim that starts at b
        outward = _next(_next(neighbour))  # p to b in that triangle
        twin[inward] = outward
        twin[outward] = inward
    return t, count


@kernel()
def _without_ghosts(vertex, count, ghost):
    """Return the triangles (m, 3) of `count` that have no ghost vertex."""
    out = np.empty((count, 3), np.int64)
    kept = 0
    for t in range(count):
        if vertex[3 * t + 2] != ghost:
            for e in range(3):
                out[kept, e] = vertex[3 * t + e]
            kept += 1
    return out[:kept]


@kernel()
def insert_all(points, order):
    """Return the Delaunay triangles (m, 3) of distinct points, inserted in the given order.

    A ghost triangle keeps its ghost vertex last, so its half-edge 0 is the hull edge seen from
    outside.
    """
    n = points.shape[0]
    x = points[:, 0].copy()
    y = points[:, 1].copy()
    ghost = n
    corner = _first_triangle(x, y, order)
    if corner[0] < 0:
        return np.empty((0, 3), np.int64)
    size = 2 * order.size + 8
    vertex = np.empty(3 * size, np.int64)
    twin = np.empty(3 * size, np.int64)
    _surround_by_ghosts(corner, ghost, vertex, twin)
    count = 4
    last = 0
    fan = np.empty(n + 1, np.int64)
    marked = np.zeros(size, np.int8)
    stack = np.empty(size, np.int64)
    cavity = np.empty(size, np.int64)
    rim = np.empty(size, np.int64)
    for m in range(order.size):
        p = order[m]
        if p in corner:
            continue
        t = _walk_to(x[p], y[p], last, x, y, ghost, vertex, twin)
        holes, edges = _dig_cavity(
            x[p], y[p], t, x, y, ghost, vertex, twin, marked, stack, cavity, rim
        )
        last, count = _fill_by_fan(p, holes, edges, count, ghost, vertex, twin, cavity, rim, fan)
    return _without_ghosts(vertex, count, ghost)


@kernel()
def _fill_pockets(x, y, rows, cols, vertex, twin, used, border):
    """Add triangles outside the mesh until its outline is convex; return the half-edges used.

    `border[v]` is the half-edge of the outline that starts at vertex v, or -1.
    """
    # Start at a point of the hull: it is never in a pocket, so going once around is enough.
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
        b = vertex[_next(e)]
        f = border[b]
        c = vertex[_next(f)]
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
    # Turn about the start of e until the next edge without a twin.
    f = _next(_next(e))
    while twin[f] >= 0:
        f = _next(_next(twin[f]))
    return vertex[f]


@kernel()
def _runs_forward(x, y, first, step, count):
    """Tell whether every edge along a side of the mesh points towards its far end."""
    last = first + step * (count - 1)
    ux = x[last] - x[first]
    uy = y[last] - y[first]
    for v in range(first, last, step):
        if (x[v + step] - x[v]) * ux + (y[v + step] - y[v]) * uy <= 0:
            return False
    return True


@kernel(inline=True)
def _pair(twin, e, f):
    """Make two half-edges each other's twin."""
    twin[e] = f
    twin[f] = e


@kernel(inline=True)
def _which_diagonal(x, y, a, b, c, d):
    """Return 1 to cut quad abcd along ac, 2 along bd, 0 if either leaves a triangle inverted."""
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
    """Write the triangles of a quad from half-edge t on; return its east, north and west sides.

    The south side is half-edge t itself.
    """
    vertex[t] = a
    vertex[t + 1] = b
    vertex[t + 4] = c
    vertex[t + 5] = d
    if diagonal == 1:  # a b c, a c d
        vertex[t + 2] = c
        vertex[t + 3] = a
        _pair(twin, t + 2, t + 3)
        return t + 1, t + 4, t + 5
    # a b d, b c d
    vertex[t + 2] = d
    vertex[t + 3] = b
    _pair(twin, t + 1, t + 5)
    return t + 3, t + 4, t + 2


@kernel()
def _cut_quads(x, y, rows, cols, vertex, twin):
    """Write two triangles for each quad of a detector's mesh; tell whether none is folded over."""
    south = np.empty(cols - 1, np.int64)  # upper half-edges of the quads of the row below
    for i in range(rows - 1):
        west = -1
        for j in range(cols - 1):
            a = i * cols + j
            b = a + 1
            d = a + cols
            c = d + 1
            diagonal = _which_diagonal(x, y, a, b, c, d)
            if diagonal == 0:
                return False
            t = 6 * (i * (cols - 1) + j)
            east, north, left = _cut_quad(t, a, b, c, d, diagonal, vertex, twin)
            if i > 0:
                _pair(twin, t, south[j])
            if j > 0:
                _pair(twin, left, west)
            south[j] = north
            west = east
    return True


@kernel()
def flip_mesh(points, rows, cols):
    """Return the Delaunay triangles of a detector's mesh, or none if the mesh folds over."""
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
    """Flip edges in place until every one is Delaunay."""
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
            e1 = _next(e)
            e2 = _next(e1)
            f1 = _next(f)
            f2 = _next(f1)
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
