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


def rarity(values, sigma):
    """A function for the logarithm of one over the density of heights.

    Bins of a fifth of `sigma`, smoothed.
    """
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
    return lambda x: np.interp(x, 0.5 * (edges[1:] + edges[:-1]), rare)


def tile_ratio(shown, rare, tile, variance, row, col, outlier, together):
    """Log-likelihood ratio of a tile at a place, and the share of it that the map knows.

    `rare`: logarithms of one over the densities of what the map shows.
    """
    total, count = 0.0, 0
    for r, c in zip(*np.nonzero(np.isfinite(tile)), strict=True):
        y, x = row + r, col + c
        if not (0 <= y < shown.shape[0] and 0 <= x < shown.shape[1]) or np.isnan(shown[y, x]):
            continue
        v = variance[r, c]
        here = -0.5 * (shown[y, x] - tile[r, c]) ** 2 / v - 0.5 * np.log(2.0 * np.pi * v)
        total += max(np.log(1.0 - outlier) + here + rare[y, x], np.log(outlier))
        count += 1
    offered = np.isfinite(tile).sum()
    return total / together, count / offered if offered else 0.0


def beside(height, reach):
    """Variance of posts for lying up to a quarter of a post beside the truth, over that of slopes.

    Heights between posts are means of the posts around; all of them are taken above their own
    planes, a half post apart.
    """
    rows, cols = height.shape
    fine = np.full((2 * rows - 1, 2 * cols - 1), np.nan)
    for a in (0, 1):
        for b in (0, 1):
            part = [height[i : rows - a + i, j : cols - b + j] for i in {0, a} for j in {0, b}]
            mean = np.mean(part, axis=0)
            fine[a::2, b::2] = above_plane(mean, np.ones(mean.shape, bool), reach)
    out = np.zeros(height.shape)
    for r in range(rows):
        for c in range(cols):
            for dr, dc in ((1, 0), (0, 1)):
                y, x = 2 * r, 2 * c
                if y - dr < 0 or x - dc < 0 or y + dr >= len(fine) or x + dc >= len(fine[0]):
                    continue
                ends = fine[y + dr, x + dc], fine[y - dr, x - dc]
                if np.isfinite([*ends, fine[y, x]]).all():
                    out[r, c] += (0.5 * (ends[0] - ends[1])) ** 2 / 12.0
    return out


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
