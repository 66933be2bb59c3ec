"""Plain DEMs: Eq. 1 and 2 cell by cell, and Gaussian process regression with matrices."""

from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid


def conventional(points: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Elevation before hole filling (NaN for holes) and weights."""
    total = np.zeros(grid.shape)
    weight = np.zeros(grid.shape)
    for x, y, z in points:
        for i in range(grid.rows):
            for j in range(grid.cols):
                u = 1.0 - abs((x - grid.x0) / grid.posting - j)
                v = 1.0 - abs((y - grid.y0) / grid.posting - i)
                if u > 0.0 and v > 0.0:
                    total[i, j] += u * v * z
                    weight[i, j] += u * v
    with np.errstate(invalid="ignore"):
        return total / weight, weight


def kriging(
    vertices: np.ndarray, xy: np.ndarray, sigma_f: float, length: float, sigma_eps: float
) -> tuple[float, float]:
    """Eqs. 5 and 6 with the vertices' mean as prior mean."""

    def kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(a[:, None, :2] - b[None, :, :2], axis=2)
        return sigma_f**2 * np.exp(-distance / length)

    gram = kernel(vertices, vertices) + sigma_eps**2 * np.eye(len(vertices))
    k = kernel(vertices, xy[None])[:, 0]
    mean = vertices[:, 2].mean()
    value = mean + k @ np.linalg.solve(gram, vertices[:, 2] - mean)
    return value, sigma_f**2 - k @ np.linalg.solve(gram, k)
