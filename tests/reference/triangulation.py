"""The in-circle predicate in exact integers."""

from __future__ import annotations


def in_circle(a, b, c, p) -> int:
    """Sign of the in-circle determinant in Python's unbounded integers."""
    rows = [(x - p[0], y - p[1]) for x, y in (a, b, c)]
    (ax, ay), (bx, by), (cx, cy) = rows
    d = (
        (ax * ax + ay * ay) * (bx * cy - by * cx)
        + (bx * bx + by * by) * (cx * ay - cy * ax)
        + (cx * cx + cy * cy) * (ax * by - ay * bx)
    )
    return (d > 0) - (d < 0)
