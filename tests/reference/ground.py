"""Slow, plain kriging of heights and counting of squares."""

from __future__ import annotations

import numpy as np


def kriged(places, known, at, count, growth, own):
    """Return heights at points, each from its nearest places, by NumPy's solver."""
    out = []
    for point in at:
        away = [np.linalg.norm(place - point) for place in places]
        near = np.argsort(away)[:count]
        system, right = np.zeros((count + 1, count + 1)), np.ones(count + 1)
        for i, one in enumerate(near):
            for j, other in enumerate(near):
                if i != j:
                    apart = np.linalg.norm(places[one] - places[other])
                    system[i, j] = 0.5 * growth * apart + own**2
            system[i, count] = system[count, i] = 1.0
            right[i] = 0.5 * growth * away[one] + own**2
        out.append(np.linalg.solve(system, right)[:count] @ known[near])
    return np.array(out)


def squares(points, side):
    """Return on how many squares points lie; those that are not finite lie on none."""
    there = [p for p in points if np.isfinite(p[0]) and np.isfinite(p[1])]
    if not there:
        return 0
    west, south = min(p[0] for p in there), min(p[1] for p in there)
    return len({((p[0] - west) // side, (p[1] - south) // side) for p in there})
