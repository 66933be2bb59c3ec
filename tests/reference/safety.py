"""Plain landing safety: loops over cells, headings, planes and footprint cells."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np


def leg_cells(lander, posting: float, samples: int = 20000) -> list[tuple]:
    """Every distinct set of leg cells, found by turning the lander in tiny steps."""
    found = set()
    for heading in np.linspace(0.0, 2.0 * math.pi / lander.legs, samples, endpoint=False) + 1e-7:
        cells = []
        for leg in range(lander.legs):
            angle = heading + 2.0 * math.pi * leg / lander.legs
            row = lander.leg_radius / posting * math.sin(angle)
            col = lander.leg_radius / posting * math.cos(angle)
            cells.append((math.floor(abs(row) + 0.5) * (1 if row > 0 else -1),
                          math.floor(abs(col) + 0.5) * (1 if col > 0 else -1)))  # fmt: skip
        found.add(tuple(cells))
    return sorted(found)


def pad_cells(lander, posting: float) -> list[tuple[int, int]]:
    r = 0.5 * lander.pad_diameter / posting
    n = int(r + 1e-9)
    return [
        (i, j)
        for i in range(-n, n + 1)
        for j in range(-n, n + 1)
        if i * i + j * j <= (r + 1e-9) ** 2
    ]


def polygon_cells(corners: tuple) -> list[tuple[int, int]]:
    rows = [c[0] for c in corners]
    cols = [c[1] for c in corners]
    inside = []
    for i in range(min(rows), max(rows) + 1):
        for j in range(min(cols), max(cols) + 1):
            turns = []
            for (r0, c0), (r1, c1) in zip(corners, corners[1:] + corners[:1], strict=True):
                turns.append((c1 - c0) * (i - r0) - (r1 - r0) * (j - c0))
            if all(t >= 0 for t in turns):
                inside.append((i, j))
    return inside


def standing_planes(legs: np.ndarray) -> list[tuple[float, float, float]]:
    """Planes through three legs that no leg pokes through: (z0, dz/dx, dz/dy)."""
    planes = []
    for triple in combinations(range(len(legs)), 3):
        p, q, s = legs[list(triple)]
        nx, ny, nz = np.cross(q - p, s - p)
        gx, gy = -nx / nz, -ny / nz
        z0 = p[2] - gx * p[0] - gy * p[1]
        if all(z <= z0 + gx * x + gy * y + 1e-9 for x, y, z in legs):
            planes.append((z0, gx, gy))
    return planes


def exact(z: np.ndarray, grid, lander, row: int, col: int) -> tuple[float, float]:
    """Worst slope (rad) and roughness (m) of a lander centred on one cell."""
    pads = pad_cells(lander, grid.posting)
    slope = roughness = 0.0
    for corners in leg_cells(lander, grid.posting, 4000):
        legs = np.array(
            [
                (
                    c * grid.posting,
                    r * grid.posting,
                    max(float(z[row + r + a, col + c + b]) for a, b in pads),
                )
                for r, c in corners
            ]
        )
        for z0, gx, gy in standing_planes(legs):
            stretch = math.sqrt(1.0 + gx * gx + gy * gy)
            slope = max(slope, math.acos(1.0 / stretch))
            for r, c in polygon_cells(corners):
                plane = z0 + gx * c * grid.posting + gy * r * grid.posting
                roughness = max(roughness, (float(z[row + r, col + c]) - plane) / stretch)
    return slope, roughness


def extremes(z: np.ndarray, grid, lander, row: int, col: int):
    """max over L, min over L, max over U, and h0 (m), of a lander centred on one cell."""
    pads = pad_cells(lander, grid.posting)
    legs, body, least = set(), set(), math.inf
    for corners in leg_cells(lander, grid.posting, 4000):
        body.update(polygon_cells(corners))
        for r, c in corners:
            legs.update((r + a, c + b) for a, b in pads)
        for p, q, s in combinations(corners, 3):
            area = abs((q[0] - p[0]) * (s[1] - p[1]) - (q[1] - p[1]) * (s[0] - p[0]))
            longest = max(math.dist(p, q), math.dist(q, s), math.dist(p, s))
            least = min(least, area / longest * grid.posting)
    over_legs = [float(z[row + r, col + c]) for r, c in legs]
    over_body = [float(z[row + r, col + c]) for r, c in body]
    return max(over_legs), min(over_legs), max(over_body), least


def below(margin: float, sigma: float) -> float:
    """P(x < margin) for x ~ N(0, sigma^2); a step where sigma is 0."""
    if sigma == 0.0:
        return 1.0 if margin > 0.0 else 0.0
    return 0.5 * math.erfc(-margin / (sigma * math.sqrt(2.0)))


def highest(values: list[tuple[float, float]]) -> tuple[float, float]:
    """Mean and deviation of the maximum of Gaussians (mean, deviation): Eqs. 15 and 16."""
    top = max(m + 3.0 * s for m, s in values)
    bottom = max(m - 3.0 * s for m, s in values)
    return 0.5 * (top + bottom), (top - bottom) / 6.0


def lowest(values: list[tuple[float, float]]) -> tuple[float, float]:
    """Mean and deviation of the minimum of Gaussians."""
    top = min(m + 3.0 * s for m, s in values)
    bottom = min(m - 3.0 * s for m, s in values)
    return 0.5 * (top + bottom), (top - bottom) / 6.0


def stochastic(mean, variance, grid, lander, row, col, bound=math.sin) -> tuple[float, float]:
    """Probabilities of slope and roughness of a lander centred on one cell: Eq. 17."""
    pads = pad_cells(lander, grid.posting)
    legs, body = set(), set()
    for corners in leg_cells(lander, grid.posting, 4000):
        body.update(polygon_cells(corners))
        legs.update((r + a, c + b) for r, c in corners for a, b in pads)
    *_, least = extremes(mean, grid, lander, row, col)

    def gaussians(cells):
        return [
            (float(mean[row + r, col + c]), math.sqrt(float(variance[row + r, col + c])))
            for r, c in cells
        ]

    top, top_sd = highest(gaussians(legs))
    low, low_sd = lowest(gaussians(legs))
    peak, peak_sd = highest(gaussians(body))
    slope = below(least * bound(lander.slope_limit) - (top - low), math.hypot(top_sd, low_sd))
    rough = below(lander.roughness_limit - (peak - low), math.hypot(peak_sd, low_sd))
    return slope, rough


def real_planes(mean, variance, grid, lander, row, col) -> tuple[float, float]:
    """Probabilities of slope and roughness through the support planes, cell by cell, upright."""
    p = grid.posting
    pads = pad_cells(lander, p)
    steepest = nominal = raised = worst_sd = 0.0
    for corners in leg_cells(lander, p, 4000):
        legs = []
        for r, c in corners:
            under = [(row + r + a, col + c + b) for a, b in pads]
            z, sd = highest([(float(mean[i]), math.sqrt(float(variance[i]))) for i in under])
            legs.append((c * p, r * p, z))
            worst_sd = max(worst_sd, sd)
        for z0, gx, gy in standing_planes(np.array(legs)):
            steepest = max(steepest, math.hypot(gx, gy))
            for r, c in polygon_cells(corners):
                rise = float(mean[row + r, col + c]) - (z0 + gx * c * p + gy * r * p)
                nominal = max(nominal, rise)
                rise += 3.0 * math.sqrt(float(variance[row + r, col + c]))
                raised = max(raised, rise)
    *_, least = extremes(mean, grid, lander, row, col)
    slope_sd = math.sqrt(2.0) * worst_sd / least
    slope = below(math.tan(lander.slope_limit) - steepest, slope_sd)
    rough_sd = math.hypot((raised - nominal) / 3.0, worst_sd)
    return slope, below(lander.roughness_limit - nominal, rough_sd)
