"""Plain DEMs: Eq. 1 and 2 cell by cell, and Gaussian process regression with matrices."""

from __future__ import annotations

import numpy as np


def conventional(points: np.ndarray, grid) -> tuple[np.ndarray, np.ndarray]:
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


def trended(
    vertices: np.ndarray,
    noise: np.ndarray,
    gradient: np.ndarray,
    growth: float,
    length: float,
    xy: np.ndarray,
) -> tuple[float, float]:
    """Eqs. 5 and 6 with a plane as prior mean, a noise for each vertex, and a field's growth."""

    def kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(a[:, None, :2] - b[None, :, :2], axis=2)
        return growth * length * np.exp(-distance / length)

    middle = vertices.mean(axis=0)

    def trend(points: np.ndarray) -> np.ndarray:
        return middle[2] + (points[:, :2] - middle[:2]) @ gradient

    gram = kernel(vertices, vertices) + np.diag(noise)
    k = kernel(vertices, xy[None])[:, 0]
    value = trend(xy[None])[0] + k @ np.linalg.solve(gram, vertices[:, 2] - trend(vertices))
    return value, growth * length - k @ np.linalg.solve(gram, k)


def pooled_sums(scans: list, grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centroids (x, y, z), their variances, and the splat's mean and variance, cell by cell.

    `scans` holds points and deviations. Rows of the first: x, y, z, variance; NaN without samples.
    The second: mean, variance and greatest weight of one scan.
    """
    near = np.full((*grid.shape, 4), np.nan)
    about = np.full((*grid.shape, 3), np.nan)
    for i in range(grid.rows):
        for j in range(grid.cols):
            centre = np.array([grid.x0 + grid.posting * j, grid.y0 + grid.posting * i])
            mine, corner, most = [], [], 0.0
            for points, sigma in scans:
                weight = 0.0
                for p, s in zip(points, sigma, strict=True):
                    if not np.isfinite(p).all():
                        continue
                    away = np.abs(p[:2] - centre) / grid.posting
                    if (away <= 0.5).all():
                        mine.append((p, s))
                    if (away < 1.0).all():
                        w = np.prod(1.0 - away)
                        corner.append((p[2], s, w))
                        weight += w
                most = max(most, weight)
            if mine:
                precision = np.array([1.0 / s**2 for _, s in mine])
                spots = np.array([p for p, _ in mine])
                near[i, j, :3] = precision @ spots / precision.sum()
                near[i, j, 3] = 1.0 / precision.sum()
            if corner:
                z, s, w = np.array(corner).T
                share = w / s**2 / np.sum(w / s**2)
                about[i, j] = share @ z, share**2 @ s**2, most
    return near, about
