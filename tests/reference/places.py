"""Plain references of the search for a place on a map: loops and least squares, one at a time."""

from __future__ import annotations

import numpy as np


def above_plane(height, known, reach):
    """Heights above the least-squares plane of the known posts around; NaN for no post."""
    rows, cols = height.shape
    out = np.full((rows, cols), np.nan)
    for r in range(rows):
        for c in range(cols):
            if not known[r, c]:
                continue
            a, b = [], []
            for i in range(max(0, r - reach), min(rows, r + reach + 1)):
                for j in range(max(0, c - reach), min(cols, c + reach + 1)):
                    if known[i, j]:
                        a.append((1.0, j - c, i - r))
                        b.append(height[i, j])
            if len(a) < 0.6 * (2 * reach + 1) ** 2:
                continue
            out[r, c] = height[r, c] - np.linalg.lstsq(np.array(a), np.array(b), rcond=None)[0][0]
    return out


def density(values, sigma):
    """A function for the density of heights: bins of a fifth of `sigma`, smoothed."""
    width = 0.2 * sigma
    top = min(np.abs(values).max() + 4.0 * sigma, 2000.0 * width)
    edges = np.arange(-top, top + width, width)
    count = np.zeros(len(edges) - 1)
    for v in values:
        n = int(np.searchsorted(edges, v, side="right")) - 1
        count[min(max(n, 0), len(count) - 1)] += 1.0
    share = count / len(values) / width
    reach = 6
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / 1.5) ** 2)
    weight /= weight.sum()
    # Mirrored at the ends, where there is hardly anything.
    padded = np.pad(share, reach, mode="symmetric")
    smooth = np.array([weight @ padded[i : i + 2 * reach + 1] for i in range(len(share))])
    rare = -np.log(smooth + 1e-3 / (2.0 * top))
    return lambda x: np.exp(-np.interp(x, 0.5 * (edges[1:] + edges[:-1]), rare))


def tile_ratio(shown, tile, variance, row, col, common, outlier, together):
    """Log-likelihood ratio of a tile at a place, and the share of it that the map knows."""
    total, count, offered = 0.0, 0, 0
    for r in range(tile.shape[0]):
        for c in range(tile.shape[1]):
            if np.isnan(tile[r, c]):
                continue
            offered += 1
            y, x = row + r, col + c
            if not (0 <= y < shown.shape[0] and 0 <= x < shown.shape[1]):
                continue
            if np.isnan(shown[y, x]):
                continue
            v = variance[r, c]
            here = np.exp(-0.5 * (shown[y, x] - tile[r, c]) ** 2 / v) / np.sqrt(2.0 * np.pi * v)
            total += np.log(max((1.0 - outlier) * here / common(shown[y, x]), outlier))
            count += 1
    return total / together, count / offered if offered else 0.0


def log_factors(ratios, shares, others, other_shares, changed):
    """Logarithms of what a tile multiplies places by, given its ratios all over the map."""
    scaled = [r / s for r, s in zip(others, other_shares, strict=True) if s > 0.5]
    usual = np.log(np.mean(np.exp(scaled)))
    return [
        np.log((1.0 - changed) * np.exp(r - s * usual) + changed)
        for r, s in zip(ratios, shares, strict=True)
    ]


def posterior(log_evidence, shifts, mean, covariance):
    """Probabilities of places by evidence and prior, over those given alone."""
    inverse = np.linalg.inv(covariance)
    p = np.array(
        [
            np.exp(e - 0.5 * (s - mean) @ inverse @ (s - mean))
            for e, s in zip(log_evidence, shifts, strict=True)
        ]
    )
    return p / p.sum()
