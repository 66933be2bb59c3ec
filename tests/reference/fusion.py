"""Plain fusion: loops over cells, sizes and rocks."""

from __future__ import annotations

import math


def law(diameter: float, cover: float) -> float:
    """Rocks of a diameter or more on a square metre, summed over thin slices of the cover."""
    q = 1.79 + 0.152 / cover
    total, step = 0.0, 0.002
    d = diameter
    while q * (d - diameter) < 25.0:
        middle = d + 0.5 * step
        slice_cover = cover * (math.exp(-q * d) - math.exp(-q * (d + step)))
        total += slice_cover / (0.25 * math.pi * middle * middle)
        d += step
    return total


def left(height: float, diameters: list, ratios: list, cover: float, height_ratio: float) -> float:
    """Share of the rocks above a height that is left at one place."""
    d = max(height, 0.005) / height_ratio
    # No class is missed more rarely than a larger one; what is not looked for is not thinned.
    worst = [max(ratios[k:]) for k in range(len(ratios))]
    edges = [*diameters, math.inf]
    whole = law(d, cover)
    share = 0.0
    if d < diameters[0]:
        share += max(1.0, worst[0]) * (whole - law(diameters[0], cover)) / whole
    for k in range(len(diameters)):
        low, high = max(d, edges[k]), edges[k + 1]
        if high <= d:
            continue
        above = 0.0 if math.isinf(high) else law(high, cover)
        share += worst[k] * (law(low, cover) - above) / whole
    return share


def existence(
    place, sigma, radius, variance, there, cells, rise, density, limit, posting, common
) -> float:
    """Probability that one rock is one that matters; cells are (x, y) by (row, col)."""
    spread = math.sqrt(variance)
    reach = radius + 2.0 * math.hypot(sigma, spread) + posting
    heights, thin = [], []
    for (row, col), (x, y) in cells.items():
        if math.hypot(x - place[0], y - place[1]) <= reach:
            heights.append(rise[row][col])
            thin.append(density[row][col])
    if max(heights) - min(heights) >= 0.5 * limit:
        return there
    area = 0.75 * math.pi * max(radius - spread, 0.1) ** 2
    missed = common + (1.0 - common) * math.exp(-min(thin) * area)
    odds = missed * there / (1.0 - there)
    return odds / (1.0 + odds)
