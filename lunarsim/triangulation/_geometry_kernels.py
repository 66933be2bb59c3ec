# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled geometry of a triangulation on integer coordinates below 2**25.

Triangles are half-edges: triangle t has half-edges 3 t, 3 t + 1, 3 t + 2; half-edge e starts at
`vertex[e]`, and `twin[e]` is the half-edge on its other side (-1 for none). The in-circle test
multiplies 52-bit minors with 52-bit lifts; if a float64 filter cannot determine the sign, the sum
is computed exactly in three 64-bit limbs.
"""

from __future__ import annotations

from lunarsim._jit import kernel


@kernel(inner=True)
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
    """Return 1 if p is inside the circle through a, b, c (CCW), 0 on it, -1 outside."""
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


@kernel(inner=True)
def next_edge(e):
    """Return the half-edge after e in its triangle."""
    return e - 2 if e % 3 == 2 else e + 1
