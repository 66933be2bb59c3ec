"""A rock as the set of points in it, and rays that go to it step by step."""

from __future__ import annotations

import numpy as np


def unit_place(points, rock):
    """Return points (..., 3) in the axes of a rock, in its semi-axes and height."""
    x, y, base, a, b, height, cos, sin = rock[:8]
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return (points - [x, y, base]) @ turn.T / [a, b, height]


def excess(points, rock, planes):
    """Return a smooth function (...,), above 0 outside the rock and below 0 in it.

    `planes` (m, 4) are the half spaces of its unit shape, none for the half sphere. Below its base
    the rock goes straight down.
    """
    q = unit_place(points, rock)
    if len(planes):
        return (q @ planes[:, :3].T - planes[:, 3]).max(axis=-1)
    e, f, g = np.moveaxis(q, -1, 0)
    return e**2 + f**2 + np.where(g > 0.0, g, 0.0) ** 2 - 1.0


def entry(origin, direction, rock, planes, far, step):
    """Return the least distance of a ray up to `far` within the rock, met in steps, or inf."""
    t = np.arange(0.0, far, step)
    inside = excess(origin + t[:, None] * direction, rock, planes) < 0.0
    if not inside.any():
        return np.inf
    high = t[np.argmax(inside)]
    low = high - step
    for _ in range(60):
        middle = 0.5 * (low + high)
        if excess(origin + middle * direction, rock, planes) < 0.0:
            high = middle
        else:
            low = middle
    return high


def normal(point, rock, planes, step=1e-6):
    """Return the unit normal of the surface at a point, by differences."""
    slope = np.array(
        [
            excess(point + d, rock, planes) - excess(point - d, rock, planes)
            for d in step * np.eye(3)
        ]
    )
    return slope / np.linalg.norm(slope)


def top(x, y, rock, planes):
    """Return the greatest elevation of the rock above (x, y), found by halving, or -inf."""
    low, high = rock[2] - 1.0, rock[2] + 2.0 * rock[5]
    if excess(np.array([x, y, low]), rock, planes) >= 0.0:
        return -np.inf
    for _ in range(60):
        middle = 0.5 * (low + high)
        if excess(np.array([x, y, middle]), rock, planes) < 0.0:
            low = middle
        else:
            high = middle
    return low
