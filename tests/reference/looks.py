"""Whether a rock's shadow would fall on lit ground at one place: one point after the other."""

from __future__ import annotations

import numpy as np


def between(coarse, row, col):
    """Return what lies between the nodes (columns,)."""
    i, j = min(int(row), len(coarse) - 2), min(int(col), coarse.shape[1] - 2)
    v, u = row - i, col - j
    west = (1 - v) * coarse[i, j] + v * coarse[i + 1, j]
    east = (1 - v) * coarse[i, j + 1] + v * coarse[i + 1, j + 1]
    return (1 - u) * west + u * east


def dark_points(place, core, radius, position, axes, lens, labels, largest, cores):
    """Return how many points of the darkest core are dark, and how many of them are tracked.

    None if a point is out of view. Of two as dark that of which fewer are tracked.
    """
    fx, fy, cx, cy = lens
    high, wide = labels.shape
    counts = [[0, 0] for _ in range(cores)]
    for n, (east, north) in enumerate(core):
        x, y, z = axes.T @ (place + radius * np.array([east, north, 0.0]) - position)
        if not z > 0.0:
            return None
        u, v = fx * x / z + cx, fy * y / z + cy
        if not (0.0 <= u <= wide - 1 and 0.0 <= v <= high - 1):
            return None
        of = largest[labels[int(v + 0.5), int(u + 0.5)]]
        if abs(of) >= radius:
            counts[n * cores // len(core)][0] += 1
        if -of >= radius:
            counts[n * cores // len(core)][1] += 1
    return min(counts, key=lambda c: (-c[0], c[1]))


def look(coarse, row, col, radius, position, axes, lens, labels, largest, least, cores):
    """Return whether the shadow at a place would fall on lit ground, on dark, and on a rock's."""
    at = between(coarse, row, col)
    place, reach, core = at[1:4], at[4], at[5:].reshape(-1, 2)

    def dark(higher):
        up = np.array([0.0, 0.0, higher])
        return dark_points(place + up, core, radius, position, axes, lens, labels, largest, cores)

    here = dark(0.0)
    if not at[0] > 0.0 or here is None:
        return False, False, False
    if here[0] >= least:
        return False, True, 2 * here[1] > here[0]
    aside = reach * np.hypot(*(place - position)[:2]) / (position[2] - place[2])
    steps = int(aside / radius + 0.5)
    if steps > 16:
        return False, False, False
    for n in range(-steps, steps + 1):
        if n:
            there = dark(reach * n / steps)
            if there is None or there[0] > there[1]:
                return False, False, False
    return True, False, False
