"""Candidate cells of a map, selected with NumPy."""

from __future__ import annotations

import numpy as np


def best_cells(aim, distance, posting, count, separation):
    """Return row and column of the `count` cells with the best scores, `separation` m apart."""
    penalty = np.float32(1e-3 / 100.0) * distance.astype(np.float32)
    score = aim * (np.float32(1.0) - penalty)
    score[~(aim > 0.0)] = -np.inf
    reach = int(np.ceil(separation / posting))
    offsets = np.arange(-reach, reach + 1)
    is_near = np.hypot(offsets[:, None], offsets[None, :]) * posting < separation
    cells = []
    for _ in range(count):
        row, col = (int(v) for v in np.unravel_index(int(np.argmax(score)), score.shape))
        if not np.isfinite(score[row, col]):
            break
        cells.append((row, col))
        r0, c0 = max(row - reach, 0), max(col - reach, 0)
        window = score[r0 : row + reach + 1, c0 : col + reach + 1]
        shape = is_near[
            r0 - row + reach : r0 - row + reach + window.shape[0],
            c0 - col + reach : c0 - col + reach + window.shape[1],
        ]
        window[shape] = -np.inf
    return np.array(cells, dtype=np.int64).reshape(-1, 2)


def nearest_cell(aim, distance, level):
    """Return row and column of the nearest cell of at least `level`; None if there is none."""
    is_safe = aim >= np.float32(level)
    if not is_safe.any():
        return None
    return np.unravel_index(int(np.argmin(np.where(is_safe, distance, np.inf))), aim.shape)
