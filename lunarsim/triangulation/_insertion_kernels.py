# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled triangulation of arbitrary points by insertion along a Hilbert curve.

Half-edges and coordinates are those of `_geometry_kernels`.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.triangulation._geometry_kernels import in_circle, next_edge, orient


@kernel()
def hilbert_keys(points, bits):
    """Return the positions (n,) of points (n, 2) along a Hilbert curve.

    The curve covers a grid of 2^bits points per side.
    """
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
def _in_circumcircle(t, vertex, x, y, ghost, px, py):
    """Return whether point p lies inside the circumcircle of triangle t.

    For a ghost triangle the circle is the half plane outside its hull edge.
    """
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
    """Return the first three points in `order` that are not collinear.

    `order` are indices of points `x`, `y`. The result is three indices, counter-clockwise; (-1, -1,
    -1) if all points are collinear.
    """
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
    """Write the first triangle and a ghost triangle outside each of its edges.

    `corner` are the three vertices. A ghost triangle joins an edge of the hull to the `ghost`
    vertex at infinity. The triangles are written into `vertex` and `twin`.
    """
    for e in range(3):
        vertex[e] = corner[e]
        t = e + 1  # ghost outside half-edge e
        vertex[3 * t] = corner[(e + 1) % 3]
        vertex[3 * t + 1] = corner[e]
        vertex[3 * t + 2] = ghost
        twin[e] = 3 * t
        twin[3 * t] = e
        # The next ghost around the hull starts where this one ends.
        twin[3 * t + 1] = 3 * ((e + 2) % 3 + 1) + 2
        twin[3 * ((e + 2) % 3 + 1) + 2] = 3 * t + 1


@kernel(inline=True)
def _find_triangle(px, py, t, x, y, ghost, vertex, twin):
    """Return the triangle that contains point (px, py), by a walk from triangle t.

    If the point is outside the hull, the result is the ghost triangle of a hull edge that faces it.
    """
    if vertex[3 * t + 2] == ghost:
        t = twin[3 * t] // 3
    came = -1
    while True:
        moved = False
        for e in range(3 * t, 3 * t + 3):
            if e == came:
                continue
            a = vertex[e]
            b = vertex[next_edge(e)]
            if orient(x[a], y[a], x[b], y[b], px, py) < 0:
                came = twin[e]
                t = came // 3
                moved = True
                break
        if not moved or vertex[3 * t + 2] == ghost:
            return t


@kernel(inline=True)
def _dig_cavity(px, py, t, x, y, ghost, vertex, twin, marked, stack, cavity, rim):
    """List the triangles whose circumcircle contains a point: the cavity, and its rim.

    The point is (px, py), and t is a triangle that contains it. `cavity` receives the triangles,
    including t, and `rim` the half-edges of the adjacent triangles outside. Returns the numbers of
    both; `marked` (all 0, also afterwards) and `stack` are scratch.
    """
    top = 1
    stack[0] = t
    marked[t] = 1
    cavity_size = 0
    rim_size = 0
    while top > 0:
        top -= 1
        t = stack[top]
        cavity[cavity_size] = t
        cavity_size += 1
        for e in range(3 * t, 3 * t + 3):
            other = twin[e] // 3
            if marked[other] == 1:
                continue
            if _in_circumcircle(other, vertex, x, y, ghost, px, py):
                marked[other] = 1
                stack[top] = other
                top += 1
            else:
                rim[rim_size] = twin[e]
                rim_size += 1
    for h in range(cavity_size):
        marked[cavity[h]] = 0
    return cavity_size, rim_size


@kernel(inline=True)
def _write_fan_triangle(t, a, b, p, ghost, vertex):
    """Write triangle t with the vertices a, b, p; return its half-edge from a to b.

    The triangle is written into `vertex`. If a or b is the `ghost` vertex, the order is rotated so
    that this vertex is last.
    """
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
def _fill_by_fan(p, cavity_size, rim_size, count, ghost, vertex, twin, cavity, rim, fan):
    """Fill a cavity by triangles from vertex p to its rim.

    The cavity has `cavity_size` triangles, whose indices are reused, and `rim_size` half-edges;
    `count` is the number of all triangles. `vertex` and `twin` are changed in place; `rim` is
    overwritten and `fan` is scratch. Returns the last triangle written and the new `count`.
    """
    t = count
    for h in range(rim_size):
        outside = rim[h]
        a = vertex[next_edge(outside)]  # the rim's half-edge as seen from inside: a to b
        b = vertex[outside]
        if h < cavity_size:
            t = cavity[h]
        else:
            t = count
            count += 1
        base = _write_fan_triangle(t, a, b, p, ghost, vertex)
        twin[base] = outside
        twin[outside] = base
        fan[a] = base
        rim[h] = base
    for h in range(rim_size):
        base = rim[h]
        inward = next_edge(base)  # b to p
        neighbour = fan[vertex[inward]]  # half-edge of the rim that starts at b
        outward = next_edge(next_edge(neighbour))  # p to b in that triangle
        twin[inward] = outward
        twin[outward] = inward
    return t, count


@kernel()
def _without_ghosts(vertex, count, ghost):
    """Return those of the first `count` triangles (m, 3) that have no ghost vertex."""
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
    """Return the Delaunay triangles (m, 3) of distinct points, inserted one by one.

    `points` (n, 2) are integers and `order` their indices in the order of insertion. The result is
    empty if all points are collinear.

    A ghost triangle has its ghost vertex last, so that its half-edge 0 is the hull edge seen from
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
        t = _find_triangle(x[p], y[p], last, x, y, ghost, vertex, twin)
        cavity_size, rim_size = _dig_cavity(
            x[p], y[p], t, x, y, ghost, vertex, twin, marked, stack, cavity, rim
        )
        last, count = _fill_by_fan(
            p, cavity_size, rim_size, count, ghost, vertex, twin, cavity, rim, fan
        )
    return _without_ghosts(vertex, count, ghost)
